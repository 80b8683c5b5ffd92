"""PC3 as the object that computes, and as a process beside PC2 behind the real bus."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from containers.ray_tracing import worker as worker_module
from containers.ray_tracing.exit_source import ExitSource
from containers.ray_tracing.monte_carlo import BLOCK
from containers.ray_tracing.simulation import simulate
from containers.ray_tracing.worker import RayComputation, wanted_threads
from containers.stack import dbr_of
from containers.thin_film.packing import pack, unpack
from containers.thin_film.table import FilmTable, film_table
from luxloop.bus.frame import INLINE_BYTES
from luxloop.client import Client
from luxloop.computation import Progress
from luxloop.effect import AppliedEffect
from luxloop.errors import InputError, RemoteError
from luxloop.failure import Failure
from luxloop.film import FilmTableRequest, Grid, Spectrum
from luxloop.model import Environment
from luxloop.process import usable_cores
from luxloop.ray import PredictionRequest, RayRequest
from luxloop.settings import Settings
from luxloop.words import parse

DESIGN = {"distance_um": 180.0, "width_um": 28.0, "spacing_um": 500.0, "thickness_um": 35.0, "dbr_pairs": 0.5}
HISTORIES = 32 * BLOCK


def packed(pairs: float) -> bytes:
    """The packed table of a DBR."""
    table = film_table(dbr_of(Environment(), pairs), Spectrum(), Grid(wavelengths=11))
    return pack(*table.to_parts())


def request(raw: bytes | None, **changes: Any) -> RayRequest:
    """A design with half a pair, or what is changed in it."""
    film = None if raw is None else {"sha256": hashlib.sha256(raw).hexdigest(), "bytes": len(raw)}
    return parse(RayRequest, {"environment": {}, "design": DESIGN, "film": film, "histories": HISTORIES} | changes)


class Shelf:
    """Blobs by their hash; counts how often it is asked."""

    def __init__(self, *raws: bytes) -> None:
        self._held = {hashlib.sha256(raw).hexdigest(): raw for raw in raws}
        self.asked = 0

    def fetch(self, sha256: str, size: int) -> bytes:
        """The blob, or the bus's own failure."""
        self.asked += 1
        if sha256 not in self._held:
            raise RemoteError(Failure(code="not_found", message="nobody answers"))
        assert len(self._held[sha256]) == size
        return self._held[sha256]


def ask(computation: RayComputation, asked: RayRequest) -> dict[str, Any]:
    """The result for a request as it comes over the bus."""
    return computation.compute(json.loads(asked.model_dump_json()), Progress())[0]


def test_a_film_is_fetched_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Held unpacked afterwards; the least recently used goes when they take too much memory."""
    raws = {pairs: packed(pairs) for pairs in (0.5, 1.0, 1.5)}
    monkeypatch.setattr(worker_module, "HELD_FILM_BYTES", sum(map(len, raws.values())) - 1)
    shelf = Shelf(*raws.values())
    computation = RayComputation(shelf.fetch, ExitSource())
    for pairs, fetched in ((0.5, 1), (1.0, 2), (0.5, 2), (1.5, 3), (0.5, 3), (1.0, 4)):
        ask(computation, request(raws[pairs], design=DESIGN | {"dbr_pairs": pairs}))
        assert shelf.asked == fetched


def test_a_film_nobody_holds_says_what_to_do() -> None:
    """Typed not_found with the hash and the mend; the next request is computed."""
    raw = packed(0.5)
    computation = RayComputation(Shelf().fetch, ExitSource())
    with pytest.raises(RemoteError) as caught:
        ask(computation, request(raw))
    failure = caught.value.failure
    assert (failure.code, failure.field) == ("not_found", "film")
    assert hashlib.sha256(raw).hexdigest() in failure.message
    assert "thin-film worker" in failure.mend
    assert ask(computation, request(None, design=DESIGN | {"dbr_pairs": 0.0}))["histories"] == HISTORIES


def test_bytes_that_are_no_table_are_refused() -> None:
    """A blob of that hash which is something else is bad input, not a crash."""
    raw = b"not a table at all"
    with pytest.raises(InputError) as caught:
        ask(RayComputation(Shelf(raw).fetch, ExitSource()), request(raw))
    assert caught.value.field == "table"


def test_an_effect_not_known_here_is_said() -> None:
    """A model with an effect is not computed without it."""
    effect = AppliedEffect(name="receiver_dent", parameters={"depth_um": 2.0})
    asked = request(None).model_copy(update={"effects": (effect,)})
    with pytest.raises(RemoteError) as caught:
        ask(RayComputation(Shelf().fetch, ExitSource()), asked)
    assert caught.value.failure.code == "unknown_effect"
    assert "the ray-tracing worker does not know effect receiver_dent" in caught.value.failure.message


@pytest.mark.parametrize(
    ("change", "field"),
    [({"histories": 0}, "histories"), ({"design": {}}, "design.distance_um"), ({"colour": 1}, "colour")],
)
def test_bad_requests_name_the_field(change: dict[str, Any], field: str) -> None:
    """Whatever is wrong with a request is refused with its field, before anything is computed."""
    inputs = json.loads(request(None).model_dump_json()) | change
    with pytest.raises(InputError) as caught:
        RayComputation(Shelf().fetch, ExitSource()).compute(inputs, Progress())
    assert caught.value.field == f"ray request: {field}"


@pytest.mark.parametrize(("given", "threads"), [("", usable_cores()), ("1", 1), ("3", 3)])
def test_threads_are_chosen_by_the_environment(monkeypatch: pytest.MonkeyPatch, given: str, threads: int) -> None:
    """LUXLOOP_THREADS, or as many as this process may use."""
    monkeypatch.setenv("LUXLOOP_THREADS", given)
    assert wanted_threads() == threads


@pytest.mark.parametrize("given", ["0", "-1", "two", "1.5", "5000"])
def test_threads_that_cannot_be_are_refused(monkeypatch: pytest.MonkeyPatch, given: str) -> None:
    """By name, with the range."""
    monkeypatch.setenv("LUXLOOP_THREADS", given)
    with pytest.raises(InputError, match="LUXLOOP_THREADS"):
        wanted_threads()


@pytest.fixture(scope="module")
def both(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Client]:
    """A client of a set that it starts itself: router, controller, one worker of each kind."""
    cache = tmp_path_factory.mktemp("cache")
    kept = {name: os.environ.pop(name) for name in list(os.environ) if name in ("LUXLOOP_ROUTER", "LUXLOOP_REALM")}
    with Client(Settings(cache=cache, router="tcp/127.0.0.1:1"), patience_s=300.0) as client:
        yield client
    os.environ.update(kept)


def test_film_and_rays_over_zenoh(both: Client) -> None:
    """PC3 gets PC2's table by its hash over the bus; its answer is, bit for bit, what this process computes."""
    film = both.run(FilmTableRequest(environment=Environment(), dbr_pairs=6.5, spectrum=Spectrum()))
    sha256, size = str(film.result["table_sha256"]), int(film.result["table_bytes"])
    asked = request(None, design=DESIGN | {"dbr_pairs": 6.5}, film={"sha256": sha256, "bytes": size})
    answer = both.run(asked)
    table = FilmTable.from_parts(*unpack(both.fetch(sha256, size)))
    result, arrays = simulate(asked, table, ExitSource(threads=1), Progress(), 1)
    assert json.loads(json.dumps(answer.result)) == json.loads(json.dumps(result))
    assert answer.arrays.keys() == arrays.keys()
    for name, array in arrays.items():
        np.testing.assert_array_equal(answer.arrays[name], array)


def prediction(**changes: Any) -> PredictionRequest:
    """Two cameras in front of nine chips that absorb, about an anchor, or what is changed in it."""
    shot = {
        "environment": {"chip_absorption_per_cm": 200.0},
        "design": DESIGN | {"dbr_pairs": 0.0},
        "array": {"rows": 3, "columns": 3},
        "camera": {"rows": 128, "columns": 128},
    }
    shots = [shot, shot | {"camera": shot["camera"] | {"psf_um": 20.0}}]
    wanted = {"shots": shots, "columns": ["receiver_reflectance"], "anchor": {"histories": 1}, "exit_histories": 1}
    return parse(PredictionRequest, wanted | changes)


def test_a_prediction_over_zenoh(both: Client) -> None:
    """Images, noise and Jacobian come as arrays, large ones by their hash, to the bit what this process computes."""
    asked = prediction()
    answer = both.run(asked)
    computation = RayComputation(Shelf().fetch, ExitSource(threads=1), 1)
    result, arrays = computation.compute(json.loads(asked.model_dump_json()), Progress())
    assert json.loads(json.dumps(answer.result)) == json.loads(json.dumps(result))
    assert answer.arrays["noise_per_mm2"].nbytes > INLINE_BYTES
    names = {"images_per_mm2", "jacobian_per_mm2", "noise_per_mm2", "twin_per_mm2"}
    assert answer.arrays.keys() == arrays.keys() == names
    for name, array in arrays.items():
        assert answer.arrays[name].dtype == array.dtype
        np.testing.assert_array_equal(answer.arrays[name], array)
    with pytest.raises(RemoteError) as caught:
        both.run(prediction(columns=["colour"]))
    failure = caught.value.failure
    assert (failure.code, failure.field) == ("bad_input", "columns.0")
    assert "receiver_reflectance" in failure.allowed
    again = both.run(asked, fresh=True)
    for name, array in arrays.items():
        np.testing.assert_array_equal(again.arrays[name], array)


def test_bad_input_over_zenoh_comes_back_typed_and_the_worker_goes_on(both: Client) -> None:
    """A table nobody holds, a module that cannot be built, a target over its budget: each by name; then an answer."""
    bare = DESIGN | {"dbr_pairs": 0.0}
    bad = {
        "film": (request(b"1" * 10), "not_found"),
        "design": (request(None, design=bare | {"distance_um": 36.0}), "bad_input"),
        "target_error_points": (
            request(None, design=bare, histories=None, target_error_points=0.001, budget_s=1.0),
            "bad_input",
        ),
    }
    for name, (asked, code) in bad.items():
        with pytest.raises(RemoteError) as caught:
            both.run(asked)
        assert (caught.value.failure.code, caught.value.failure.field) == (code, name)
    assert both.run(request(None, design=bare)).result["histories"] == HISTORIES
    assert {worker.describe.kind for worker in both.status().workers} == {"film", "ray"}
