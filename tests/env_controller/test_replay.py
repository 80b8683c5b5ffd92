"""`luxloop audit replay`: recorded campaigns are the same again, on any machine within their errors."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from typer.testing import CliRunner

from env_controller.audit import scores
from env_controller.audit.machine import machine, other_bits
from env_controller.audit.rederive import first_leaves
from env_controller.audit.reexecute import Asked, Choice, Question, array_sha256, chosen, compare, re_execute
from env_controller.audit.replay import Replay, Tally, verified
from env_controller.audit.replay_command import as_text
from luxloop.audit import Compared, Place
from luxloop.client import Answer, Client
from luxloop.design import Bounds
from luxloop.errors import InputError, RemoteError
from luxloop.failure import Failure
from luxloop.journal.journal import Journal
from luxloop.journal.reader import RunJournal
from luxloop.journal.topics import ReplyRecord
from luxloop.messages import Task
from luxloop.settings import Settings
from tests.env_controller.golden_runs import GOLDEN, NAMES, app, ask
from tests.running_set import RunningSet

PRETEND = str(Path(__file__).parents[1] / "pretend_worker.py")
HERE = not other_bits(RunJournal(GOLDEN / NAMES[0]).metadata("environment"))
"""Whether the golden runs come from a machine like this one: bits are demanded only then."""


@pytest.mark.parametrize("name", NAMES)
def test_a_recorded_campaign_is_what_was_written(name: str) -> None:
    """Level 1 of the golden runs: every line is ok."""
    code, document = ask(GOLDEN / name, 1)
    assert code == 0
    assert {one["verdict"] for one in document["findings"]} == {"ok"}


@pytest.mark.parametrize("name", NAMES)
def test_a_recorded_campaign_is_derived_again(name: str) -> None:
    """Level 2: everything of the controller is identical, on any machine; the physics' figures hold to rounding."""
    code, document = ask(GOLDEN / name, 2)
    assert (code, document["counts"]["differs"]) == (0, 0)
    assert document["counts"]["not comparable"] <= 1  # a receiver so near that a map does not hold its light
    exact = ("design", "state", "feasibility", "uniformity", "figures", "ray request", "map")
    assert [document["compared"][what] for what in exact] == [{"identical": 10}] * len(exact)
    finer = document["compared"].get("figures, map", {}).get("not comparable", 0)
    assert sum(document["compared"]["uniformity, map"].values()) + finer == 10
    assert sum(document["compared"]["uniformity, cut"].values()) == 4


@pytest.mark.parametrize("name", NAMES)
def test_a_recorded_designer_decides_the_same(name: str) -> None:
    """Level 3: every proposal, and on a machine like the recording one every weight to the last bit."""
    code, document = ask(GOLDEN / name, 3)
    assert (code, document["counts"]["differs"]) == (0, 0)
    assert document["compared"]["proposal"] == document["compared"]["move"] == {"identical": 10}
    assert sum(what.startswith("result, ") for what in document["compared"]) == 8
    assert document["compared"]["seed"] == {"identical": 4}
    assert document["compared"]["end of the walk"] == {"identical": 1}
    assert max(entry.value.updates for entry in RunJournal(GOLDEN / name).records("/agent")) >= 3
    if HERE:
        assert document["counts"]["within tolerance"] == document["counts"]["not comparable"] == 0


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_a_recorded_campaign_is_computed_again(
    name: str, settings: Settings, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Level 4 with real workers: equal bits on a machine like the recording one, within the errors elsewhere."""
    monkeypatch.setenv("LUXLOOP_CACHE", str(settings.cache_dir))
    code, document = ask(GOLDEN / name, 4, "--router", settings.router)
    assert (code, document["counts"]["differs"]) == (0, 0)
    if HERE:
        assert document["compared"]["result"] == document["compared"]["array map_lx"] == {"identical": 10}


@pytest.mark.slow
def test_a_new_seed_gives_the_same_within_the_errors(settings: Settings, monkeypatch: pytest.MonkeyPatch) -> None:
    """The golden Monte Carlo run with other random numbers: the z of 10 evaluations are those of right errors."""
    monkeypatch.setenv("LUXLOOP_CACHE", str(settings.cache_dir))
    code, document = ask(GOLDEN / NAMES[0], 4, "--router", settings.router, "--new-seed")
    assert (code, document["counts"]["differs"]) == (0, 0)
    z = document["z"]["uniformity"]
    assert z["count"] == 10
    assert 0.1 < z["chi2_per_count"] < 4.0


def test_a_flipped_bit_ends_every_level(tmp_path: Path) -> None:
    """A damaged file is told as level 1 tells it, with exit 5."""
    shutil.copytree(GOLDEN / NAMES[0], tmp_path / "r")
    path = tmp_path / "r" / "audit-0001.mcap"
    raw = bytearray(path.read_bytes())
    raw[90_000] ^= 4
    path.write_bytes(raw)
    for level in (1, 2, 3, 4):
        code, document = ask(tmp_path / "r", level)
        assert (code, document["counts"]["identical"]) == (5, 0)


def test_a_run_that_was_killed_is_replayed_as_far_as_it_goes(tmp_path: Path) -> None:
    """Its file breaks off: the steps on record are the same again, nothing differs."""
    (tmp_path / "r").mkdir()
    raw = (GOLDEN / NAMES[0] / "audit-0001.mcap").read_bytes()
    (tmp_path / "r" / "audit-0001.mcap").write_bytes(raw[:60_000])
    steps = len(list(RunJournal(tmp_path / "r").steps()))
    assert 2 <= steps < 6
    for level, what in ((2, "state"), (3, "proposal")):
        code, document = ask(tmp_path / "r", level)
        assert (code, document["compared"][what]) == (0, {"identical": steps})


@pytest.mark.parametrize(
    ("argv", "field"),
    [
        (["--level", "4", "--sample", "2"], "--sample"),
        (["--level", "4", "--sample", "0%"], "--sample"),
        (["--level", "4", "--best", "--all"], "--best"),
        (["--level", "2", "--new-seed"], "--new-seed"),
        (["--level", "3", "--best"], "--best"),
        (["--start", "0"], "--start"),
        (["--level", "4", "--topics", "/step"], "--topics"),
        (["--level", "1", "--rate", "1"], "--rate"),
        (["--level", "3", "--paused"], "--paused"),
        (["--level", "2", "--no-local"], "--no-local"),
        (["--level", "1", "--router", "tcp/127.0.0.1:7447"], "--router"),
    ],
)
def test_options_that_do_not_go_together_are_refused(argv: list[str], field: str) -> None:
    """Before anything is read: the option is named, with what is allowed."""
    with pytest.raises(InputError, match=field):
        CliRunner().invoke(app, [str(GOLDEN / NAMES[0]), *argv], catch_exceptions=False)


def test_a_level_that_there_is_not_is_bad_usage() -> None:
    """Exit 2."""
    assert CliRunner().invoke(app, [str(GOLDEN / NAMES[0]), "--level", "6"]).exit_code == 2


def test_a_sample_is_drawn_by_the_root() -> None:
    """The same one every time, of the wanted size; the best is the winner's last evaluation."""
    journal = RunJournal(GOLDEN / NAMES[0])
    sequences = [[one.sequence for one in chosen(journal, Choice(share=0.5)).questions] for _ in range(2)]
    assert sequences[0] == sequences[1]
    assert len(sequences[0]) == 5
    (best,) = chosen(journal, Choice(best=True)).questions
    assert best.step.role == "best"
    assert len(chosen(journal, Choice()).questions) == 10


class Said(list[Compared]):
    """What was compared."""

    def place(self) -> Place:
        """Where a comparison is made."""
        return Place(self.append, 0)

    @property
    def verdicts(self) -> dict[str, str]:
        """Verdicts by name."""
        return {one.what: one.verdict for one in self}


@pytest.fixture
def question() -> Question:
    """The best design's evaluation in the golden Monte Carlo run."""
    return chosen(RunJournal(GOLDEN / NAMES[0]), Choice(best=True)).questions[0]


def answer_to(question: Question, sigmas: float = 0.0, pixel: float = 1.0) -> Answer:
    """The answer on record, its uniformity off by so many errors, one pixel by a factor."""
    result = json.loads(json.dumps(question.reply.result))
    uniformity = result["metrics"]["uniformity"]
    uniformity["value"] += sigmas * uniformity["standard_error"]
    assert question.map_lx is not None
    map_lx = question.map_lx.copy()
    map_lx[4, 7] *= pixel
    arrays = {"map_lx": map_lx, "map_error_lx": np.full_like(map_lx, 0.005 * map_lx.mean())}
    return Answer(result, arrays, "ray-1", 1, 0.1)


def compared(question: Question, answer: Answer, **how: bool) -> dict[str, str]:
    """The verdicts of a comparison; the errors of the map are made up, so their hash is left out."""
    arrays = {name: sha for name, sha in question.reply.arrays.items() if name == "map_lx"}
    reply = question.reply.model_copy(update={"arrays": arrays})
    known = Question(question.step, question.sequence, question.request, reply, question.map_lx)
    said = Said()
    compare(known, answer, said.place(), **{"same_bits": False, "new_seed": False} | how)
    return said.verdicts


def test_equal_bits_are_identical_anywhere(question: Question) -> None:
    """Document, arrays, and the map on record."""
    for same in (True, False):
        found = compared(question, answer_to(question), same_bits=same)
        assert found == dict.fromkeys(("result", "array map_lx", "map on record"), "identical")


def test_where_bits_are_demanded_nothing_else_will_do(question: Question) -> None:
    """A uniformity that is off by a hundredth of its error differs on the machine of the record."""
    found = compared(question, answer_to(question, sigmas=0.01), same_bits=True)
    assert found["result"] == "differs"


def test_on_another_machine_errors_decide(question: Question) -> None:
    """Off by its error: within tolerance. Off by ten, or one pixel twice as bright: differs."""
    assert compared(question, answer_to(question, sigmas=1.0))["uniformity"] == "within tolerance"
    assert compared(question, answer_to(question, sigmas=10.0))["uniformity"] == "differs"
    assert compared(question, answer_to(question, sigmas=0.1, pixel=2.0))["worst pixel"] == "differs"


def test_with_a_new_seed_bits_are_not_looked_at(question: Question) -> None:
    """Even equal ones are compared in their errors, which gives z = 0."""
    found = compared(question, answer_to(question), new_seed=True, same_bits=True)
    assert set(found.values()) == {"within tolerance"}


def test_z_of_right_errors_have_mean_square_one() -> None:
    """10,000 pairs of normal numbers with known errors; counts of the histogram add up."""
    random = np.random.default_rng(1)
    now, logged = random.normal(0.0, 0.3, 10_000), random.normal(0.0, 0.4, 10_000)
    z = [scores.z_of(a, 0.3, b, 0.4) for a, b in zip(now, logged, strict=True)]
    found = scores.summary([one for one in z if one is not None])
    assert found["chi2_per_count"] == pytest.approx(1.0, abs=0.05)
    assert sum(found["histogram"]["counts"]) == 10_000
    assert found["histogram"]["counts"][0] == sum(one < -3.0 for one in z if one is not None)
    assert len(scores.as_text("uniformity", found)) == 1 + len(found["histogram"]["counts"])


def test_a_number_without_error_agrees_with_itself_only() -> None:
    """0 where both are equal, nothing where they are not."""
    assert scores.z_of(1.0, 0.0, 1.0, 0.0) == 0.0
    assert scores.z_of(1.0, 0.0, 1.1, 0.0) is None


def test_the_first_difference_is_the_first_of_the_journal() -> None:
    """Not the first that was said: lanes are compared in several threads."""
    tally = Tally()
    for sequence in (7, 3, 5, -1):
        tally.take(Compared("reward", "differs", sequence))
    assert [one.sequence for one in tally.first(9)] == [3, 5, 7, -1]
    assert tally.exit_code == 4


def test_nothing_comparable_is_no_success() -> None:
    """Exit 1: that a run without its plan does not differ says nothing."""
    tally = Tally()
    tally.take(Compared("proposal", "not comparable"))
    assert tally.exit_code == 1
    tally.take(Compared("proposal", "within tolerance"))
    assert tally.exit_code == 0


def test_films_alone_are_no_success() -> None:
    """The films were the same again, and no evaluation could be had: that says nothing of the run."""
    tally = Tally()
    Place(tally.take).exact("film", "a", "a")
    Place(tally.take, 3).nothing("result", "the ray worker says: an unknown field")
    assert tally.exit_code == 1
    found = Replay(GOLDEN / NAMES[0], 4, verified(GOLDEN / NAMES[0], 1).audit, tally, {})
    assert as_text(found.document(), found)[-1] == "verdict      nothing could be compared, but films"
    Place(tally.take, 4).exact("result", 1, 1)
    assert tally.exit_code == 0


def test_an_evaluation_whose_reply_is_lost_is_told(tmp_path: Path) -> None:
    """It cannot be compared, and is counted as such; where all are lost no worker is asked."""
    record = chosen(RunJournal(GOLDEN / NAMES[0]), Choice(best=True))
    (question,), said = record.questions, Said()
    lost = replace(record, questions=[], films={}, lost=[(question.sequence, question.step)])
    re_execute(lost, Settings(router="tcp/127.0.0.1:9", cache=tmp_path), said.append, same_machine=True, local=False)
    assert [(one.what, one.verdict, one.sequence) for one in said] == [
        ("result", "not comparable", question.sequence)
    ]


def test_what_is_none_and_what_is_not_there_are_two_things() -> None:
    """A leaf that is gone, an empty group that is gone."""
    assert first_leaves({"a": None, "b": 1}, {"b": 1}) == ({"a": None}, {"a": "not there"})
    assert first_leaves({"a": {}, "b": 1}, {"b": 1}) == ({"a": {}, "b": 1}, {"b": 1})
    assert first_leaves({"a": 1}, {"a": 1}) == ({"a": 1}, {"a": 1})


def test_versions_that_differ_are_named() -> None:
    """Another numpy is told, another host or process id is not; a record without facts is of an unknown machine."""
    facts = machine()
    assert other_bits({**facts, "pid": "1", "host": "other"}) == {}
    assert other_bits({**facts, "numpy": "1.0"}) == {"numpy": ("1.0", facts["numpy"])}
    assert other_bits({})["processor"] == ("unknown", facts["processor"])


def test_every_start_of_a_run_is_looked_at(tmp_path: Path) -> None:
    """Begun elsewhere and gone on with here: its first steps' bits are another machine's."""
    for numpy in ("1.26.0", machine()["numpy"]):
        attached = {"packages.txt": f"torch=={'2.0.0' if numpy == '1.26.0' else machine()['torch']}".encode()}
        facts = {**machine(), "numpy": numpy, "torch": "not installed"}
        journal = Journal(tmp_path, {"run": {}, "environment": facts}, attached)
        journal.finish()
        journal.close()
    now = machine()
    assert verified(tmp_path, 1).other == {"numpy": ("1.26.0", now["numpy"]), "torch": ("2.0.0", now["torch"])}


def test_a_run_in_which_nothing_was_evaluated_has_nothing_to_compare(tmp_path: Path) -> None:
    """Exit 1 at level 4, as at the others."""
    journal = Journal(tmp_path / "bare", {"run": {}}, {})
    journal.finish()
    journal.close()
    code, document = ask(tmp_path / "bare", 4, "--no-local")
    assert (code, document["reasons"]) == (1, {"result, not comparable": {"nothing was evaluated": 1}})


def test_no_name_of_a_machine_is_on_record() -> None:
    """Of the host there is a digest."""
    import platform

    assert platform.node() not in machine().values()
    assert len(machine()["host"]) == 12


def test_verify_comes_first(tmp_path: Path) -> None:
    """A replay knows the chain's root before anything is compared."""
    found = verified(GOLDEN / NAMES[0], 2)
    root, _, records = (GOLDEN / NAMES[0] / "audit.sha256").read_text().strip().partition(" ")
    assert isinstance(found, Replay)
    assert (found.audit.mark.root, found.audit.mark.records) == (root, int(records))
    with pytest.raises(InputError):
        verified(tmp_path, 2)


@pytest.fixture
def pretenders(settings: Settings) -> Iterator[RunningSet]:
    """A set whose workers answer without computing."""
    made = RunningSet(settings)
    made.add(PRETEND, "film")
    made.add(PRETEND, "ray")
    made.ready(2)
    yield made
    made.close()


def test_workers_are_asked_again_over_the_bus(pretenders: RunningSet) -> None:
    """A campaign on pretending workers is done again by them: the same, and with new seeds within its errors."""
    from agent.config import Campaign, Stop
    from agent.launch import launch

    preset = Bounds.preset("paper-table3")
    bare = {name: getattr(preset, name).model_copy(update={"dbr_pairs": 0.0}) for name in ("low", "high")}
    bounds = preset.model_copy(update=bare)  # films are computed again in the next test
    campaign = Campaign(designer="random", lanes=2, finalists=1, bounds=bounds, stop=Stop(evaluations=6))
    launched = launch(pretenders.settings, campaign, "paper", "one", local=False)
    folder, router = Path(launched.ended.folder), pretenders.settings.router
    code, document = ask(folder, 4, "--router", router, "--no-local")
    assert (code, document["compared"]["result"]) == (0, {"identical": 9})
    assert document["compared"]["map on record"] == {"identical": 9}
    code, document = ask(folder, 4, "--router", router, "--no-local", "--new-seed", "--sample", "50%")
    assert (code, document["z"]["uniformity"]["count"]) == (0, 4)
    assert document["z"]["uniformity"]["largest"] < 1.0


class Workers:
    """In place of a client: answers as on record; `table` is another film's hash, `refuses` a kind of task."""

    def __init__(self, journal: RunJournal, table: str = "", refuses: str = "") -> None:
        self.table, self.refuses, self.asked = table, refuses, list[Task]()
        self._replies = {one.value.task_id: one.value for one in journal.records("/reply/film", "/reply/ray")}
        requests = (one.value for one in journal.records("/request/film", "/request/ray"))
        self._by_design = {self._key(one.inputs): one.task_id for one in requests}

    def run(self, task: Task, **how: Any) -> Answer:
        """The answer on record to the same question."""
        assert how["fresh"]
        self.asked.append(task)
        if task.kind == self.refuses:
            raise RemoteError(Failure(code="bad_input", message="an unknown field"))
        result = dict(self._replies[self._by_design[self._key(task.inputs)]].result)
        if task.kind == "film" and self.table:
            result |= {"table_sha256": self.table, "known": True}
        return Answer(result, {}, "w", 1, 0.1)

    @staticmethod
    def _key(inputs: dict[str, Any]) -> str:
        return json.dumps([inputs.get(name) for name in ("design", "dbr_pairs", "seed")])


@pytest.mark.parametrize("same", [True, False])
def test_rays_are_asked_with_the_film_of_today(same: bool) -> None:
    """A table of other bits differs on the machine of the record, and says nothing elsewhere; the rays name it."""
    journal, said = RunJournal(GOLDEN / NAMES[0]), Said()
    record, workers = chosen(journal, Choice()), Workers(journal, table="a" * 64)
    asked = Asked(cast(Client, workers), said.append, same, False)
    tables = {sha: asked.film(*film) for sha, film in record.films.items()}
    bare = [replace(one, map_lx=None, reply=one.reply.model_copy(update={"arrays": {}})) for one in record.questions]
    asked.rays(bare, tables, 2)
    assert said.verdicts["film"] == ("differs" if same else "not comparable")
    assert said.verdicts["result"] == "identical"
    seeds = sorted(task.inputs["seed"] for task in workers.asked if task.kind == "ray")
    assert seeds == sorted(one.request.inputs["seed"] for one in record.questions)
    films = [task.inputs["film"] for task in workers.asked if task.kind == "ray" and task.inputs["film"]]
    assert {film["sha256"] for film in films} == {"a" * 64}


def test_what_this_release_cannot_be_asked_is_not_comparable() -> None:
    """A worker that refuses the film's request: its rays cannot be had either, and it is said why."""
    journal, said = RunJournal(GOLDEN / NAMES[0]), Said()
    record, workers = chosen(journal, Choice(best=True)), Workers(journal, refuses="film")
    asked = Asked(cast(Client, workers), said.append, True, False)
    asked.rays(record.questions, {sha: asked.film(*film) for sha, film in record.films.items()}, 1)
    assert [one.verdict for one in said] == ["not comparable"] * 2
    assert "an unknown field" in said[0].why


def test_hashes_are_of_little_endian_bytes() -> None:
    """The order of bytes in memory does not matter."""
    values = np.arange(6.0).reshape(2, 3)
    assert array_sha256(values) == array_sha256(values.astype(">f8"))


def test_a_reply_is_what_it_is_said_to_be(question: Question) -> None:
    """The map on record has the hash that came with its reply."""
    assert isinstance(question.reply, ReplyRecord)
    assert question.map_lx is not None
    assert array_sha256(question.map_lx) == question.reply.arrays["map_lx"]
