"""`luxloop simulate` inside one process: options, both workers, files, what a person reads."""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from containers import simulate_command
from containers.asking import watched
from containers.ray_tracing.exit_source import ExitSource
from containers.ray_tracing.exports import read_ies, read_tm25
from containers.ray_tracing.worker import RayComputation
from containers.simulate_command import PRESETS, array_of, design_of, named_by_option
from containers.simulate_text import as_text
from containers.thin_film.database import open_database
from containers.thin_film.worker import DATABASE, FilmComputation
from luxloop.bus import Interrupt
from luxloop.client import Answer, as_task
from luxloop.computation import Progress
from luxloop.design import Design
from luxloop.errors import InputError, RemoteError
from luxloop.failure import Failure
from luxloop.film import FilmTableRequest
from luxloop.messages import Task
from luxloop.model import Environment
from luxloop.model_file import find_model, to_toml
from luxloop.photometry import luminous_efficacy_lm_per_w
from luxloop.ray import RayRequest

HISTORIES = 32 * 1024
Run = Callable[..., dict[str, Any]]


class Set:
    """A client beside both workers; `gone` tables are held by nobody until they are asked for afresh."""

    def __init__(self, films: FilmComputation) -> None:
        self._films = films
        self._rays = RayComputation(self._fetch, ExitSource())
        self.gone, self.fresh, self.asked = False, 0, list[Any]()

    def run(self, request: Any, *, limit_s: float = 600.0, fresh: bool = False) -> Answer:
        """Compute it here."""
        assert limit_s > 0.0
        self.asked.append(request)
        self.fresh += fresh
        self.gone = self.gone and not fresh
        computation = self._films if isinstance(request, FilmTableRequest) else self._rays
        result, arrays = computation.compute(json.loads(request.model_dump_json()), Progress())
        return Answer(result, arrays, "here", 1, 0.25)

    def _fetch(self, sha256: str, size: int) -> bytes:
        raw = None if self.gone else self._films.blob(sha256)
        if raw is None or len(raw) != size:
            raise RemoteError(Failure(code="not_found", message="nobody holds it"))
        return raw


@pytest.fixture
def workers(tmp_path: Path) -> Any:
    """Both workers, with a film database of their own."""
    with open_database(tmp_path / DATABASE) as database:
        yield Set(FilmComputation(database))


@pytest.fixture
def simulated(workers: Set, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: Any) -> Run:
    """`luxloop simulate --json` with these workers: its document."""
    monkeypatch.setenv("LUXLOOP_CACHE", str(tmp_path))
    monkeypatch.setattr(simulate_command, "connected", lambda *_: nullcontext(workers))

    def run(**options: Any) -> dict[str, Any]:
        simulate_command.simulate(**({"histories": HISTORIES} | options), as_json=True)
        return dict(json.loads(capsys.readouterr().out))

    return run


class Slow:
    """A client whose one worker is done when somebody has looked `looks` times; the next look then is a Ctrl-C."""

    def __init__(self, looks: int, *, interrupted: bool = False) -> None:
        self._looks, self._interrupted = looks, interrupted
        self._done, self.withdrawn = Interrupt(), list[str]()

    def run(self, task: Task, *, limit_s: float, until: Interrupt | None = None) -> Answer:  # noqa: ARG002  # as a client
        """Wait for the last look, or until nobody wants it any more."""
        if until is not None:
            with until.ends(self._done.set):
                assert self._done.wait(20.0)
        return Answer({"limit_s": limit_s}, {}, "slow", 1, 0.0)

    def status(self) -> Any:
        """How far it is: nobody there at the first look, half way then."""
        self._looks -= 1
        if self._looks == 0 and not self._interrupted:
            self._done.set()
        if self._looks == 0 and self._interrupted:
            raise KeyboardInterrupt
        worker = SimpleNamespace(task_id="other", progress_ratio=0.5, describe=SimpleNamespace(kind="ray"))
        return SimpleNamespace(workers=[worker] * (self._looks < 2))

    def withdraw(self, task: Task) -> None:
        """Note it."""
        self.withdrawn.append(task.id)


REQUEST = RayRequest(environment=Environment(), design=Design.from_vector(PRESETS["S_b3"]), histories=1)


@pytest.mark.parametrize("show", [False, True])
def test_a_long_request_is_watched(show: bool, capsys: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where it is shown, somebody looks until it is done; the answer and its time limit are the same."""
    monkeypatch.setattr("containers.asking.LOOK_S", 0.01)
    client: Any = Slow(3)
    assert watched(client, REQUEST, "rays", show, 7.0).result == {"limit_s": 7.0}
    assert client.withdrawn == []
    assert capsys.readouterr().out == ""


def test_an_interrupted_request_is_withdrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ctrl-C while the bar is drawn: nobody computes it any further, and nothing is left waiting."""
    monkeypatch.setattr("containers.asking.LOOK_S", 0.01)
    client: Any = Slow(2, interrupted=True)
    with pytest.raises(KeyboardInterrupt):
        watched(client, REQUEST, "rays", True, 7.0)
    assert client.withdrawn == [as_task(REQUEST).id]


def test_an_interrupted_request_is_withdrawn_without_a_terminal_too() -> None:
    """Nobody sees a bar, and its worker is free all the same."""

    class Struck(Slow):
        def run(self, task: Any, *, limit_s: float, until: Interrupt | None = None) -> Answer:  # noqa: ARG002
            raise KeyboardInterrupt

        def withdraw(self, task: Any) -> None:
            self.withdrawn.append(as_task(task).id)

    client: Any = Struck(1)
    with pytest.raises(KeyboardInterrupt):
        watched(client, REQUEST, "rays", False, 7.0)
    assert client.withdrawn == [as_task(REQUEST).id]


def test_a_preset_is_simulated_with_its_film(simulated: Run, workers: Set) -> None:
    """PC2 is asked for the design's pairs, PC3 for the design with that table; the document says what was asked."""
    document = simulated(preset="S_b3")
    film, rays = workers.asked
    assert (film.dbr_pairs, rays.design.dbr_pairs) == (6.5, 6.5)
    assert rays.film.sha256 == document["film"]["sha256"]
    assert document["design"] == dict(zip(Design.FIELDS, PRESETS["S_b3"], strict=True))
    assert document["model"] == {"name": "paper", "sha256": find_model("paper").sha256}
    assert document["metrics"]["uniformity"]["standard_error"] > 0.0
    assert document["histories"] == HISTORIES


def test_a_model_file_may_ask_for_a_wavelength_per_history(simulated: Run, workers: Set, tmp_path: Path) -> None:
    """`spectrum = sampled` goes from the file to PC3; the light is another, its ledger closed, nothing warned of."""
    paper = find_model("paper")
    sampled = paper.environment.model_copy(update={"spectrum": "sampled"})
    file = tmp_path / "sampled.toml"
    file.write_text(to_toml(paper.model_copy(update={"environment": sampled})))
    found, averaged = simulated(preset="S_b3", model=str(file)), simulated(preset="S_b3")
    assert workers.asked[1].environment.spectrum == "sampled"
    assert found["metrics"] != averaged["metrics"]
    assert found["film"]["sha256"] == averaged["film"]["sha256"]
    assert abs(found["ledger_defect"]) < 1e-12
    assert found["warnings"] == []


def test_without_pairs_no_film_is_asked_for(simulated: Run, workers: Set) -> None:
    """A chip without DBR needs no thin-film worker; another model is another answer."""
    document = simulated(preset="S_b3", pairs=0.0, model="clear_chip")
    assert [type(asked) for asked in workers.asked] == [RayRequest]
    assert document["film"] is None
    assert workers.asked[0].environment == find_model("clear_chip").environment


def test_a_table_that_nobody_holds_any_more_is_computed_again(simulated: Run, workers: Set) -> None:
    """Once, afresh, then the rays."""
    simulated(preset="S_b1")
    workers.gone = True
    workers._rays = RayComputation(workers._fetch, ExitSource())
    simulated(preset="S_b1")
    assert workers.fresh == 1


def test_the_default_target_is_the_papers(simulated: Run, workers: Set, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither histories nor a target given: 0.3 points; given: that."""
    monkeypatch.setattr(Set, "run", lambda self, request, **_: self.asked.append(request) or _stop())
    for options, target in (({}, 0.3), ({"target_error": 2.0}, 2.0)):
        with pytest.raises(RemoteError, match="enough"):
            simulated(preset="S_b3", pairs=0.0, histories=None, **options)
        assert workers.asked[-1].target_error_points == target
        assert workers.asked[-1].histories is None


def _stop() -> Answer:
    raise RemoteError(Failure(code="cancelled", message="enough seen"))


def test_every_file_is_written_and_reads_back(simulated: Run, tmp_path: Path) -> None:
    """Picture, arrays, far field and rays; what they hold is what the document says."""
    files = {"plot": "a.png", "npz": "a.npz", "ies": "a.ies", "rays": "a.tm25ray"}
    paths = {name: tmp_path / file for name, file in files.items()}
    document = simulated(preset="S_b3", pairs=0.0, model="clear_chip", **paths)
    assert document["files"] == {name: str(path) for name, path in paths.items()}
    assert paths["plot"].read_bytes()[:4] == b"\x89PNG"
    environment = find_model("clear_chip").environment
    with np.load(paths["npz"]) as held:
        assert held["map_lx"].mean() == pytest.approx(document["metrics"]["mean_illuminance_lx"]["value"], rel=1e-5)
        assert json.loads(str(held["document_json"]))["metrics"] == document["metrics"]
        assert RayRequest.model_validate_json(str(held["request_json"])).histories == HISTORIES
    web = read_ies(paths["ies"].read_bytes().decode("ascii"))
    lm = environment.flux_per_chip_w * luminous_efficacy_lm_per_w(environment.peak_nm, environment.fwhm_nm)
    module = document["far_field"]["module"]["flux_ratio"]["value"]
    assert web.flux_lm() == pytest.approx(module * lm, rel=0.03)
    rays = read_tm25(paths["rays"].read_bytes())
    left = document["far_field"]["chip"]["flux_ratio"]["value"]  # with what comes to a chip again by the substrate
    assert rays.flux_w.sum() == pytest.approx(environment.flux_per_chip_w * left, rel=0.05)
    assert rays.position_mm[:, 2].max() == pytest.approx(35e-3, rel=1e-5)


def test_a_finite_module_has_its_own_files(simulated: Run, tmp_path: Path) -> None:
    """Two chips in a row: the far field of both, the module's size in metres; a model with a name beyond ASCII."""
    path, model = tmp_path / "a.ies", tmp_path / "modèle.toml"
    model.write_text(to_toml(find_model("paper")), encoding="utf-8")
    document = simulated(preset="S_b3", pairs=0.0, array="1x2", ies=path, model=str(model))
    assert (document["array"]["rows"], document["array"]["columns"]) == (1, 2)
    web = read_ies(path.read_bytes().decode("ascii"))
    assert (web.width_m, web.length_m) == pytest.approx((500e-6, 1000e-6))
    assert web.horizontal_deg[-1] == 360.0


@pytest.mark.parametrize(
    ("options", "option"),
    [
        ({}, "--distance"),
        ({"design": "180,28,500,35"}, "--design"),
        ({"design": "1:5:1"}, "--design"),
        ({"design": "180,28,500,35,x"}, "--design"),
        ({"design": "180,28,500,35,nan"}, "--design"),
        ({"design": "180,28,500,35,6.3"}, "--design"),
        ({"design": "180,28,500,35,6.5", "preset": "S_b3"}, "--design, --preset"),
        ({"preset": "S_b3", "pairs": 6.3}, "--pairs"),
        ({"preset": "S_b3", "distance": -1.0}, "--distance"),
        ({"preset": "S_b3", "width": float("nan")}, "--width"),
        ({"preset": "S_b3", "thickness": 178.0}, "-D, -W, -S, -T"),
        ({"preset": "S_b3", "width": 600.0}, "-D, -W, -S, -T"),
        ({"preset": "S_b3", "histories": 0}, "--histories"),
        ({"preset": "S_b3", "target_error": 0.3}, "--histories, --target-error"),
        ({"preset": "S_b3", "histories": None, "target_error": 0.0}, "--target-error"),
        ({"preset": "S_b3", "budget": 5.0}, "--budget"),
        ({"preset": "S_b3", "histories": None, "budget": 0.0}, "--budget"),
        ({"preset": "S_b3", "seed": "x"}, "--seed"),
        ({"preset": "S_b3", "exit_seed": "-1"}, "--exit-seed"),
        ({"preset": "S_b3", "map_bins": 1}, "--map-bins"),
        ({"preset": "S_b3", "array": "5"}, "--array"),
        ({"preset": "S_b3", "array": "0x5"}, "--array"),
        ({"preset": "S_b3", "array": "2x2", "wall": 1.5}, "--wall"),
        ({"preset": "S_b3", "wall": 0.5}, "--wall"),
        ({"preset": "S_b3", "method": "twin", "histories": None, "target_error": 1.0}, "--target-error"),
        ({"preset": "S_b3", "method": "twin", "seed": "9"}, "--seed"),
        ({"preset": "S_b3", "method": "twin", "stored_exits": True}, "--stored-exits"),
        ({"preset": "S_b3", "method": "twin", "ies": Path("a.ies")}, "--ies"),
        ({"preset": "S_b3", "exit_seed": "7"}, "--exit-seed"),
        ({"design": "180,28,500,35,6.5", "pairs": 6.3}, "--pairs"),
        ({"preset": "S_b3", "plot": Path("map.txt")}, "--plot"),
        ({"preset": "S_b3", "rays": Path("nowhere/at/all.tm25ray")}, "--rays"),
        ({"preset": "S_b3", "model": "papre"}, "model"),
    ],
)
def test_what_is_wrong_is_named_by_its_option(simulated: Run, options: dict[str, Any], option: str) -> None:
    """With the range, before or after a worker saw it."""
    with pytest.raises((InputError, RemoteError)) as caught:
        simulated(**options)
    if isinstance(caught.value, InputError):
        assert caught.value.field == option
        assert caught.value.allowed
    else:
        assert caught.value.failure.field == option
    assert caught.value.exit_code == 2


def test_limits_are_told_from_both_sides() -> None:
    """Not only the limit that was broken, with unit and meaning; a worker's failure is renamed too."""
    with pytest.raises(InputError) as caught:
        design_of(dict.fromkeys(Design.FIELDS, 1.0) | {"distance_um": 0.0}, None, None)
    assert str(caught.value).startswith("--distance: got 0.0, allowed: above 0 to 10000 um; Distance D")
    failure = Failure(code="bad_input", message="budget_s: got 1", field="budget_s")
    with pytest.raises(RemoteError) as told, named_by_option():
        raise RemoteError(failure)
    assert (told.value.failure.field, told.value.failure.message) == ("--budget", "--budget: got 1")
    slow = InputError("target_error_points", 0.001, "0.1 or more within budget_s = 2", "raise budget_s")
    with pytest.raises(InputError, match=r"0.1 or more within --budget 2; raise --budget$"), named_by_option():
        raise slow
    other = Failure(code="crashed", message="histories: a bug", field="histories")
    with pytest.raises(RemoteError) as left, named_by_option():
        raise RemoteError(other)
    assert left.value.failure == other


def test_a_name_changes_what_it_names() -> None:
    """A preset or five numbers, with one of them replaced; an array's text."""
    none = dict.fromkeys(Design.FIELDS)
    assert design_of(none, None, "S_b2").as_vector().tolist() == list(PRESETS["S_b2"])
    changed = design_of(none | {"dbr_pairs": 0.0}, "180,28,500,35,6.5", None)
    assert changed.as_vector().tolist() == [180.0, 28.0, 500.0, 35.0, 0.0]
    assert array_of("2x3", 0.5) == {"rows": 2, "columns": 3, "wall_reflectance": 0.5}


def test_a_person_reads_every_number_with_its_error(simulated: Run) -> None:
    """Uniformity in percent, lux, ledger, events, histories, time, model; few histories are warned of."""
    document = simulated(preset="S_b3", pairs=0.0)
    text = as_text(document)
    one = document["metrics"]["uniformity"]
    assert f"{100 * one['value']:.2f} +- {100 * one['standard_error']:.2f} %" in text
    lux = document["metrics"]["mean_illuminance_lx"]
    assert f"{lux['value']:.0f} +- {lux['standard_error']:.0f} lx" in text
    for words in (
        "endless array",
        "model 'paper'",
        "32,768 histories",
        "0.25 s",
        "absorbed in chips",
        "after the receiver",
    ):
        assert words in text
    document["metrics"]["uniformity"] = one | {"bias": -0.2}
    assert "WARNING: too few histories" in as_text(document)
    document["metrics"]["uniformity"] = one | {"bias": -0.01}
    assert "WARNING" not in as_text(document)
    document["warnings"] = ["substrate: its table is one-way"]
    assert "WARNING: substrate: its table is one-way" in as_text(document)
