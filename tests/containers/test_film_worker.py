"""PC2 as a process behind the real bus, and as the object that computes."""

from __future__ import annotations

import json
import os
import shutil
import sqlite3
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from containers import materials
from containers.stack import dbr_of
from containers.thin_film.database import open_database
from containers.thin_film.packing import unpack
from containers.thin_film.table import FilmTable
from containers.thin_film.worker import DATABASE, FilmComputation, table_key
from luxloop.client import Client
from luxloop.computation import Progress, Stopped
from luxloop.effect import AppliedEffect
from luxloop.errors import InputError, RemoteError
from luxloop.film import FilmMeasurementRequest, FilmTableRequest, Grid, Spectrum
from luxloop.model import Environment
from luxloop.settings import Settings
from luxloop.stack import Layer, Medium, Stack
from tests.conftest import start, stop, wait_for

GOLDEN = json.loads((Path(__file__).parents[1] / "golden" / "thin_film.json").read_text())["tables"]


@pytest.fixture
def computation(tmp_path: Path) -> Iterator[FilmComputation]:
    """The computation with a database of its own."""
    with open_database(tmp_path / DATABASE) as database:
        yield FilmComputation(database)


def table_request(pairs: float, **environment: Any) -> FilmTableRequest:
    """The table of the default environment's DBR."""
    return FilmTableRequest(environment=Environment(**environment), dbr_pairs=pairs)


def ask(computation: FilmComputation, request: Any) -> tuple[dict[str, Any], dict[str, Any]]:
    """Result and arrays for a request as it comes over the bus."""
    result, arrays = computation.compute(json.loads(request.model_dump_json()), Progress())
    return result, dict(arrays)


@pytest.mark.parametrize("order", ["gan_first", "aln_first"])
@pytest.mark.parametrize("pairs", [0, 2.5, 4.5, 5, 5.5, 6, 6.5, 9.5])
def test_measurements_meet_the_golden_table(computation: FilmComputation, order: str, pairs: float) -> None:
    """The line average of R from both sides, asked as a request, is the independent program's to 2e-8."""
    for side, name in (("inside", "GaN"), ("outside", "air")):
        golden = GOLDEN[f"{name}|{'GaN' if order == 'gan_first' else 'AlN'}-first|{pairs:g}"]
        environment = Environment(layer_order=order)
        _, arrays = ask(
            computation,
            FilmMeasurementRequest(
                environment=environment,
                dbr_pairs=pairs,
                quantity="R",
                wavelength_nm=(environment.peak_nm,),
                aoi_deg=tuple(golden["deg"]),
                bandwidth_nm=environment.fwhm_nm,
                from_side=side,
            ),
        )
        np.testing.assert_allclose(arrays["value"][0], golden["R"], atol=2e-8)


def test_a_table_is_computed_once_and_found_by_its_hash(computation: FilmComputation) -> None:
    """The second request is answered from the database with the same hash; the blob unpacks to the same table."""
    first, arrays = ask(computation, table_request(5.5))
    second, again = ask(computation, table_request(5.5))
    assert (first["known"], second["known"]) == (False, True)
    assert first["table_sha256"] == second["table_sha256"]
    packed = computation.blob(first["table_sha256"])
    assert packed is not None
    table = FilmTable.from_parts(*unpack(packed))
    np.testing.assert_array_equal(table.average("inside").R, arrays["R_inside"])
    np.testing.assert_array_equal(arrays["R_inside"], again["R_inside"])


@pytest.mark.parametrize("thickness_nm", [500.0, 2e6], ids=["resolved", "not resolved"])
def test_the_answer_says_how_far_the_table_is_wrong(computation: FilmComputation, thickness_nm: float) -> None:
    """The table's own errors come with the answer, computed or held; above the tolerance where it is not resolved."""
    layer = Layer(medium=Medium(n=2.1793), thickness_nm=thickness_nm)
    request = FilmTableRequest(stack=Stack(inside=Medium(n=2.4869), layers=(layer,), outside=Medium(n=1.0)))
    (first, _), (second, _) = ask(computation, request), ask(computation, request)
    packed = computation.blob(first["table_sha256"])
    assert packed is not None
    table = FilmTable.from_parts(*unpack(packed))
    names = ("error_average_ratio", "error_single_ratio", "tolerance_ratio")
    assert [first[name] for name in names] == [second[name] for name in names]
    assert [first[name] for name in names] == [table.error_average_ratio, table.error_single_ratio, 1e-3]
    assert (first["error_average_ratio"] <= first["tolerance_ratio"]) == table.resolved == (thickness_nm < 1e6)


def test_a_table_is_of_the_line_and_grid_that_were_asked_for(computation: FilmComputation) -> None:
    """Another line, another grid or another tolerance is another table; each is what its request says."""
    base = table_request(5.5)
    spectrum, grid = Spectrum(peak_nm=460.0, fwhm_nm=12.0), Grid(wavelengths=31, tolerance_ratio=1e-4)
    hashes = set()
    for change in ({}, {"spectrum": spectrum}, {"grid": grid}):
        result, _ = ask(computation, base.model_copy(update=change))
        packed = computation.blob(result["table_sha256"])
        assert packed is not None
        table = FilmTable.from_parts(*unpack(packed))
        wanted = change.get("spectrum", Spectrum())
        assert table.weight @ table.wavelength_nm == pytest.approx(wanted.peak_nm)
        assert np.ptp(table.wavelength_nm) == pytest.approx(5.0 * wanted.fwhm_nm)
        assert table.grid == change.get("grid", Grid())
        hashes.add(result["table_sha256"])
    assert len(hashes) == 3


def test_a_measurement_is_of_its_polarisation(computation: FilmComputation) -> None:
    """445 nm, 5.5 pairs, 20 deg in GaN: R_s 0.755, R_p 0.290, and their mean for unpolarised light."""
    shown = {}
    for kind in ("s", "p", "u"):
        request = FilmMeasurementRequest(
            environment=Environment(),
            dbr_pairs=5.5,
            quantity="R",
            wavelength_nm=(445.0,),
            aoi_deg=(20.0,),
            polarisation=kind,
            from_side="inside",
        )
        shown[kind] = ask(computation, request)[1]["value"][0, 0]
    assert shown["s"] == pytest.approx(0.755, abs=5e-4)
    assert shown["p"] == pytest.approx(0.290, abs=5e-4)
    assert shown["u"] == pytest.approx((shown["s"] + shown["p"]) / 2.0)


def test_what_does_not_touch_the_film_shares_its_table(computation: FilmComputation) -> None:
    """Another substrate is the same film; another layer thickness is another."""
    base, _ = ask(computation, table_request(5.5))
    substrate, _ = ask(computation, table_request(5.5, chip_absorption_per_cm=100.0))
    thicker, _ = ask(computation, table_request(5.5, gan_layer_nm=46.0))
    assert substrate["known"]
    assert substrate["table_sha256"] == base["table_sha256"]
    assert thicker["table_sha256"] != base["table_sha256"]


def test_a_corrupted_table_is_computed_again(computation: FilmComputation, tmp_path: Path) -> None:
    """One flipped byte in the file: the hash tells, the table is made anew, and is the same."""
    first, _ = ask(computation, table_request(6.5))
    with sqlite3.connect(tmp_path / DATABASE) as other:
        (packed,) = other.execute("SELECT packed FROM blobs").fetchone()
        flipped = packed[:5000] + bytes([packed[5000] ^ 1]) + packed[5001:]
        other.execute("UPDATE blobs SET packed = ?", (flipped,))
    other.close()
    second, _ = ask(computation, table_request(6.5))
    assert not second["known"]
    assert second["table_sha256"] == first["table_sha256"]


def test_an_effect_not_known_here_is_said(computation: FilmComputation) -> None:
    """A model with an effect is not computed without it."""
    effect = AppliedEffect(name="dbr_magic", parameters={"power": 2.0})
    request = table_request(5.5).model_copy(update={"effects": (effect,)})
    with pytest.raises(RemoteError) as caught:
        ask(computation, request)
    assert caught.value.failure.code == "unknown_effect"
    assert "dbr_magic" in caught.value.failure.message


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"dbr_pairs": 5.3}, "dbr_pairs"),
        ({"dbr_pairs": -1.0}, "dbr_pairs"),
        ({"environment": {"gan_layer_nm": -45.0}}, "gan_layer_nm"),
        ({"environment": {"gan_layer_nm": float("nan")}}, "gan_layer_nm"),
        ({"grid": {"wavelengths": 1001, "shared_nodes": 10001}}, "wavelengths"),
        ({"grid": {"wavelengths": 3}}, "wavelengths"),
        ({"grid": {"tolerance_ratio": 0.0}}, "tolerance_ratio"),
        ({"spectrum": {"peak_nm": 445.0, "fwhm_nm": 178.0}}, "fwhm_nm"),
        ({"spectrum": {"peak_nm": 10.0, "fwhm_nm": 18.0}}, "fwhm_nm"),
        ({"colour": "blue"}, "colour"),
        ({"what": "magic"}, "film request"),
        ({"stack": {"inside": {"n": 1.0}, "outside": {"n": 1.0}}}, "stack"),
    ],
)
def test_bad_requests_name_the_field(computation: FilmComputation, change: dict[str, Any], field: str) -> None:
    """Whatever is wrong with a request is refused with its field, before anything is computed."""
    inputs = json.loads(table_request(5.5).model_dump_json())
    for name, value in change.items():
        inputs[name] = {**inputs[name], **value} if isinstance(inputs.get(name), dict) else value
    with pytest.raises(InputError) as caught:
        computation.compute(inputs, Progress())
    assert field in caught.value.field


def test_a_material_out_of_range_names_range_and_mend(computation: FilmComputation) -> None:
    """Silicon at 2,000 nm: the material, its range and what to do."""
    stack = Stack(inside=Medium(material="Si"), outside=Medium(n=1.0))
    request = FilmMeasurementRequest(stack=stack, quantity="R", wavelength_nm=(2000.0,), aoi_deg=(0.0,))
    with pytest.raises(InputError) as caught:
        ask(computation, request)
    assert "1449" in caught.value.allowed


class Impatient(Progress):
    """A progress that is stopped at its fourth report."""

    reports = 0

    def report(self, ratio: float, note: str = "") -> None:
        """Count, and stop."""
        self.reports += 1
        if self.reports == 4:
            self.stop.set()
        super().report(ratio, note)


LOSSY = Stack(
    inside=Medium(n=2.4869), layers=(Layer(medium=Medium(n=2.2, k=0.01), thickness_nm=800.0),), outside=Medium(n=1.0)
)


@pytest.mark.parametrize(
    "request_",
    [
        FilmMeasurementRequest(stack=LOSSY, quantity="R", wavelength_nm=(445.0,), aoi_deg=(0.0,), bandwidth_nm=5.0),
        FilmTableRequest(stack=LOSSY, grid=Grid(tolerance_ratio=1e-5)),
    ],
    ids=["measurement", "table"],
)
def test_a_cancelled_job_ends_while_it_computes(computation: FilmComputation, request_: Any) -> None:
    """Between the wavelengths of a line or the passes of a table; its worker had been ended ten seconds later."""
    with pytest.raises(Stopped):
        computation.compute(json.loads(request_.model_dump_json()), Impatient())
    assert ask(computation, request_)[1]


@pytest.mark.parametrize(
    "effects",
    [
        (),
        (
            AppliedEffect(
                name="film_baseline_offset",
                parameters={
                    "offset_percent": 0.0,
                    "azimuth_deg": 1.0,
                    "retardance_deg": 0.0,
                },
            ),
        ),
    ],
    ids=["bare", "with an effect"],
)
def test_where_nothing_is_reflected_an_ellipsometer_has_nothing_to_read(
    computation: FilmComputation, effects: tuple[AppliedEffect, ...]
) -> None:
    """Air on air: it had been a crash of three workers one after the other, or the effect's fault."""
    stack = Stack(inside=Medium(n=1.0), outside=Medium(n=1.0))
    request = FilmMeasurementRequest(
        stack=stack, quantity="psi", wavelength_nm=(445.0, 500.0), aoi_deg=(30.0,), effects=effects
    )
    with pytest.raises(InputError, match=r"psi at 445 nm and 30 deg.*reflected") as caught:
        ask(computation, request)
    assert caught.value.field == "quantity"


def test_a_table_of_other_material_data_is_another(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """After GaN's data were corrected the table of the old ones is not found; a fixed index has no data."""
    requests = [table_request(5.5, indices=indices) for indices in ("dispersive", "fixed")]

    def keys() -> list[str]:
        materials._load.cache_clear()
        return [table_key(one, dbr_of(one.environment or Environment(), 5.5)) for one in requests]

    before = keys()
    shutil.copytree(materials.DATA, tmp_path / "data")
    monkeypatch.setattr(materials, "DATA", tmp_path / "data")
    assert keys() == before
    with (tmp_path / "data" / "GaN.toml").open("a") as file:
        file.write("# corrected\n")
    dispersive, fixed = keys()
    assert dispersive != before[0]
    assert fixed == before[1]
    materials._load.cache_clear()


@pytest.fixture(scope="module")
def film_set(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Client]:
    """A client of a set that it starts itself: router, controller, one thin-film worker."""
    cache = tmp_path_factory.mktemp("cache")
    kept = {name: os.environ.pop(name) for name in list(os.environ) if name in ("LUXLOOP_ROUTER", "LUXLOOP_REALM")}
    with Client(Settings(cache=cache, router="tcp/127.0.0.1:1")) as client:
        yield client
    os.environ.update(kept)


def test_eleven_tables_over_zenoh(film_set: Client) -> None:
    """All pair counts of the paper, fetched by hash from a real worker process, are the tables computed here."""
    requests = [table_request(4.5 + 0.5 * i) for i in range(11)]
    answers = dict(film_set.map(requests))
    for number, request in enumerate(requests):
        answer = answers[number]
        assert not isinstance(answer, RemoteError), answer
        packed = film_set.fetch(answer.result["table_sha256"], answer.result["table_bytes"])
        table = FilmTable.from_parts(*unpack(packed))
        golden = GOLDEN.get(f"GaN|GaN-first|{request.dbr_pairs:g}")
        if golden is not None:
            u = 2.4869 * np.sin(np.radians(golden["deg"]))
            np.testing.assert_allclose(table.at(table.average("inside").R, u), golden["R"], atol=5e-4)


def test_bad_input_over_zenoh_comes_back_typed_and_the_worker_goes_on(film_set: Client) -> None:
    """A wavelength outside a material's range is `bad_input` with field and range; the next task is computed."""
    stack = Stack(inside=Medium(material="Si"), outside=Medium(n=1.0))
    bad = FilmMeasurementRequest(stack=stack, quantity="R", wavelength_nm=(2000.0,), aoi_deg=(0.0,))
    good = bad.model_copy(update={"wavelength_nm": (633.0,)})
    with pytest.raises(RemoteError) as caught:
        film_set.run(bad)
    assert caught.value.failure.code == "bad_input"
    assert "1449" in caught.value.failure.allowed
    assert 0.3 < film_set.run(good).arrays["value"][0, 0] < 0.4


def test_a_worker_with_a_database_that_is_none_says_so(settings: Settings) -> None:
    """A file that is not SQLite ends the worker with exit code 2 and a message that names it and the mend."""
    settings.cache_dir.mkdir(parents=True)
    (settings.cache_dir / DATABASE).write_bytes(b"not a database at all, but long enough to look at" * 100)
    worker = start(settings, "-m", "luxloop", "serve", "thin-film")
    try:
        assert worker.wait(30) == 2
    finally:
        stop(worker)


def test_the_worker_waits_for_its_router(settings: Settings) -> None:
    """Started before the router, the worker joins when it comes."""
    worker = start(settings, "-m", "luxloop", "serve", "thin-film", "--quiet")
    router = start(settings, "-m", "luxloop", "serve", "router", "--quiet")
    controller = start(settings, "-m", "luxloop", "serve", "controller", "--quiet")

    def joined() -> bool:
        try:
            with Client(settings, local=False) as client:
                return bool(client.status().workers)
        except RemoteError:
            return False

    try:
        wait_for(joined, "the worker to join", 30.0)
    finally:
        for process in (worker, controller, router):
            stop(process)
