"""`luxloop audit recover`: all that was committed before the damage is saved, nothing else is passed off as good."""

from __future__ import annotations

import errno
import fcntl
import json
import random
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import typer
from typer.testing import CliRunner

from env_controller.audit import checks, mending_commands
from env_controller.audit.recover import held, recover
from luxloop.errors import InputError
from luxloop.journal.chain import Mark
from luxloop.journal.reader import RunJournal, segments_of
from luxloop.journal.scan import Commit, Scan
from luxloop.journal.segment import Segment, being_written
from luxloop.journal.topics import Record
from tests.journals import ATTACHMENTS, METADATA, open_journal, put, records_of_step, write_run

STRIDE_BYTES = 97
RECORDS = len(records_of_step(0))

app = typer.Typer()
app.command()(mending_commands.recover)
app.command()(mending_commands.compact)


def ask(*argv: object) -> tuple[int, dict[str, Any]]:
    """Exit code and document of a command."""
    done = CliRunner().invoke(app, [*map(str, argv), "--json"], catch_exceptions=False)
    return done.exit_code, json.loads(done.stdout)


def commits(folder: Path) -> list[Commit]:
    """What is committed in all segments of a run, in order."""
    return [commit for path in segments_of(folder) for commit in Scan(path)]


def sound(folder: Path) -> bool:
    """Whether `audit verify` has nothing to say against a run."""
    return checks.exit_code(checks.verify(folder, None, None)) == 0


def in_segments(folder: Path, *steps: int, finish: bool = True) -> list[Record]:
    """A run that was killed and resumed: so many steps in each segment, the last one finished."""
    written: list[Record] = []
    for place, count in enumerate(steps, 1):
        last = place == len(steps)
        written += write_run(folder, count, first=len(written) // RECORDS, finish=last and finish)
    return written


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A finished run of six steps, as `runs/a-run`."""
    write_run(tmp_path / "runs" / "a-run", 6)
    return tmp_path / "runs" / "a-run"


def test_a_killed_run_is_saved_whole(tmp_path: Path) -> None:
    """Nothing was missing: exit 0; the new segments are finished, the chain has the same links and roots."""
    folder = tmp_path / "killed"
    written = in_segments(folder, 3, 2, finish=False)
    before = [path.read_bytes() for path in segments_of(folder)]
    code, document = ask("recover", folder)
    assert (code, document["lost"], document["changed"]) == (0, [], [])
    saved = tmp_path / "killed-recovered"
    assert document["out"] == str(saved)
    assert commits(saved) == commits(folder)
    assert list(RunJournal(saved).records()) == written
    assert [part["left_bytes"] for part in document["segments"]] == [0, 0]
    assert sound(saved)
    assert (saved / "audit.sha256").read_text() == f"{document['root']} {document['records']}\n"
    assert [path.read_bytes() for path in segments_of(folder)] == before


def test_every_cut_gives_back_what_was_flushed(tmp_path: Path) -> None:
    """A journal cut at every 97th byte: each step that was acknowledged before the cut is there, byte for byte."""
    journal, flushed, written = open_journal(tmp_path / "run"), [], []
    (path,) = segments_of(tmp_path / "run")
    for number in range(8):
        written.append(records_of_step(number))
        put(journal, written[-1])
        flushed.append(path.stat().st_size)
    journal.finish()
    journal.close()
    whole = path.read_bytes()
    cut = tmp_path / "cut"
    cut.mkdir()
    for size in range(0, len(whole), STRIDE_BYTES):
        (cut / path.name).write_bytes(whole[:size])
        saved = recover(cut, tmp_path / "saved")
        steps = sum(end <= size for end in flushed)
        found = list(RunJournal(saved.out).records()) if saved.mark.records else []
        assert len(found) // RECORDS in (steps, steps + 1), size
        assert found == [entry for records in written[: len(found) // RECORDS] for entry in records], size
        shutil.rmtree(saved.out, ignore_errors=True)


def test_flipped_bits_never_give_a_false_record(run: Path, tmp_path: Path) -> None:
    """Whatever is damaged, what is saved is how the run began, and the rest is told as lost or changed."""
    (path,) = segments_of(run)
    whole, true = path.read_bytes(), commits(run)
    draw = random.Random(7)
    for _ in range(100):
        damaged = bytearray(whole)
        place = draw.randrange(60, len(whole))
        damaged[place] ^= 1 << draw.randrange(8)
        path.write_bytes(damaged)
        saved = recover(run, tmp_path / "saved")
        found = commits(saved.out) if saved.mark.records else []
        assert found == true[: len(found)], place
        assert saved.exit_code or len(found) == len(true), place
        shutil.rmtree(saved.out, ignore_errors=True)


def test_a_damaged_chunk_ends_what_can_be_shown(run: Path) -> None:
    """What lies behind it in the file is not joined; how much that is, and after which record, is said."""
    (path,) = segments_of(run)
    true, damaged = commits(run), bytearray(path.read_bytes())
    place = damaged.index(b"zstd", len(damaged) // 4)
    damaged[place + 20 : place + 60] = bytes(40)
    path.write_bytes(damaged)
    code, document = ask("recover", run)
    assert code == 3
    saved = commits(Path(document["out"]))
    assert 1 < len(saved) < len(true)
    assert saved == true[: len(saved)]
    assert f"behind record {saved[-1].mark.records:,}" in document["lost"][0]
    assert document["segments"][0]["left_bytes"] > 0
    assert sound(Path(document["out"]))


def test_a_later_segment_is_not_joined_over_a_gap(tmp_path: Path) -> None:
    """The first segment lost its end: how many records are missing is known, and the second stays in the original."""
    folder = tmp_path / "run"
    in_segments(folder, 4, 2)
    first, second = segments_of(folder)
    first.write_bytes(first.read_bytes()[:-3000])
    code, document = ask("recover", folder)
    assert code == 3
    missing = next(iter(Scan(second))).mark.records - 4 - document["records"]
    assert document["lost"][0].startswith(f"{missing} records after record {document['records']}")
    assert document["segments"][1]["records"] == 0
    assert document["segments"][1]["left_bytes"] == second.stat().st_size
    assert sound(Path(document["out"]))


def test_a_torn_end_before_a_later_start_is_no_loss(tmp_path: Path) -> None:
    """The second start went on from the last whole batch: what was torn had never been acknowledged."""
    folder = tmp_path / "run"
    in_segments(folder, 3, finish=False)
    (path,) = segments_of(folder)
    path.write_bytes(path.read_bytes()[:-40])
    write_run(folder, 2, first=2)
    code, document = ask("recover", folder)
    assert (code, document["lost"]) == (0, [])
    assert commits(Path(document["out"])) == commits(folder)


def test_a_torn_end_is_told_as_loss(tmp_path: Path) -> None:
    """At the end of a run nothing says whether that batch was acknowledged."""
    folder = tmp_path / "run"
    in_segments(folder, 3, finish=False)
    (path,) = segments_of(folder)
    path.write_bytes(path.read_bytes()[:-40])
    code, document = ask("recover", folder)
    assert code == 3
    assert "a batch that was cut off" in document["lost"][0]


def test_the_side_file_says_what_is_missing(run: Path) -> None:
    """A finished run that was cut where a commit ends looks like an unfinished one; its side file knows better."""
    (path,) = segments_of(run)
    scan = Scan(path)
    ends = [scan.read_bytes for _ in scan]
    path.write_bytes(path.read_bytes()[: ends[4]])
    code, document = ask("recover", run)
    assert code == 3
    assert document["segments"][0]["left_bytes"] == 0
    assert "that audit.sha256 states" in document["lost"][0]


def test_a_damaged_index_costs_no_record(run: Path) -> None:
    """The data are whole and the root is there: nothing was missing."""
    (path,) = segments_of(run)
    true = commits(run)
    path.write_bytes(path.read_bytes()[:-20])
    code, document = ask("recover", run)
    assert code == 0
    assert "no record is missing" in document["segments"][0]["found"]
    assert commits(Path(document["out"])) == true


def test_an_edited_record_under_right_checksums_is_a_change(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A forger's file has the old marks over other records: exit 5, only what lies before is saved."""
    marks, honest = [commit.mark for commit in Scan(segments_of(run)[0])], list(RunJournal(run).records())
    forged = tmp_path / "forged"
    forged.mkdir()
    records = [replace(one, data=honest[3].data) if place == 17 else one for place, one in enumerate(honest)]
    segment = Segment(forged / "audit-0001.mcap", Mark(), METADATA, ATTACHMENTS)
    first = segment.mark
    with monkeypatch.context() as patch:
        patch.setattr(Mark, "then", lambda mark, links: replace(mark, records=mark.records + len(links)))
        for place, entry in enumerate(records):
            segment.write(entry)
            if (place + 1) % RECORDS == 0:
                segment.mark = replace(marks[(place + 1) // RECORDS], records=segment.mark.records)
                segment.commit()
        segment.finish()
    assert first.records == marks[0].records
    code, document = ask("recover", forged)
    assert code == 5
    assert "are not what was written" in document["changed"][0]


def test_a_segment_of_another_run_is_a_change(tmp_path: Path) -> None:
    """It goes on from another root."""
    in_segments(tmp_path / "run", 3, 2)
    in_segments(tmp_path / "other", 3, 2)
    shutil.copy(tmp_path / "other" / "audit-0002.mcap", tmp_path / "run")
    code, document = ask("recover", tmp_path / "run")
    assert code == 5
    assert "of another root" in document["changed"][0]
    assert len(commits(Path(document["out"]))) == 4


def test_a_missing_segment_is_a_loss(tmp_path: Path) -> None:
    """What lies behind it cannot be joined."""
    in_segments(tmp_path / "run", 2, 2, 2)
    (tmp_path / "run" / "audit-0002.mcap").unlink()
    code, document = ask("recover", tmp_path / "run")
    assert code == 3
    assert "segment 2 is missing" in document["lost"][0]
    assert sound(Path(document["out"]))


def test_a_start_that_wrote_nothing_leaves_no_hole(tmp_path: Path) -> None:
    """Killed before its first commit: what is saved is numbered without it, and verifies."""
    folder = tmp_path / "run"
    in_segments(folder, 2, finish=False)
    (folder / "audit-0002.mcap").write_bytes(b"")
    write_run(folder, 2, first=2)
    code, document = ask("recover", folder)
    assert code == 0
    assert [path.name for path in segments_of(Path(document["out"]))] == ["audit-0001.mcap", "audit-0002.mcap"]
    assert sound(Path(document["out"]))


def test_nothing_to_save(tmp_path: Path) -> None:
    """Exit 1, and no folder is left behind."""
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "audit-0001.mcap").write_text("this is no such file at all")
    code, document = ask("recover", folder)
    assert (code, document["records"]) == (1, 0)
    assert not Path(document["out"]).exists()


def test_what_cannot_be_recovered_is_refused(run: Path, tmp_path: Path) -> None:
    """A run being written (naming its writer), a folder that holds something, a folder without a journal."""
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine.txt").touch()
    (tmp_path / "none").mkdir()
    with pytest.raises(InputError, match="--out"):
        ask("recover", run, "--out", tmp_path / "full")
    with pytest.raises(InputError, match="RUN"):
        ask("recover", tmp_path / "none")
    journal = open_journal(tmp_path / "live")
    with pytest.raises(InputError, match=r"end the controller that writes it \(process"):
        ask("recover", tmp_path / "live")
    journal.close()


def test_a_person_reads_what_was_saved(run: Path) -> None:
    """As text: each segment, the verdict, where it is, what to do next."""
    (path,) = segments_of(run)
    whole, end = path.read_bytes(), 8  # the file's own magic
    while end < len(whole) // 2:  # a record is its kind, eight bytes of its length, and so many bytes
        end += 9 + int.from_bytes(whole[end + 1 : end + 9], "little")
    path.write_bytes(whole[: end - 1])  # in the middle of a record
    text = CliRunner().invoke(app, ["recover", str(run)]).stdout
    for wanted in ("audit-0001.mcap", "bytes not used", "saved with loss", "luxloop audit verify", "is as it was"):
        assert wanted in text, wanted


@pytest.mark.parametrize("refused", [errno.EAGAIN, errno.EACCES])
def test_a_run_that_is_written_over_a_network_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, refused: int
) -> None:
    """There, locks are of ranges of bytes: an exclusive one needs a file opened for writing (Linux, flock(2), NFS and
    CIFS), and another's may be told as a refusal."""
    flock = fcntl.flock

    def over_a_network(file: Any, lock: int) -> None:
        if lock & fcntl.LOCK_EX and not file.writable():
            raise OSError(errno.EBADF, "Bad file descriptor")
        try:
            flock(file, lock)
        except BlockingIOError as error:
            raise OSError(refused, "held") from error

    monkeypatch.setattr(fcntl, "flock", over_a_network)
    journal = open_journal(tmp_path / "run")
    with pytest.raises(InputError, match="a run that nobody writes"):
        recover(tmp_path / "run")
    journal.close()
    assert recover(tmp_path / "run").mark.records


def test_a_run_of_read_only_segments_is_held_against_others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A person who may not write them takes the lock all the same: of two only one goes on, and a writer sees it."""
    write_run(tmp_path / "run", 1)
    (path,) = segments_of(tmp_path / "run")
    monkeypatch.setattr("env_controller.audit.recover._for_writing", lambda path: path.open("rb"))
    with held(path) as first, held(path) as second:
        assert (first, second) == (True, False)
        assert being_written(path)
    assert not being_written(path)
