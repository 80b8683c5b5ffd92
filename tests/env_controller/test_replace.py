"""`luxloop audit recover --replace`: what was saved takes the run's place and goes on; nothing half is left."""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from env_controller.audit import replace as replace_module
from env_controller.audit.recover import recover
from env_controller.audit.replace import replace
from luxloop.cli import app
from luxloop.errors import InputError, LuxloopError
from luxloop.journal.journal import Journal
from luxloop.journal.reader import RunJournal, segments_of, tail_of
from luxloop.journal.topics import Close, log_record
from luxloop.settings import as_environment
from tests import forks
from tests.env_controller.test_recover import ask, commits, in_segments, run, sound
from tests.journals import ATTACHMENTS, METADATA, open_journal, put, records_of_step, write_run
from tests.running_set import RunningSet

__all__ = ["run"]  # a fixture
PRETEND = str(Path(__file__).parents[1] / "pretend_worker.py")
EVALUATIONS = 64


def cut(folder: Path, share: float = 0.5) -> None:
    """Take the end away from the last segment."""
    path = segments_of(folder)[-1]
    os.truncate(path, int(path.stat().st_size * share))


def campaign(folder: Path, close: Close | None) -> None:
    """A run with a plan; closed for a reason, or killed."""
    journal = Journal(folder, METADATA, {**ATTACHMENTS, "plan.json": b"{}"})
    put(journal, records_of_step(0))
    if close is not None:
        put(journal, [log_record(close.line, 1, 1)])
        journal.finish()
    journal.close()


def lying(folder: Path) -> dict[str, bytes]:
    """All files below a folder."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_what_was_saved_takes_the_place_of_the_run(run: Path) -> None:
    """The damaged run lies aside as it was; the new one is sound, has its checkpoints, and nothing else is left."""
    (run / "checkpoints").mkdir()
    (run / "checkpoints" / "checkpoint-00000004.npz").write_bytes(b"a state")
    cut(run)
    before, true = lying(run), commits(run)
    code, document = ask("recover", run, "--replace")
    damaged = run.with_name("a-run-damaged")
    assert (code, document["replaced"]) == (3, True)
    assert (document["out"], document["folder"]) == (str(run), str(damaged))
    assert lying(damaged) == before
    assert sound(run)
    assert commits(run) == true
    assert lying(run / "checkpoints") == {"checkpoint-00000004.npz": b"a state"}
    assert sorted(path.name for path in run.parent.iterdir()) == ["a-run", "a-run-damaged"]


def test_it_does_so_after_a_recovery_beside_it_too(run: Path) -> None:
    """The command that comes next after a recovery without --replace: that one's folder is not in its way."""
    cut(run)
    first = ask("recover", run)[1]
    assert ask("recover", run, "--replace")[1]["root"] == first["root"]
    assert tail_of(run).root == first["root"]


def test_a_second_time_is_refused(run: Path) -> None:
    """What was left aside first is not overwritten, and the run stays as it is."""
    cut(run)
    ask("recover", run, "--replace")
    cut(run)
    before = lying(run.parent)
    with pytest.raises(InputError, match=r"move .*a-run-damaged away"):
        ask("recover", run, "--replace")
    assert lying(run.parent) == before


def test_where_nothing_can_be_saved_nothing_is_replaced(tmp_path: Path) -> None:
    """Exit 1; the folder is as it was."""
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "audit-0001.mcap").write_text("this is no such file at all")
    code, document = ask("recover", folder, "--replace")
    assert (code, document["replaced"], document["next"]) == (1, False, "")
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


def test_of_a_sound_run_nothing_is_left_aside(run: Path) -> None:
    """It had become a-run-damaged, though nothing was missing; a run that stopped is told how to go on."""
    before = lying(run.parent)
    code, document = ask("recover", run, "--replace")
    assert (code, document["replaced"], document["out"]) == (0, False, str(run))
    assert lying(run.parent) == before
    stopped = run.with_name("stopped")
    campaign(stopped, Close("interrupted", complete=False))
    told = CliRunner().invoke(app(), ["audit", "recover", str(stopped), "--replace"])
    assert "there is nothing to replace" in told.stdout
    assert "luxloop campaign resume" in told.stdout
    assert not stopped.with_name("stopped-damaged").exists()


def test_a_run_being_written_and_out_beside_it_are_refused(run: Path, tmp_path: Path) -> None:
    """Its writer is named; --out says another place than --replace."""
    journal = open_journal(tmp_path / "live")
    with pytest.raises(InputError, match="end the controller that writes it"):
        ask("recover", tmp_path / "live", "--replace")
    journal.close()
    with pytest.raises(InputError, match="leave one of the two out"):
        ask("recover", run, "--replace", "--out", tmp_path / "o")


def test_what_a_killed_replacement_left_is_cleared(run: Path) -> None:
    """Its half-written folder is not taken for a run's."""
    left = run.with_name(".a-run.recovered")
    (left / "checkpoints").mkdir(parents=True)
    (left / "audit-0001.mcap").write_text("half")
    cut(run)
    ask("recover", run, "--replace")
    assert sound(run)
    assert not left.exists()


def test_a_place_that_cannot_be_taken_leaves_the_run(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The second change of names fails: the first is taken back, what was begun is removed."""
    cut(run)
    before, rename = lying(run.parent), Path.rename

    def refuse(self: Path, target: Path) -> Path:
        if self.name.startswith("."):
            raise OSError(28, "No space left on device")
        return rename(self, target)

    monkeypatch.setattr(replace_module.Path, "rename", refuse)
    with pytest.raises(LuxloopError, match=r"cannot write .*\.a-run\.recovered: No space left.*make room there"):
        replace(run)
    assert lying(run.parent) == before
    assert [path.name for path in run.parent.iterdir()] == ["a-run"]


@pytest.mark.parametrize("options", [(), ("--replace",)])
def test_a_disk_that_gets_full_leaves_nothing_half(tmp_path: Path, options: tuple[str, ...]) -> None:
    """A real process on which a write fails: path and mend in one line, exit 1, the run as it was."""
    folder = tmp_path / "run"
    in_segments(folder, 3, 2, finish=False)
    before, limit = lying(tmp_path), segments_of(folder)[0].stat().st_size - 2000
    done = subprocess.run(
        [sys.executable, "-m", "luxloop", "audit", "recover", str(folder), *options],
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit)),
        capture_output=True, text=True, timeout=60,
    )  # fmt: skip
    assert done.returncode == 1, done.stderr
    assert "recovered: File too large; make room there" in done.stderr
    assert "Traceback" not in done.stderr
    assert lying(tmp_path) == before
    assert [path.name for path in tmp_path.iterdir()] == ["run"]


def test_an_empty_folder_of_ones_own_stays_empty(run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What was begun in it goes, the folder itself was there before."""
    (tmp_path / "mine").mkdir()
    monkeypatch.setattr("env_controller.audit.recover.write_side_file", lambda *_: os.mkdir("/dev/null/none"))
    with pytest.raises(LuxloopError, match=r"cannot write .*mine"):
        recover(run, tmp_path / "mine")
    assert list((tmp_path / "mine").iterdir()) == []


@pytest.mark.parametrize(
    ("close", "beside", "in_place"),
    [
        (None, "luxloop audit recover {run} --replace", "luxloop campaign resume {run}"),
        (Close("interrupted", False), "luxloop audit recover {run} --replace", "luxloop campaign resume {run}"),
        (Close("budget", True), "luxloop audit verify {run}-recovered", "luxloop audit verify {run}"),
    ],
)
def test_the_next_command_fits_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, close: Close | None, beside: str, in_place: str
) -> None:
    """One with something left to do is to be resumed, in its own place; by its id where that is enough."""
    folder = tmp_path / "run"
    campaign(folder, close)
    assert ask("recover", folder)[1]["next"] == beside.format(run=folder)
    monkeypatch.setenv("LUXLOOP_RUNS", str(tmp_path))
    assert ask("recover", "run", "--replace")[1]["next"] == in_place.format(run="run")


@pytest.mark.parametrize("last", ["audit-0002.mcap", "audit-0007.mcap"])
def test_a_segment_under_a_wrong_name_is_saved(tmp_path: Path, last: str) -> None:
    """The first one was renamed: its chain says where it belongs, and that its name was wrong."""
    folder = tmp_path / "run"
    write_run(folder, 4)
    true = commits(folder)
    (folder / "audit-0001.mcap").rename(folder / last)
    code, document = ask("recover", folder)
    assert (code, document["lost"]) == (0, [])
    assert "its name was wrong: by its chain it is segment 1" in document["segments"][0]["found"]
    assert commits(Path(document["out"])) == true
    assert sound(Path(document["out"]))


@pytest.mark.parametrize("names", [(3, 2), (2, 1), (2, 4), (4, 3)])
def test_segments_in_a_wrong_order_are_saved_in_that_of_their_chain(tmp_path: Path, names: tuple[int, int]) -> None:
    """Two of them, renamed in every way that a person may."""
    folder = tmp_path / "run"
    in_segments(folder, 3, 2)
    true = commits(folder)
    for number in (1, 2):
        (folder / f"audit-{number:04}.mcap").rename(folder / f"moved-{number}")
    for number, name in zip((1, 2), names, strict=True):
        (folder / f"moved-{number}").rename(folder / f"audit-{name:04}.mcap")
    code, document = ask("recover", folder)
    assert (code, document["records"]) == (0, true[-1].mark.records)
    assert commits(Path(document["out"])) == true


def test_a_disk_that_gives_no_more_is_damage(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What was read before is saved; the reason is the system's own."""
    true, whole = commits(run), replace_module.save.__globals__["Scan"].__iter__

    def breaks(self: Any) -> Iterator[Any]:
        for place, commit in enumerate(whole(self)):
            if place == 3:
                raise OSError(5, "Input/output error")
            yield commit

    monkeypatch.setattr("luxloop.journal.scan.Scan.__iter__", breaks)
    code, document = ask("recover", run)
    monkeypatch.undo()
    assert code == 3
    assert "Input/output error" in document["lost"][0]
    assert commits(Path(document["out"])) == true[:3]


def obstacle(path: Path, kind: str) -> str:
    """Put something in a segment's place that is none; the word its mend has."""
    path.unlink()
    if kind == "folder":
        path.mkdir()
    elif kind == "pipe":
        os.mkfifo(path)
    else:
        path.symlink_to(path.with_name("gone.mcap"))
        return "remove the link"
    return f"move {path} away"


@pytest.mark.parametrize("kind", ["folder", "pipe", "link"])
def test_a_segment_that_is_no_file_is_named(run: Path, kind: str) -> None:
    """By audit info, verify and recover, and by campaign status and list, which shows the other runs as ever."""
    write_run(run.with_name("other"), 2)
    said = obstacle(run / "audit-0001.mcap", kind)
    for command in ("audit info", "audit verify", "audit recover", "campaign status", "campaign status --follow"):
        done = CliRunner().invoke(app(), [*command.split(), str(run)])
        assert isinstance(done.exception, InputError), command
        assert said in str(done.exception), command
    listed = CliRunner().invoke(app(), ["campaign", "list", "--runs", str(run.parent)])
    assert listed.exit_code == 0
    rows = {row.split()[0]: row for row in listed.stdout.splitlines()}
    assert "damaged: " in rows["a-run"]
    assert said in rows["a-run"]
    assert "2 steps" in rows["other"]


def luxloop(*argv: str, environment: dict[str, str] | None = None) -> subprocess.CompletedProcess[str]:
    """A command as a process of its own."""
    return forks.luxloop(*argv, env=environment)


@pytest.mark.slow
def test_a_run_cut_in_the_middle_is_replaced_and_resumed(settings: Any) -> None:
    """The way that the commands name leads to the end: the same steps as of the run that was never damaged."""
    made = RunningSet(settings)
    try:
        made.add(PRETEND, "film", "0.0")
        made.add(PRETEND, "ray", "0.0")
        made.ready(2)
        options = ("--no-local", "--id", "r", "--evaluations", str(EVALUATIONS), "--json")
        first = luxloop("campaign", "run", *options, environment=as_environment(settings))
        assert first.returncode == 0, first.stderr
        folder = settings.runs_dir / "r"
        true = {(step.lane, step.number): step.uniformity for step in RunJournal(folder).steps()}
        assert list((folder / "checkpoints").iterdir())
        cut(folder)
        saved = luxloop("audit", "recover", "r", "--replace", "--json", environment=as_environment(settings))
        assert saved.returncode == 3, saved.stderr
        words = json.loads(saved.stdout)["next"].split()
        assert words[1:] == ["campaign", "resume", "r"]
        assert 0 < len(list(RunJournal(folder).steps())) < len(true)
        again = luxloop(*words[1:], "--no-local", environment=as_environment(settings))
        assert again.returncode == 0, again.stderr
        assert {(step.lane, step.number): step.uniformity for step in RunJournal(folder).steps()} == true
        page = luxloop("campaign", "report", "r", environment=as_environment(settings))
        assert page.returncode == 0, page.stderr
    finally:
        made.close()
