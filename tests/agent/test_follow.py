"""`luxloop campaign status`: how a run stands; with --follow, each new step of a journal or of a replay."""

from __future__ import annotations

import json
import shlex
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import pytest
import typer
from typer.testing import CliRunner

from agent import runs_command
from agent.follow import Listener, Seen, evaluations_of, from_journal, name_of, played, status_line
from agent.live import View
from agent.overview import overview
from agent.progress import Progress
from env_controller.audit.playback import Pace, frame_of, publish
from luxloop.bus.frame import encode
from luxloop.bus.keys import at
from luxloop.errors import InputError
from luxloop.journal.reader import RunJournal
from luxloop.journal.topics import Record
from luxloop.messages import Replayed
from luxloop.settings import Settings, as_environment
from tests.agent.test_live import shown
from tests.campaign_runs import ARGV, START, RunOnDisk, plan_of, whole_run
from tests.conftest import wait_for
from tests.env_controller.test_compact import interrupted, three_starts
from tests.local_bus import LocalBus, LocalRouter

app = typer.Typer()
app.command()(runs_command.status)


def ask(*argv: object) -> list[dict[str, Any]]:
    """The JSON lines of a command that succeeds."""
    done = CliRunner().invoke(app, [*map(str, argv), "--json"], catch_exceptions=False)
    assert done.exit_code == 0
    return [json.loads(line) for line in done.stdout.splitlines()]


def state(folder: Path) -> tuple[str, str, str]:
    """State, reason and mend."""
    row = overview(folder)
    return row["state"], row["reason"], row["mend"]


def test_a_run_is_running_then_killed_then_resumed_then_over(tmp_path: Path) -> None:
    """Each with its reason, and with the command that goes on where that helps."""
    folder = tmp_path / "trial"
    run = RunOnDisk(folder)
    run.evaluated(START, 0.7, episode=0)
    assert state(folder) == ("running", "", "")
    run.close()
    mend = f"luxloop campaign resume trial --runs {tmp_path}"  # no run of the folder where one looks
    assert state(folder) == ("killed", "its journal has no end, and nobody writes it", mend)
    run = RunOnDisk(folder)
    run.finish("interrupted", complete=False)
    assert state(folder) == ("interrupted", "interrupted", mend)
    run = RunOnDisk(folder)
    run.finish("the controller was stopped", complete=False)
    assert state(folder) == ("interrupted", "the controller was stopped", mend)
    assert not overview(folder)["finished"]
    run = RunOnDisk(folder)
    run.note({"reason": "budget: 12 evaluations"})
    run.finish()
    assert state(folder) == ("ended", "budget: 12 evaluations", "")
    assert overview(folder)["finished"]


def test_a_comparison_that_was_interrupted_is_to_be_done_again(tmp_path: Path) -> None:
    """`campaign resume` goes on with no run of that kind: its own command is told, as it was given."""
    run = RunOnDisk(tmp_path / "trial", plan_of(kind="validation"))
    run.close()
    mend = shlex.join(["luxloop", *ARGV])
    assert state(tmp_path / "trial")[2] == mend
    run = RunOnDisk(tmp_path / "trial", plan_of(kind="validation"))
    run.finish("left early", complete=False)
    row = overview(tmp_path / "trial")
    assert row["mend"] == mend
    assert status_line(row).endswith(f"; to do it again: {mend}")
    assert status_line(row | {"kind": "campaign"}).endswith(f"; to go on: {mend}")


def test_a_killed_start_after_an_end_is_killed(tmp_path: Path) -> None:
    """The last segment counts, not the end of an earlier one."""
    whole_run(tmp_path / "trial")
    RunOnDisk(tmp_path / "trial").close()
    assert state(tmp_path / "trial")[0] == "killed"


def test_status_says_state_reason_and_mend(tmp_path: Path) -> None:
    """For people and as one object."""
    run = RunOnDisk(tmp_path / "trial")
    run.evaluated(START, 0.7, episode=0)
    run.close()
    (row,) = ask("trial", "--runs", tmp_path)
    assert (row["state"], row["mend"]) == ("killed", f"luxloop campaign resume trial --runs {tmp_path}")
    text = CliRunner().invoke(app, ["trial", "--runs", str(tmp_path)]).stdout
    assert f"luxloop campaign resume trial --runs {tmp_path}" in text
    assert "killed" in text


def test_a_journal_is_followed_while_it_grows(tmp_path: Path) -> None:
    """Two steps were there, three come; the follower gets all of them in order, then the end."""
    folder = tmp_path / "trial"
    run = RunOnDisk(folder)
    told: list[Record] = []
    for number in range(2):
        run.evaluated(START, 0.7 + 0.01 * number, episode=0)
    follower = threading.Thread(target=lambda: told.extend(from_journal(folder)))
    follower.start()
    wait_for(lambda: _steps(told) == 2, "the steps that were there")
    for number in range(2, 5):
        run.evaluated(START, 0.7 + 0.01 * number, episode=1)
        wait_for(lambda number=number: _steps(told) == number + 1, "the next step")  # type: ignore[misc]
    run.note({"reason": "done"})
    run.finish()
    follower.join(20)
    assert not follower.is_alive()
    assert told == list(RunJournal(folder).records("/step", "/agent", "/log"))
    seen = Seen()
    for entry in told:
        seen.take(entry)
    assert (seen.progress.steps, seen.progress.evaluations, seen.progress.episodes) == (5, 1, 2)
    assert seen.reason == "budget: 12 evaluations"


def test_a_killed_writer_ends_it_and_a_new_start_goes_on_with_it(tmp_path: Path) -> None:
    """The follower goes over to the next segment; without one it ends."""
    folder = tmp_path / "trial"
    first = RunOnDisk(folder)
    first.evaluated(START, 0.7)
    told: list[Record] = []
    source = from_journal(folder)
    told.append(next(source))
    first.close()
    second = RunOnDisk(folder)
    second.evaluated(START, 0.8)
    told.append(next(source))
    second.close()
    assert [entry.value.uniformity for entry in told] == [0.7, 0.8]
    assert list(source) == []


def test_what_an_interrupted_compaction_left_is_told_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The segments that the first one holds too are no news."""
    folder = tmp_path / "trial"
    three_starts(folder)
    records = list(RunJournal(folder).records("/step", "/agent", "/log"))
    interrupted(folder, monkeypatch)
    assert list(from_journal(folder)) == records


def test_what_is_followed_is_told_from_the_next_step_on(tmp_path: Path) -> None:
    """As JSON lines: how it stands, each new step, how it ended; what lay there before is in the first line."""
    folder = tmp_path / "trial"
    run = RunOnDisk(folder)
    run.evaluated(START, 0.7, episode=0)
    command = [sys.executable, "-m", "luxloop", "campaign", "status", str(folder), "--follow", "--json"]
    follower = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert follower.stdout is not None
    first = json.loads(follower.stdout.readline())
    assert (first["event"], first["state"], first["steps"]) == ("status", "running", 1)
    run.evaluated(START, 0.75, episode=0)
    step = json.loads(follower.stdout.readline())
    assert (step["event"], step["sequence"], step["uniformity"]) == ("step", 1, 0.75)
    run.note({"reason": "budget"})
    run.finish("budget: 2 evaluations")
    end = json.loads(follower.stdout.readline())
    assert (end["event"], end["state"], end["reason"], end["steps"]) == ("end", "ended", "budget: 2 evaluations", 2)
    assert follower.wait(20) == 0
    follower.stdout.close()


def test_a_run_that_is_over_is_told_once(tmp_path: Path) -> None:
    """Status and end at once; for people, one line."""
    steps = whole_run(tmp_path / "trial")
    first, last = ask("trial", "--runs", tmp_path, "--follow")
    assert (first["event"], last["event"], last["state"]) == ("status", "end", "ended")
    text = CliRunner().invoke(app, ["trial", "--runs", str(tmp_path), "--follow"]).stdout
    assert text.count("ended (budget: 12 evaluations)") == text.count("\n") == 1
    assert f"{100 * steps['again'].uniformity:.2f}" in text


def heard(folder: Path, **played_how: Any) -> tuple[Listener, list[Record]]:
    """A listener on a bus in this process, and what it got of a run that was played."""
    router, told = LocalRouter(), list[Record]()
    with LocalBus(router) as ours, LocalBus(router) as theirs:
        listener = Listener(ours, "lab", "trial")
        thread = threading.Thread(target=lambda: told.extend(listener.records()))
        thread.start()
        wait_for(lambda: ours._watches, "the listener")
        records = RunJournal(folder).records()
        publish(theirs, "lab", "trial", records, Pace(0.0, lambda _: False), **played_how)
        thread.join(20)
        assert not thread.is_alive()
    return listener, told


def test_a_replay_is_followed_like_the_journal(tmp_path: Path) -> None:
    """The records that are heard are those of the journal, byte for byte, so the view is the same."""
    whole_run(tmp_path / "trial")
    listener, told = heard(tmp_path / "trial")
    assert told == list(RunJournal(tmp_path / "trial").records())
    assert (listener.late, listener.missed) == (0, 0)
    views = []
    for records in (told, from_journal(tmp_path / "trial")):
        seen = Seen()
        for entry in records:
            seen.take(entry)
        progress = seen.progress
        views.append((progress.steps, progress.evaluations, progress.episodes, progress.epsilon, progress.best))
    assert views[0] == views[1]
    assert views[0][0] == overview(tmp_path / "trial")["steps"]


def test_who_comes_late_or_misses_some_is_told(tmp_path: Path) -> None:
    """By the numbers of what is heard."""
    whole_run(tmp_path / "trial")
    records = list(RunJournal(tmp_path / "trial").records())
    router, told = LocalRouter(), list[Record]()
    with LocalBus(router) as ours, LocalBus(router) as theirs:
        listener = Listener(ours, "lab", "trial")
        thread = threading.Thread(target=lambda: told.extend(listener.records()))
        thread.start()
        wait_for(lambda: ours._watches, "the listener")
        key = at("lab", "replay", name="trial")
        for place in (5, 6, 9):
            theirs.publish(key, frame_of("trial", place, records[place]))
        theirs.publish(key, encode(Replayed(run="trial", place=10)))
        thread.join(20)
    assert (listener.late, listener.missed) == (5, 2)
    assert told == [records[5], records[6], records[9]]


def test_a_player_that_was_killed_ends_the_view() -> None:
    """Its presence vanishes."""
    router = LocalRouter()
    told: list[Record] = []
    with LocalBus(router) as ours:
        theirs = LocalBus(router)
        theirs.announce(at("lab", "alive", role="designer", kind="replay", name="trial"))
        listener = Listener(ours, "lab", "trial")
        thread = threading.Thread(target=lambda: told.extend(listener.records()))
        thread.start()
        wait_for(lambda: ours._watches, "the listener")
        theirs.close()
        thread.join(20)
        assert not thread.is_alive()
    assert told == []


def test_a_router_that_stays_away_ends_what_was_heard(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """After a while; before anything was heard it is waited for."""
    monkeypatch.setattr("agent.follow.AWAY_S", 0.3)
    monkeypatch.setattr(LocalBus, "connected", lambda _: False)
    whole_run(tmp_path / "trial")
    entry = next(RunJournal(tmp_path / "trial").records())
    router = LocalRouter()
    with LocalBus(router) as ours, LocalBus(router) as theirs:
        source = Listener(ours, "lab", "trial").records()
        threading.Timer(
            0.5, lambda: theirs.publish(at("lab", "replay", name="trial"), frame_of("trial", 0, entry))
        ).start()
        assert list(source) == [entry]


def test_a_replay_over_real_processes_is_seen_to_its_end(tmp_path: Path, settings: Settings) -> None:
    """`campaign status --follow --from` waits for a router; a player brings one, and the last line is the end."""
    folder = settings.runs_dir / "trial"
    whole_run(folder)
    environment = as_environment(settings) | {"OMP_NUM_THREADS": "1"}
    argv = [sys.executable, "-m", "luxloop", "campaign", "status", "--follow", "--from", "replay/trial", "--json"]
    follower = subprocess.Popen(argv, env=environment, stdout=subprocess.PIPE, text=True)
    code = (
        "from pathlib import Path; from env_controller.audit.playback import play;"
        "from luxloop.settings import load_settings;"
        f"print(play(Path({str(folder)!r}), load_settings(), rate=20).document())"
    )
    steps = overview(folder)["steps"]
    for _ in range(10):  # the follower may be a moment later than the first player
        player = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True)
        assert f"'steps': {steps}" in player.stdout, player.stderr
        if follower.poll() is not None:
            break
    out, _ = follower.communicate(timeout=30)
    lines = [json.loads(line) for line in out.splitlines()]
    end = lines.pop()
    assert (end["event"], end["missed"], end["reason"]) == ("end", 0, "budget: 12 evaluations")
    assert [line["sequence"] for line in lines] == list(range(steps - end["steps"], steps))
    assert end["steps"] > 0


def test_the_live_view_of_a_replay_has_no_workers_and_no_budget() -> None:
    """Only what a replay can tell."""
    text = shown(View("replay/trial", 0, None), Progress(steps=3, evaluations=2, episodes=1))
    assert "workers" not in text
    assert "left" not in text
    assert "2, 1 episodes" in text


def test_the_planned_evaluations_are_read_from_the_journal(tmp_path: Path) -> None:
    """None where the journal does not say."""
    RunOnDisk(tmp_path / "trial").close()
    assert evaluations_of(tmp_path / "trial") == 0


@pytest.mark.parametrize(("option", "said"), [("", "waiting for a replay of trial"), ("--quiet", ""), ("--json", "")])
def test_who_waits_for_a_replay_is_told_unless_it_is_quiet(
    option: str, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On stderr; here no router ever comes."""

    def nobody(_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("agent.follow._joined", nobody)
    text = CliRunner().invoke(app, ["--follow", "--from", "replay/trial", *option.split()]).stderr
    assert said in text
    assert bool(text) == bool(said)


@pytest.mark.parametrize("source", ["", "trial", "replay/", "replay/No Such", "journal/trial", "replay/a/b"])
def test_a_source_is_a_replay(source: str) -> None:
    """`replay/` and the id of a run."""
    with pytest.raises(InputError, match="--from"):
        name_of(source)


def test_options_that_do_not_go_together_are_refused(tmp_path: Path) -> None:
    """--from without --follow, or beside a run; no run at all; a frame that is none of a replay."""
    for argv, named in {
        ("--from", "replay/trial"): "--from",
        ("trial", "--follow", "--from", "replay/trial"): "--from",
        (): "RUN",
        ("--follow",): "RUN",
    }.items():
        with pytest.raises(InputError, match=named):
            ask(*argv, "--runs", tmp_path)
    with pytest.raises(InputError, match="kind"):
        played(encode(Replayed(run="trial", place=0)).replace(b"Replayed", b"Rebuffed"))


def _steps(told: list[Record]) -> int:
    return sum(entry.topic == "/step" for entry in told)
