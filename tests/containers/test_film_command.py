"""`luxloop film` inside one process: tables that have gone from their store, and what a person reads."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any

import pytest

from containers import film_command
from containers.asking import answers, connected, fetched
from containers.film_text import as_text
from containers.thin_film.database import open_database
from containers.thin_film.packing import unpack
from containers.thin_film.table import FilmTable
from containers.thin_film.worker import DATABASE, FilmComputation
from luxloop.client import Answer
from luxloop.computation import Progress
from luxloop.effect import AppliedEffect
from luxloop.errors import InputError, RemoteError
from luxloop.failure import Code, Failure
from luxloop.film import FilmTableRequest, Grid
from luxloop.model import Environment
from luxloop.model_file import find_model
from luxloop.settings import load_settings

REQUEST = FilmTableRequest(environment=Environment(), dbr_pairs=2.5, grid=Grid(wavelengths=1))


class Forgetful:
    """A client beside its worker; the blobs of answers that were not asked for afresh have gone."""

    def __init__(self, computation: FilmComputation, code: Code = "not_found", *, for_good: bool = False) -> None:
        self._computation = computation
        self._code, self._gone, self._for_good = code, True, for_good
        self.fresh = 0

    def run(self, request: FilmTableRequest, *, fresh: bool = False) -> Answer:
        """Compute it here."""
        self.fresh += fresh
        self._gone = self._for_good or not fresh
        result, arrays = self._computation.compute(request.model_dump(), Progress())
        return Answer(result, arrays, "here", 1, 0.0)

    def map(self, requests: Iterable[FilmTableRequest]) -> Iterator[tuple[int, Answer]]:
        """One after the other."""
        for number, request in enumerate(requests):
            yield number, self.run(request)

    def fetch(self, sha256: str, size: int) -> bytes:
        """The blob, or that nobody holds it."""
        packed = self._computation.blob(sha256)
        if self._gone or packed is None or len(packed) != size:
            raise RemoteError(Failure(code=self._code, message="nobody holds it"))
        return packed


@pytest.fixture
def computation(tmp_path: Path) -> Iterator[FilmComputation]:
    """The computation with a database of its own."""
    with open_database(tmp_path / DATABASE) as database:
        yield FilmComputation(database)


def ask(client: Any) -> tuple[Answer, bytes]:
    """The table of REQUEST, as the command asks for it."""
    ((_, first),) = answers(client, [REQUEST], "tables", show=False)
    return fetched(client, REQUEST, first)


def test_a_table_that_nobody_holds_any_more_is_computed_again(computation: FilmComputation) -> None:
    """Once, afresh; the table that comes is whole."""
    client = Forgetful(computation)
    answer, packed = ask(client)
    assert client.fresh == 1
    assert len(packed) == answer.result["table_bytes"]
    assert FilmTable.from_parts(*unpack(packed)).wavelength_nm.size == 1


@pytest.mark.parametrize(("code", "fresh"), [("not_found", 1), ("no_router", 0)])
def test_a_table_is_not_asked_for_again_and_again(computation: FilmComputation, code: Code, fresh: int) -> None:
    """A second `not_found`, and any other failure, is the asker's."""
    client = Forgetful(computation, code, for_good=True)
    with pytest.raises(RemoteError) as caught:
        ask(client)
    assert caught.value.failure.code == code
    assert client.fresh == fresh


def document(films: int) -> dict[str, Any]:
    """A result with so many mirrors at three angles; value = number of the film + row / 10."""
    return {
        "command": "film",
        "quantity": "R",
        "unit": "1",
        "side": "inside",
        "polarisation": "u",
        "against": "angle",
        "angle_deg": [0.0, 2.5, 80.0],
        "wavelength_nm": [445.0],
        "bandwidth_nm": 0.0,
        "model": {"name": "paper", "sha256": "0"},
        "films": [{"dbr_pairs": 0.5 * n, "values": [n + 0.1 * row for row in range(3)]} for n in range(films)],
    }


@pytest.mark.parametrize("columns", [None, 200, 60, 40, 10])
def test_a_narrow_terminal_gets_the_films_in_blocks(columns: int | None) -> None:
    """No row is longer than the terminal, if one film fits; every value has its title and its angle."""
    lines = as_text(document(11), columns).splitlines()[1:]
    if columns is not None:
        assert max(map(len, lines)) <= max(columns, 13 + 11)
    found: dict[tuple[str, str], str] = {}
    for line in lines:
        if "angle_deg" in line:
            titles = line.replace(" pairs", "").split()[1:]
        elif line:
            angle, *values = line.split()
            found |= {(title, angle): value for title, value in zip(titles, values, strict=True)}
    assert len(found) == 33
    assert found["2.5", "2.5"] == "5.10000"
    assert found["5", "80"] == "10.20000"
    assert (lines.count("") > 0) == (columns is not None and columns < 13 + 11 * 11)


@pytest.fixture
def asked(computation: FilmComputation, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: Any) -> Any:
    """`luxloop film --json` with a worker in this process: its document, for a model of a 460 nm line of 12 nm."""
    paper = find_model("paper")
    line = paper.environment.model_copy(update={"peak_nm": 460.0, "fwhm_nm": 12.0})
    model = paper.model_copy(update={"environment": line})
    monkeypatch.setenv("LUXLOOP_CACHE", str(tmp_path))
    monkeypatch.setattr(film_command, "find_model", lambda name: model if name == "460" else find_model(name))
    monkeypatch.setattr(film_command, "connected", lambda *_: nullcontext(Forgetful(computation)))

    def run(**options: Any) -> dict[str, Any]:
        film_command.film(**options, as_json=True)
        return dict(json.loads(capsys.readouterr().out))

    return run


def test_the_command_asks_for_the_polarisation(asked: Any) -> None:
    """445 nm, 5.5 pairs, 20 deg in GaN: R_s 0.755, R_p 0.290, and their mean for unpolarised light."""
    shown = {}
    for kind in ("s", "p", "u"):
        document = asked(pairs="5.5", angles="20", bandwidth=0.0, polarisation=kind)
        assert document["polarisation"] == kind
        shown[kind] = document["films"][0]["values"][0]
    assert shown["s"] == pytest.approx(0.755, abs=5e-4)
    assert shown["p"] == pytest.approx(0.290, abs=5e-4)
    assert shown["u"] == pytest.approx((shown["s"] + shown["p"]) / 2.0)


@pytest.mark.parametrize("polarisation", ["s", "p", "u"])
def test_a_table_is_held_against_the_values_of_its_polarisation(asked: Any, polarisation: str) -> None:
    """What the table reads of s, p or both is what was measured, within the error that it states."""
    table = asked(pairs="5.5", angles="0:23:1", polarisation=polarisation, tables=True)["films"][0]["table"]
    assert table["largest_difference"] < table["error_average_ratio"] <= 1e-3
    assert table["error_average_ratio"] < table["error_single_ratio"]
    assert table["resolved"]


def test_the_table_is_that_of_the_models_line(asked: Any, computation: FilmComputation) -> None:
    """A model with a line of 460 nm, 12 nm wide, gets a table of that line, and the values agree with it."""
    table = asked(pairs="5.5", model="460", angles="0:23:1", tables=True)["films"][0]["table"]
    packed = computation.blob(table["sha256"])
    assert packed is not None
    held = FilmTable.from_parts(*unpack(packed))
    assert held.weight @ held.wavelength_nm == pytest.approx(460.0)
    assert (held.spectrum.peak_nm, held.spectrum.fwhm_nm) == (460.0, 12.0)
    assert table["largest_difference"] < 1e-3


def effect(name: str, **parameters: Any) -> AppliedEffect:
    """An effect of a model."""
    return AppliedEffect(name=name, parameters=parameters)


def test_a_models_effects_act_on_its_dbr(asked: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """A thickness error changes values and table, a camera's blur neither; a measured film has its own effects."""
    models = {
        "thick": (effect("dbr_thickness_error", error_ratio=0.03),),
        "blurred": (effect("camera_psf", psf_um=20.0, profile="gaussian"),),
        "offset": (effect("film_baseline_offset", offset_percent=1.0, azimuth_deg=0.0, retardance_deg=0.0),),
    }
    paper = find_model("paper")
    found = {name: paper.model_copy(update={"effects": those}) for name, those in models.items()}
    monkeypatch.setattr(film_command, "find_model", lambda name: found.get(name, paper))
    shown = {
        name: asked(pairs="5.5", model=name, angles="0:20:10", tables=True)["films"][0]
        for name in ("paper", "thick", "blurred")
    }
    assert shown["blurred"]["values"] == shown["paper"]["values"]
    assert shown["blurred"]["table"]["sha256"] == shown["paper"]["table"]["sha256"]
    assert shown["thick"]["table"]["sha256"] != shown["paper"]["table"]["sha256"]
    assert abs(shown["thick"]["values"][0] - shown["paper"]["values"][0]) > 0.003
    assert shown["thick"]["table"]["largest_difference"] < 1e-3
    plain, offset = (asked(stack="Si | air", model=name, angles="0")["films"][0]["values"] for name in ("", "offset"))
    assert offset[0] == pytest.approx(plain[0] + 0.01, abs=1e-12)


def test_without_pairs_a_person_reads_that_an_effect_has_no_influence(
    asked: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One sentence, whatever the number of films without pairs; none where there are pairs."""
    model = find_model("paper").model_copy(update={"effects": (effect("dbr_roughness", roughness_nm=2.0),)})
    monkeypatch.setattr(film_command, "find_model", lambda _: model)
    document = asked(pairs="0,2.5", angles="0")
    assert document["warnings"] == ["dbr_roughness has no influence: the chip has no DBR (0 pairs)"]
    assert "WARNING: dbr_roughness has no influence" in as_text(document, None)
    assert asked(pairs="2.5", angles="0")["warnings"] == []


@pytest.mark.parametrize(("resolved", "says"), [(True, "errs by up to 8.4e-04"), (False, "WARNING: not resolved")])
def test_a_person_reads_how_far_a_table_is_wrong(resolved: bool, says: str) -> None:
    """One line for a table that is resolved, a warning for one that is not."""
    shown = document(2)
    shown["films"][1]["table"] = {
        "sha256": "0" * 64,
        "bytes": 184_000,
        "nodes": 301,
        "wavelengths": 31,
        "known": False,
        "largest_difference": 1e-4,
        "error_average_ratio": 8.4e-4 if resolved else 0.2,
        "error_single_ratio": 6.5e-3,
        "resolved": resolved,
    }
    (line,) = (line for line in as_text(shown, None).splitlines() if says in line)
    assert len(line) < 100
    assert ("WARNING" in line) == (not resolved)


def test_a_worker_that_compiles_is_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first start of all takes a minute or two: a film is as patient as a simulation."""
    patience_s = []

    @contextmanager
    def client(_: Any, **options: Any) -> Iterator[None]:
        patience_s.append(options["patience_s"])
        yield None

    monkeypatch.setattr("luxloop.client.Client", client)
    with connected(load_settings(), show=False):
        pass
    assert patience_s == [300.0]


@pytest.mark.parametrize("wanted", [{"tables": True}, {"export": Path("mirror.xml")}])
def test_without_numba_a_table_is_refused_before_anybody_is_asked(
    wanted: dict[str, Any], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """As in the designer's image: option and mend, no traceback after the workers have computed."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(film_command, "find_spec", lambda _: None)
    monkeypatch.setattr(film_command, "connected", lambda *_: pytest.fail("it asked"))
    with pytest.raises(InputError, match=r"an installation with numba; pip install 'luxloop\[workers\]'"):
        film_command.film(pairs="5.5", angles="", wavelengths="", **wanted)
