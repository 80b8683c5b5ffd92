"""The journal: what was written is what is read; nothing acknowledged is lost, whatever ends it."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

from luxloop.campaign import Begin
from luxloop.errors import InputError, LuxloopError, RemoteError
from luxloop.journal import segment as segment_module
from luxloop.journal.chain import Mark
from luxloop.journal.reader import RunJournal, SegmentReader, segments_of, tail_of
from luxloop.journal.scan import Scan
from luxloop.journal.topics import CHAIN, Record, log_record, opening
from tests.journals import (
    ATTACHMENTS,
    METADATA,
    RUN,
    a_map,
    a_step,
    held_up,
    messages,
    open_journal,
    put,
    records_of_step,
    write_run,
)  # fmt: skip

ROOT = Path(__file__).parents[3]


def writing_process(folder: Path, *more: str) -> subprocess.Popen[str]:
    """A process that writes steps until killed and says each that was acknowledged."""
    code = [sys.executable, "-m", "tests.journals", str(folder), *more]
    return subprocess.Popen(code, cwd=ROOT, stdout=subprocess.PIPE, text=True)


def in_two_segments(folder: Path) -> list[Record]:
    """A run of five steps that was interrupted after three."""
    return write_run(folder, 3, finish=False) + write_run(folder, 2, first=3)


def test_what_was_written_is_what_is_read(tmp_path: Path) -> None:
    """Every record byte for byte, in order; metadata and attachments too."""
    written = write_run(tmp_path, 6)
    journal = RunJournal(tmp_path)
    assert list(journal.records()) == written
    assert journal.metadata("run").items() >= METADATA["run"].items()
    assert journal.metadata("environment") == METADATA["environment"]
    assert journal.attachments() == ATTACHMENTS


def test_words_come_back_as_words(tmp_path: Path) -> None:
    """Steps, what the learner was like, maps with row 0 at the lowest y, text."""
    write_run(tmp_path, 3)
    journal = RunJournal(tmp_path)
    assert list(journal.steps()) == [a_step(number, 0.5 + 0.01 * number) for number in range(3)]
    learner = [entry.value for entry in journal.records("/agent")]
    assert [(one.run, one.number, one.q) for one in learner] == [(RUN, n, 0.5) for n in range(3)]
    for entry in journal.records("/map/sim"):
        np.testing.assert_array_equal(entry.value, a_map(entry.sequence))
    assert [entry.value.message for entry in journal.records("/log")] == [f"step {n}: µ-LED" for n in range(3)]
    (request,) = journal.last("/request/ray", 1)
    assert request.value.inputs["seed"] == "9007199254740993"


def test_the_last_records_are_those_at_the_end(tmp_path: Path) -> None:
    """Over segments, by index or without."""
    written = [entry for entry in in_two_segments(tmp_path) if entry.topic == "/step"]
    journal = RunJournal(tmp_path)
    for count in (1, 2, 4, 5, 9):
        assert journal.last("/step", count) == written[-count:]


def test_a_finished_segment_reads_the_same_without_its_index(tmp_path: Path) -> None:
    """With its last byte cut off, it is read from its beginning."""
    write_run(tmp_path, 4)
    (path,) = segments_of(tmp_path)
    indexed = SegmentReader(path)
    assert indexed.index is not None
    copy = tmp_path / "copy.mcap"
    copy.write_bytes(path.read_bytes()[:-1])
    cut = SegmentReader(copy)
    assert cut.index is None
    for topics in ([], ["/step"], ["/map/sim", "/log"], [CHAIN]):
        assert list(cut.records(topics)) == list(indexed.records(topics))
    assert cut.opening == indexed.opening


def test_segments_are_one_run(tmp_path: Path) -> None:
    """Read in order; the chain goes on from one to the next."""
    written = in_two_segments(tmp_path)
    assert messages(tmp_path) == written
    first, second = (Scan(path) for path in segments_of(tmp_path))
    mark = Mark()
    for commit in first:
        mark = mark.then(commit.links)
    assert second.before == Mark()  # not known before it was read
    commits = list(second)
    assert second.before == mark
    for commit in commits:
        mark = mark.then(commit.links)
    assert mark == second.final == tail_of(tmp_path)
    assert (tmp_path / "audit.sha256").read_text() == f"{mark.root} {mark.records}\n"


def test_an_existing_segment_is_never_written_again(tmp_path: Path) -> None:
    """The file stays as it was, down to its time."""
    write_run(tmp_path, 1)
    (path,) = segments_of(tmp_path)
    before = path.read_bytes(), path.stat().st_mtime_ns
    with pytest.raises(FileExistsError):
        segment_module.Segment(path, Mark(), METADATA, {})
    write_run(tmp_path, 1, first=1)
    assert (path.read_bytes(), path.stat().st_mtime_ns) == before
    assert [path.name for path in segments_of(tmp_path)] == ["audit-0001.mcap", "audit-0002.mcap"]


def test_what_waits_is_committed_at_once(tmp_path: Path) -> None:
    """Ten batches that waited while the disk was busy share one commit, and each is told."""
    journal = open_journal(tmp_path)
    busy, told = held_up(journal), threading.Semaphore(0)
    for number in range(1, 11):
        journal.put(records_of_step(number), lambda error: told.release() if error is None else None)
    busy.set()
    assert all(told.acquire(timeout=20) for _ in range(10))
    journal.close()
    (path,) = segments_of(tmp_path)
    assert [len(commit.links) for commit in Scan(path)][2:] == [10 * len(records_of_step(0))]
    assert [step.number for step in RunJournal(tmp_path).steps()] == list(range(11))


def test_a_full_queue_says_busy_and_drops_nothing(tmp_path: Path) -> None:
    """Refused batches were not taken, all others are there."""
    journal = open_journal(tmp_path, queue_bytes=20_000)
    busy = held_up(journal)
    taken = [0]

    def fill() -> None:
        for number in range(1, 1000):
            journal.put(records_of_step(number), lambda _: None)
            taken.append(number)

    with pytest.raises(RemoteError) as caught:
        fill()
    assert caught.value.failure.code == "busy"
    busy.set()
    journal.finish()
    assert 1 < len(taken) < 1000
    assert [step.number for step in RunJournal(tmp_path).steps()] == taken


def test_what_was_written_makes_room_in_the_queue(tmp_path: Path) -> None:
    """Five batches, one after the other, fill it no more than none: two that wait at once have room."""
    journal = open_journal(tmp_path, queue_bytes=1000)
    lines = [log_record("x" * 280, number, number) for number in range(7)]
    for line in lines[:5]:
        put(journal, [line])
    busy = held_up(journal)
    for line in lines[5:]:
        journal.put([line], lambda _: None)
    busy.set()
    journal.close()
    assert [entry for entry in messages(tmp_path) if entry in lines] == lines


def test_a_batch_larger_than_the_queue_is_taken_where_nothing_waits(tmp_path: Path) -> None:
    """It would be refused for ever otherwise, however often it is tried again."""
    journal = open_journal(tmp_path, queue_bytes=1)
    put(journal, records_of_step(0))
    journal.finish()
    assert messages(tmp_path) == records_of_step(0)


def test_whoever_falls_over_its_acknowledgement_stops_nobody(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """The next batch is written and told as ever."""
    journal = open_journal(tmp_path)

    def fall(_: LuxloopError | None) -> None:
        raise ZeroDivisionError

    journal.put(records_of_step(0), fall)
    put(journal, records_of_step(1))
    journal.finish()
    assert "ZeroDivisionError" in caplog.text
    assert len(list(RunJournal(tmp_path).steps())) == 2


def test_a_journal_that_is_closed_takes_nothing(tmp_path: Path) -> None:
    """Neither does a finished one; closing twice is no fault."""
    journal = open_journal(tmp_path)
    journal.close()
    journal.close()
    with pytest.raises(RemoteError, match="closed"):
        journal.put(records_of_step(0), lambda _: None)


def test_close_writes_what_waits(tmp_path: Path) -> None:
    """Taken is taken, also where a run ends in a hurry."""
    journal = open_journal(tmp_path)
    for number in range(20):
        journal.put(records_of_step(number), lambda _: None)
    journal.close()
    assert [step.number for step in RunJournal(tmp_path).steps()] == list(range(20))


def test_a_run_is_readable_while_it_is_written(tmp_path: Path) -> None:
    """What was acknowledged is seen at once; a second writer is refused, and one after it is not."""
    journal = open_journal(tmp_path)
    for number in range(4):
        put(journal, records_of_step(number))
        reader = RunJournal(tmp_path)
        assert [step.number for step in reader.steps()] == list(range(number + 1))
        assert reader.being_written
    with pytest.raises(RemoteError, match="being written by another"):
        open_journal(tmp_path)
    journal.finish()
    assert not RunJournal(tmp_path).being_written
    open_journal(tmp_path).close()


def test_cut_anywhere_there_are_the_committed_batches_and_no_bad_one(tmp_path: Path) -> None:
    """At every 7th byte of a journal: what lies before the cut and was committed, or one batch more; never a part."""
    folder = tmp_path / "whole"
    journal = open_journal(folder)
    (path,) = segments_of(folder)
    sizes, batches = [path.stat().st_size], [records_of_step(number)[2:] for number in range(3)]
    for batch in batches:
        put(journal, batch)
        sizes.append(path.stat().st_size)
    journal.finish()
    whole = path.read_bytes()
    cut = tmp_path / "audit-0001.mcap"
    for end in range(0, len(whole), 7):
        cut.write_bytes(whole[:end])
        scan = Scan(cut)
        found = [link for commit in scan for link in commit.links if isinstance(link, Record)]
        committed = sum(size <= end for size in sizes[1:])
        allowed = [[entry for batch in batches[:count] for entry in batch] for count in (committed, committed + 1)]
        assert found in allowed
        assert (scan.torn, scan.fault, scan.finished) == (True, "", False)


def test_a_run_goes_on_after_a_segment_that_never_began(tmp_path: Path) -> None:
    """Killed before its first commit: an empty file, or half a header."""
    for number, junk in enumerate((b"", b"\x89MCA", b"\x89MCAP0\r\n\x01\x10"), 1):
        (tmp_path / f"audit-{number:04}.mcap").write_bytes(junk)
    with pytest.raises(InputError, match="none with the beginning"):
        RunJournal(tmp_path)
    assert write_run(tmp_path, 2) == messages(tmp_path)
    assert segments_of(tmp_path)[-1].name == "audit-0004.mcap"


@pytest.mark.parametrize("moment", range(3))
def test_killed_in_the_middle_nothing_acknowledged_is_lost(tmp_path: Path, moment: int) -> None:
    """kill -9 of a real process among many commits; at most one step more than it had told; and the run goes on."""
    process = writing_process(tmp_path)
    assert process.stdout is not None
    acknowledged = [int(process.stdout.readline()) for _ in range(20 + 17 * moment)]
    os.kill(process.pid, signal.SIGKILL)
    acknowledged += [int(line) for line in process.stdout.read().split()]
    process.wait(20)
    process.stdout.close()
    found = [step.number for step in RunJournal(tmp_path).steps()]
    assert found[: len(acknowledged)] == acknowledged
    assert len(found) <= len(acknowledged) + 1
    assert messages(tmp_path) == [entry for number in found for entry in records_of_step(number)]
    more = write_run(tmp_path, 1, first=len(found))
    assert messages(tmp_path)[-len(more) :] == more


def test_where_no_more_can_be_written_the_acknowledged_stays(tmp_path: Path) -> None:
    """A real process at the limit of its file size: one clear error, no hang, and all that it had told is there."""
    process = writing_process(tmp_path, "60000")
    assert process.stdout is not None
    acknowledged = []
    while (line := process.stdout.readline())[:1].isdigit():
        acknowledged.append(int(line))
    process.kill()
    process.wait(20)
    process.stdout.close()
    assert line.startswith("RemoteError refused")
    assert "File too large" in line
    assert str(tmp_path) in line
    assert len(acknowledged) > 3
    assert [step.number for step in RunJournal(tmp_path).steps()] == acknowledged


def test_a_failure_that_is_ours_is_told_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A bug in the writer ends in an error for those who wait, not in silence."""
    journal = open_journal(tmp_path)
    monkeypatch.setattr(segment_module.Segment, "write", lambda *_: 1 / 0)
    with pytest.raises(RemoteError, match="ZeroDivisionError"):
        put(journal, records_of_step(0))
    with pytest.raises(RemoteError, match="ZeroDivisionError"):
        journal.finish()
    journal.close()


def test_damage_in_a_finished_segment_is_said_with_its_file(tmp_path: Path) -> None:
    """A chunk that does not match its checksum is not decoded into nonsense."""
    write_run(tmp_path, 3)
    (path,) = segments_of(tmp_path)
    raw = bytearray(path.read_bytes())
    index = SegmentReader(path).index
    assert index is not None
    raw[index["ChunkIndex"][2].chunk_start_offset + 200] ^= 4
    path.write_bytes(raw)
    with pytest.raises(LuxloopError, match=r"audit-0001.mcap: damaged"):
        messages(tmp_path)


def test_an_empty_folder_and_none_are_no_journals(tmp_path: Path) -> None:
    """Said with the folder's name."""
    for folder in (tmp_path, tmp_path / "nowhere"):
        with pytest.raises(InputError) as caught:
            RunJournal(folder)
        assert str(folder) in f"{caught.value.field} {caught.value.value}"
    assert tail_of(tmp_path) == Mark()


def test_large_batches_are_whole_too(tmp_path: Path) -> None:
    """One that needs several chunks of the file."""
    lines = [log_record(f"{number} " + "x" * 997, number, number) for number in range(1000)]
    journal = open_journal(tmp_path)
    put(journal, lines)
    journal.finish()
    assert messages(tmp_path) == lines


def test_a_run_opens_with_what_its_designer_sent() -> None:
    """Plan, configuration and facts; a plan that can be read again."""
    from luxloop.campaign import Fidelity, Plan
    from luxloop.design import PRESETS
    from luxloop.model import Environment

    fidelity = Fidelity(target_error_points=1.0)
    plan = Plan(run=RUN, environment=Environment(), bounds=PRESETS["paper-table3"], walk=fidelity, final=fidelity)
    begin = Begin(
        plan=plan, designer="ddqn", facts={"argv": ["luxloop", "run"]}, attachments={"config.toml": "x = 1"}
    )
    run, attachments = opening(begin)
    assert (run["run"], run["kind"], run["designer"]) == (RUN, "campaign", "ddqn")
    assert "luxloop" in run["facts"]
    assert Plan.model_validate_json(attachments["plan.json"]) == plan
    assert attachments["config.toml"] == b"x = 1"


@pytest.mark.skipif(shutil.which("rerun") is None, reason="needs rerun: pip install rerun-sdk (660 MB)")
def test_another_program_opens_it(tmp_path: Path) -> None:
    """`rerun mcap info` and `check`, written by others: the file is whole, its maps are RawImage."""
    write_run(tmp_path, 3)
    (path,) = segments_of(tmp_path)
    for command, named in {"info": "foxglove.RawImage", "check": "/map/sim"}.items():
        run = ["rerun", "mcap", command, str(path)]
        done = subprocess.run(run, capture_output=True, text=True, check=True, timeout=60)
        assert named in done.stdout + done.stderr
