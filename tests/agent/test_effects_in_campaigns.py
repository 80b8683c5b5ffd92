"""Campaigns, grids and simulations of a model with effects: what carries them, what is refused before it begins."""

from __future__ import annotations

import hashlib
import json
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Thread
from types import SimpleNamespace
from typing import Any

import pytest

from agent.config import Campaign, Stop
from agent.effects_tried import EffectsKept, sources, try_effects
from agent.launch import launch
from luxloop.campaign import Plan, Step
from luxloop.design import Design
from luxloop.effect import AppliedEffect
from luxloop.errors import InputError, LuxloopError, RemoteError
from luxloop.failure import Failure
from luxloop.journal.reader import RunJournal
from luxloop.model import Model
from luxloop.model_file import find_model, parse_toml, to_toml
from luxloop.ray import RayRequest
from luxloop.settings import Settings, as_environment, load_settings
from luxloop.words import canonical
from tests import forks
from tests.conftest import free_endpoint, wait_for
from tests.running_set import RunningSet

PRETEND = str(Path(__file__).parents[1] / "pretend_worker.py")
STEPS = "80,80,300,40,4"
"""Of a grid: 32 designs of them can be built."""
DESIGN = Design.from_vector((180.0, 40.0, 500.0, 20.0, 0.0))
LOSS = AppliedEffect(name="chip_absorption", parameters={"absorption_per_cm": 400.0, "profile": "even"})
INDEX = AppliedEffect(name="dbr_index_error", parameters={"index_change": -0.05})
MINE = '''
"""A chip that absorbs."""
from dataclasses import replace
from containers.effect import SceneEffect, parameter, with_chip

class Mine(SceneEffect):
    """Light is absorbed inside the chip."""
    name, stage, formula, reference = "mine", "volume", "exp(-a s)", "a test"
    more_per_cm: float = parameter("a", unit="1/cm", lower=0.0, upper=500.0, off=0.0, one_sided=True)

    def scene(self, scene):
        more = replace(scene.chip, absorption_per_um=scene.chip.absorption_per_um + 1e-4 * self.more_per_cm)
        return with_chip(scene, lambda chip: more)
'''


@contextmanager
def started(folder: Path, *workers: tuple[str, ...]) -> Iterator[RunningSet]:
    """A set with these workers, once they have introduced themselves; its folders lie in `folder`."""
    folders: dict[str, Any] = {name: folder / name for name in ("cache", "runs", "effects")}
    at = RunningSet(Settings(router=free_endpoint(), **folders))
    try:
        at.settings.effects.mkdir()
        for argv in workers:
            at.add(*argv)
        wait_for(lambda: len(at.client.status(5.0).workers) == len(workers), "workers", 300.0)  # kernels are compiled
        yield at
    finally:
        at.close()


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningSet]:
    """Workers that compute nothing, but know the effects."""
    with started(tmp_path_factory.mktemp("set"), (PRETEND, "film"), (PRETEND, "ray")) as at:
        yield at


def model_file(at: RunningSet, name: str, *effects: AppliedEffect) -> str:
    """A file of the paper's model with these effects."""
    path = at.settings.effects.parent / f"{name}.toml"
    path.write_text(to_toml(find_model("paper").model_copy(update={"effects": effects})))
    return str(path)


def luxloop(at: RunningSet, *argv: str) -> subprocess.CompletedProcess[str]:
    """A command on the running set, in the folder that holds all."""
    return forks.luxloop(*argv, env=as_environment(at.settings), cwd=at.settings.effects.parent, timeout=300.0)


def said(at: RunningSet, *argv: str) -> dict[str, Any]:
    """The one object that a command prints with --json."""
    done = luxloop(at, *argv, "--json")
    assert done.returncode == 0, done.stderr + done.stdout
    return dict(json.loads(done.stdout))


def walked(at: RunningSet, run: str, model: str, evaluations: int = 6) -> RunJournal:
    """The journal of a random walk of two lanes, the same for every model."""
    campaign = Campaign(designer="random", seed=3, lanes=2, stop=Stop(evaluations=evaluations))
    launch(at.settings, campaign, model, run, local=False)
    return RunJournal(at.settings.runs_dir / run)


def tasks(journal: RunJournal) -> dict[tuple[int, int], tuple[str | None, str | None]]:
    """The ids of each step's tasks, film and rays, by lane and number."""
    return {(step.lane, step.number): (step.film_task_id, step.task_id) for step in journal.steps()}


def carried(journal: RunJournal, *topics: str) -> list[tuple[AppliedEffect, ...]]:
    """The different lists of effects in the requests that went to the workers."""
    asked = {canonical(entry.value.inputs["effects"]): entry.value for entry in journal.records(*topics)}
    return [tuple(map(AppliedEffect.model_validate, one.inputs["effects"])) for one in asked.values()]


@pytest.mark.parametrize(
    ("run", "argv"),
    [
        ("campaign", ("campaign", "run", "--designer", "random", "--evaluations", "6")),
        ("grid", ("grid", "--bounds", "paper-table3", "--step", STEPS)),
    ],
)
def test_every_request_carries_the_effects_and_the_journal_holds_them(
    running: RunningSet, run: str, argv: tuple[str, ...]
) -> None:
    """Films ahead of time and finalists too; plan and model file have them in their order; the journal verifies."""
    file = model_file(running, run, LOSS, INDEX)
    found = said(running, *argv, "--model", file, "--id", run, "--no-local")
    assert found["best"]["uniformity"] > 0.0
    journal = RunJournal(running.settings.runs_dir / run)
    for topic in ("/request/film", "/request/ray"):
        assert carried(journal, topic) == [(LOSS, INDEX)]
    assert len(list(journal.records("/request/ray"))) >= found["evaluations"]
    assert journal.attached("plan.json", Plan).effects == (LOSS, INDEX)
    model = parse_toml(journal.attachments()["model.toml"].decode(), "model.toml")
    assert (model.effects, model.sha256) == ((LOSS, INDEX), find_model(file).sha256)
    assert luxloop(running, "audit", "verify", run).returncode == 0
    assert said(running, "audit", "replay", run, "--level", "3")["counts"]["differs"] == 0


def test_task_ids_are_those_of_the_effects(running: RunningSet) -> None:
    """The same walk: no id in common without the effect or with another value, every id the same for the same one."""
    other = LOSS.model_copy(update={"parameters": {"absorption_per_cm": 399.0, "profile": "even"}})
    without, with_it, again, less = (
        tasks(walked(running, f"ids-{number}", model_file(running, f"ids-{number}", *effects)))
        for number, effects in enumerate(((), (LOSS,), (LOSS,), (other,)))
    )
    walk = [key for key in without if key in with_it and key[1] < 3]
    assert len(walk) == 6
    for key in walk:
        assert with_it[key] == again[key]
        for one, two in ((without, with_it), (with_it, less)):
            assert one[key][1] != two[key][1]
            assert one[key][0] is None or one[key][0] != two[key][0]


def test_a_simulation_is_of_the_model_with_its_effects(running: RunningSet) -> None:
    """What a worker makes of the request differs from that without them, and is the same for the same ones."""
    files = [model_file(running, f"simulate-{number}", *one) for number, one in enumerate(((), (LOSS,), (LOSS,)))]
    argv = ("--design", "180,40,500,20,0", "--histories", "1", "--model")
    without, with_it, again = (said(running, "simulate", *argv, file) for file in files)
    assert with_it["metrics"] == again["metrics"] != without["metrics"]
    assert with_it["model"]["sha256"] == again["model"]["sha256"] != without["model"]["sha256"]


def applied(name: str, **parameters: Any) -> AppliedEffect:
    """An effect of a model, whoever knows it."""
    return AppliedEffect(name=name, parameters=parameters)


@pytest.mark.parametrize(
    ("effects", "parts"),
    [
        ((applied("chip_absorbtion", absorption_per_cm=60.0),),
         ("effects.chip_absorbtion", "chip_absorbtion", "luxloop effects list", "did you mean chip_absorption?")),
        ((applied("chip_absorption", absorption_per_cm=900.0, profile="even"),),
         ("effects.chip_absorption.absorption_per_cm", "900.0", "0 to 500 1/cm", "added to the absorption")),
        ((applied("chip_absorption"),),
         ("effects.chip_absorption.absorption_per_cm", "None", "0 to 500 1/cm", "the parameter is missing")),
        ((LOSS, applied("dead_chip", power_ratio=0.5, chip=3.0), applied("chip_power_spread", gain=(0.1, 0.2))),
         ("effects", "dead_chip and chip_power_spread", "one of the two", "they say the same")),
        ((AppliedEffect(name="mine", parameters={"more_per_cm": 1.0}, source_sha256="0" * 64),),
         ("effects.mine", "0" * 64, "one of", "put its file into the workers' folder")),
    ],
    ids=("unknown", "out of range", "missing", "excluded", "not there"),
)  # fmt: skip
def test_effects_that_workers_refuse_are_refused_before_a_run_begins(
    running: RunningSet, effects: tuple[AppliedEffect, ...], parts: tuple[str, ...]
) -> None:
    """As bad input, with the model's file, field, value, range and mend; there is no folder of a run."""
    file = model_file(running, "refused", *effects)
    with pytest.raises(LuxloopError) as caught:
        walked(running, "refused", file)
    assert caught.value.exit_code == 2
    for part in (f"{file}: {parts[0]}", *parts[1:]):
        assert part in str(caught.value)
    assert not (running.settings.runs_dir / "refused").exists()


def test_a_grid_of_a_model_with_a_refused_effect_does_not_begin(running: RunningSet) -> None:
    """For machines: exit code 2, and one object with field, value, range, mend."""
    file = model_file(running, "no-grid", applied("chip_absorption", absorption_per_cm=900.0, profile="even"))
    done = luxloop(running, "grid", "--model", file, "--id", "no-grid", "--no-local", "--json")
    assert done.returncode == 2
    error = json.loads(done.stdout)["error"]
    assert error["field"] == "effects.chip_absorption.absorption_per_cm"
    assert (error["value"], error["allowed"]) == ("900.0", "0 to 500 1/cm")
    assert error["mend"]
    assert not (running.settings.runs_dir / "no-grid").exists()


def test_an_effect_that_stands_twice_is_refused_with_its_file(running: RunningSet) -> None:
    """By the file already: campaign, grid and simulation say the same."""
    file = Path(model_file(running, "twice", LOSS))
    stanza = file.read_text().partition("[[effects]]")[2]
    file.write_text(f"{file.read_text()}\n[[effects]]{stanza}")
    for command in (("campaign", "run"), ("simulate", "--preset", "S_b3")):
        done = luxloop(running, *command, "--model", str(file))
        assert done.returncode == 2
        assert all(word in done.stderr for word in ("twice.toml", "effects", "chip_absorption", "each name once"))


def test_a_method_that_an_effect_has_not_is_refused() -> None:
    """What the workers refuse of every design they refuse of the first question: here of a pretended history."""
    asked: list[Any] = []

    class Refusing:
        def run(self, request: Any, **_: Any) -> Any:
            asked.append(request)
            failure = Failure(code="bad_input", message="method: got 'twin', allowed: monte_carlo", field="method")
            raise RemoteError(failure)

    model = find_model("paper").model_copy(update={"effects": (LOSS,)})
    with pytest.raises(RemoteError, match=r"m\.toml: method: got 'twin', allowed: monte_carlo"):
        try_effects(Refusing(), model, "m.toml", DESIGN, "twin")  # type: ignore[arg-type]  # duck
    assert [(one.method, one.histories, one.effects) for one in asked] == [("twin", 1, (LOSS,))]
    low = DESIGN.model_copy(update={"distance_um": 10.0})
    try_effects(Refusing(), model, "m.toml", low, "twin")  # type: ignore[arg-type]  # duck
    try_effects(Refusing(), find_model("paper"), "paper", DESIGN, "twin")  # type: ignore[arg-type]  # duck
    assert len(asked) == 1  # a model without effects costs nothing, and so does what cannot be built


def lost_at(number: int, code: Any) -> Step:
    """A step of lane 0 whose worker refused it."""
    failure = Failure(code=code, message="not known", allowed="another source", mend="put it back")
    state = (0.0, 0.0, 0.0, 0.0, 0.0)
    return Step(
        run="one", lane=0, number=number, design=DESIGN, state=state, uniformity=0.0, reward=0.0, failure=failure
    )


def test_an_effect_without_influence_is_said_before_a_run_begins() -> None:
    """What the worker says of the model's effects comes through; its other warnings do not belong here."""
    told = [f"{LOSS.name} has no influence: it leaves this module as it is", "too few histories"]

    class Saying:
        def run(self, *_: Any, **__: Any) -> Any:
            return SimpleNamespace(result={"warnings": told})

    model = find_model("paper").model_copy(update={"effects": (LOSS,)})
    said = try_effects(Saying(), model, "m.toml", DESIGN, "monte_carlo")  # type: ignore[arg-type]  # duck
    assert said == told[:1]


def test_an_effect_that_is_lost_on_the_way_stops_the_run() -> None:
    """With how to go on; a lost worker does not, nor what is on record from an earlier start."""
    steps: list[Step] = []
    begun = SimpleNamespace(folder=str(load_settings().runs_dir / "one"))
    door = SimpleNamespace(run="one", designer="d", begun=begun, act=lambda *_: steps[-1])
    kept: Callable[[Any], Step] = EffectsKept(door, [lost_at(4, "unknown_effect")]).act  # type: ignore[arg-type]  # duck
    for step in (lost_at(3, "worker_lost"), lost_at(4, "unknown_effect")):
        steps.append(step)
        assert kept(None) is step
    steps.append(lost_at(5, "unknown_effect"))
    with pytest.raises(RemoteError, match="put it back; then luxloop campaign resume one"):
        kept(None)


def own(at: RunningSet, source: str) -> AppliedEffect:
    """The user's own effect, its file written into the workers' folder."""
    (at.settings.effects / "mine.py").write_text(source)
    sha256 = hashlib.sha256(source.encode()).hexdigest()
    return AppliedEffect(name="mine", parameters={"more_per_cm": 50.0}, source_sha256=sha256)


def test_only_the_source_that_a_model_names_goes_on_record(tmp_path: Path) -> None:
    """The shipped ones have none; a file that was changed, or is not there, is left out."""
    (tmp_path / "mine.py").write_text(MINE)
    sha256 = hashlib.sha256(MINE.encode()).hexdigest()

    def of(*effects: AppliedEffect) -> dict[str, str]:
        return sources(Model(name="m", effects=effects), tmp_path)

    mine = AppliedEffect(name="mine", source_sha256=sha256)
    assert of(LOSS, mine) == {"mine.py": MINE}
    assert of(LOSS, mine.model_copy(update={"source_sha256": "0" * 64})) == {}
    assert of(mine.model_copy(update={"name": "yours"})) == {}


def look_again(at: RunningSet, effect: AppliedEffect) -> None:
    """Let the ray worker look through its folder: asked for a source that it has not."""
    request = RayRequest(environment=find_model("paper").environment, design=DESIGN, histories=1, effects=(
        effect.model_copy(update={"source_sha256": "0" * 64}),))  # fmt: skip
    with pytest.raises(RemoteError, match="unknown_effect"):
        at.client.run(request)


def steps_on_record(folder: Path) -> int:
    """How many steps a run has so far; 0 where its journal has not begun."""
    try:
        return len(list(RunJournal(folder).steps()))
    except InputError:
        return 0


@pytest.mark.slow
def test_a_users_own_effect_that_is_edited_during_a_run_stops_it_until_it_is_put_back(tmp_path: Path) -> None:
    """The hash is in every request; the run says both hashes and can be gone on with, once the file is as it was."""
    with started(tmp_path, (PRETEND, "film"), (PRETEND, "ray", "0.1")) as at:
        mine = own(at, MINE)
        file, ends = model_file(at, "own", mine), list[subprocess.CompletedProcess[str]]()
        argv = ("campaign", "run", "--designer", "random", "--evaluations", "12", "--id", "own", "--no-local")
        run = Thread(target=lambda: ends.append(luxloop(at, *argv, "--model", file)))
        run.start()
        folder = at.settings.runs_dir / "own"
        wait_for(lambda: steps_on_record(folder) > 2, "some steps", 60.0)
        edited = own(at, MINE + "# edited\n")
        look_again(at, edited)
        run.join(60.0)
        (ended,) = ends
        assert ended.returncode == 2
        for word in ("effect mine", mine.source_sha256, edited.source_sha256, "luxloop campaign resume own"):
            assert str(word) in ended.stderr
        assert carried(RunJournal(folder), "/request/ray", "/request/film") == [(mine,)]
        assert RunJournal(folder).attachments()["mine.py"] == MINE.encode()
        assert luxloop(at, "audit", "verify", "own").returncode == 0
        refused = luxloop(at, "campaign", "resume", "own", "--no-local")
        assert refused.returncode == 2
        assert str(edited.source_sha256) in refused.stderr
        own(at, MINE)
        found = said(at, "campaign", "resume", "own", "--no-local")
        assert found["reason"] == "budget: 12 evaluations"
        assert said(at, "audit", "replay", "own", "--level", "3")["counts"]["differs"] == 0


@pytest.mark.slow
def test_the_physics_of_a_campaign_are_those_of_its_effects(tmp_path: Path) -> None:
    """Real workers: every level of a replay is good, and the winner is shown under the model with and without."""
    workers = (("-m", "luxloop", "serve", role, "--quiet") for role in ("thin-film", "ray-tracing"))
    with started(tmp_path, *workers) as at:
        bare, lossy = model_file(at, "bare"), model_file(at, "lossy", LOSS, INDEX)
        short = tmp_path / "short.toml"
        short.write_text('designer = "random"\nfinalists = 1\nwalk_error_points = 5.0\nfinal_error_points = 4.0')
        argv = ("--config", str(short), "--evaluations", "2", "--id", "real", "--no-local")
        said(at, "campaign", "run", "--model", lossy, *argv)
        for level in (("2",), ("3",), ("4", "--router", at.settings.router)):
            replayed = said(at, "audit", "replay", "real", "--level", *level)
            assert replayed["counts"]["differs"] == replayed["counts"]["not comparable"] == 0
        ask = ("campaign", "report", "real", "--under", bare, "--under", lossy, "--out", str(tmp_path / "r.html"))
        document = said(at, *ask)
        rows = document["under"]["rows"]
        assert [(row["run"], row["model"]) for row in rows] == [("real", bare), ("real", lossy)]
        assert document["model"]["effects"] == [LOSS.name, INDEX.name]
        (change,) = document["under"]["differences"]
        light = change["illuminance_ratio"]
        assert light["value"] < 1.0 - 5.0 * light["standard_error"]  # the chip absorbs more
        assert rows[1]["model_sha256"] == find_model(lossy).sha256 == document["model"]["sha256"]
        refused = luxloop(at, *ask, "--under", model_file(at, "no", applied("nobody")), "--json")
        assert refused.returncode == 2
        assert "effects.nobody" in refused.stderr


def test_a_model_is_another_one_with_an_effect() -> None:
    """Its hash, by which versions and runs name it, is of environment and effects in their order."""
    models = [Model(name=str(n), effects=effects) for n, effects in enumerate(((), (LOSS, INDEX), (INDEX, LOSS)))]
    assert len({model.sha256 for model in models}) == 3
