"""`luxloop audit compact`: one file, the same chain; everything that reads runs goes on reading it."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

import pytest

from agent.overview import overview
from env_controller.audit import compact as compact_module
from env_controller.audit.checks import exit_code, verify
from env_controller.audit.commands import document_of
from env_controller.audit.compact import compact
from luxloop.errors import InputError, LuxloopError
from luxloop.journal import segment as segment_module
from luxloop.journal.journal import Journal
from luxloop.journal.reader import RunJournal, segments_of, tail_of
from luxloop.journal.scan import Scan
from tests.env_controller.test_recover import ask, commits, in_segments, run, sound
from tests.journals import METADATA, open_journal, put, records_of_step, write_run

__all__ = ["run"]  # a fixture


def three_starts(folder: Path) -> None:
    """A run of three starts, each with facts and an attachment of its own; the first two were killed."""
    for place in range(3):
        environment = {"environment": {"pid": str(place)}}
        journal = Journal(folder, METADATA | environment, {"notes.txt": f"start {place}".encode(), f"{place}": b""})
        for number in range(2 * place, 2 * place + 2):
            put(journal, records_of_step(number))
        if place == 2:
            journal.finish()
        journal.close()


def facts(folder: Path) -> list[object]:
    """What a run says of itself, and its last steps."""
    journal = RunJournal(folder)
    return [journal.metadata("environment"), journal.metadata("run"), journal.attachments(), journal.last("/step", 3)]


def interrupted(folder: Path, monkeypatch: pytest.MonkeyPatch, *, away: int = 0, remove: bool = False) -> None:
    """A compaction that is killed when the one file is in place, and of the others so many are away."""

    def swap(paths: list[Path], fresh: Path) -> None:
        fresh.replace(paths[0])
        for path in paths[1 : 1 + away]:
            path.unlink()

    with monkeypatch.context() as patch:
        patch.setattr(compact_module, "_swap", swap)
        compact(folder, remove=remove)


@pytest.mark.parametrize("spill_bytes", [1, segment_module.SPILL_BYTES])
def test_three_segments_become_one_with_the_same_chain(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, spill_bytes: int
) -> None:
    """Same commits, roots, records; smaller; the old segments are kept byte for byte; nothing else in the folder.

    Also where the new file is written out piece by piece, as a large one is.
    """
    monkeypatch.setattr(segment_module, "SPILL_BYTES", spill_bytes)
    folder = tmp_path / "run"
    three_starts(folder)
    true, names = commits(folder), {path.name: path.read_bytes() for path in segments_of(folder)}
    mark, records = tail_of(folder), list(RunJournal(folder).records())
    code, document = ask("compact", folder)
    assert (code, document["segments"], document["root"]) == (0, 3, mark.root)
    (path,) = segments_of(folder)
    assert commits(folder) == true
    assert list(RunJournal(folder).records()) == records
    assert document["before_bytes"] == sum(map(len, names.values()))
    assert document["after_bytes"] == path.stat().st_size < document["before_bytes"]
    kept = folder / "segments-before"
    assert {old.name: old.read_bytes() for old in kept.iterdir()} == names
    assert sorted(one.name for one in folder.iterdir()) == ["audit-0001.mcap", "audit.sha256", "segments-before"]


def test_whoever_reads_runs_reads_a_compacted_one(tmp_path: Path) -> None:
    """The facts of the last start, all attachments, steps by index, overview, info, verify: as before."""
    folder = tmp_path / "run"
    three_starts(folder)
    seen, told, before = overview(folder), document_of(RunJournal(folder)), facts(folder)
    compact(folder)
    after = RunJournal(folder)
    assert after.segments[0].index is not None
    assert facts(folder) == before
    assert after.metadata("environment") == {"pid": "2"}
    assert after.attachments()["notes.txt"] == b"start 2"
    assert overview(folder) == seen
    now = document_of(after)
    changing = {"segments", "size_bytes"}
    assert {key: now[key] for key in now.keys() - changing} == {key: told[key] for key in told.keys() - changing}
    assert sound(folder)


def test_a_compacted_run_goes_on(tmp_path: Path) -> None:
    """A new start opens segment 2; the chain goes on from the one file."""
    folder = tmp_path / "run"
    in_segments(folder, 2, 2)
    compact(folder)
    write_run(folder, 1, first=4)
    assert [path.name for path in segments_of(folder)] == ["audit-0001.mcap", "audit-0002.mcap"]
    assert sound(folder)
    assert [step.number for step in RunJournal(folder).steps()] == list(range(5))


def test_it_is_recovered_like_any_other(tmp_path: Path) -> None:
    """With its index cut off: every start, every record."""
    folder = tmp_path / "run"
    three_starts(folder)
    true = commits(folder)
    compact(folder, remove=True)
    (path,) = segments_of(folder)
    path.write_bytes(path.read_bytes()[:-30])
    code, document = ask("recover", folder)
    assert code == 0
    assert commits(Path(document["out"])) == true


def test_a_start_in_the_middle_must_follow(tmp_path: Path) -> None:
    """A file that joins two runs under one name is damaged where the second begins."""
    in_segments(tmp_path / "run", 2, 2)
    in_segments(tmp_path / "other", 2, 2)
    first, second = segments_of(tmp_path / "run")[0], segments_of(tmp_path / "other")[1]
    compact_module._merge([first, second], tmp_path / "joined.mcap", lambda _: None)
    scan = Scan(tmp_path / "joined.mcap")
    assert len(list(scan)) == len(list(Scan(first)))
    assert "a start after" in scan.fault


def test_nothing_is_replaced_by_what_differs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A writer that loses the last segment: refused, all as it was, no file left."""
    folder = tmp_path / "run"
    three_starts(folder)
    names = {path.name: path.read_bytes() for path in folder.iterdir()}
    true = compact_module._merge
    monkeypatch.setattr(compact_module, "_merge", lambda paths, *more: true(paths[:-1], *more))
    with pytest.raises(LuxloopError, match="differs from the segments"):
        compact(folder)
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == names


@pytest.mark.parametrize("remove", [False, True])
def test_an_interrupted_compaction_is_ended_by_the_next(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, remove: bool
) -> None:
    """Killed when the one file was in place and the others not yet away."""
    folder = tmp_path / "run"
    three_starts(folder)
    true = commits(folder)
    interrupted(folder, monkeypatch, remove=remove)
    done = compact(folder, remove=remove)
    assert (done.segments, commits(folder)) == (3, true)
    assert sound(folder)


@pytest.mark.parametrize("away", [0, 1])
def test_until_then_nobody_is_misled(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, away: int) -> None:
    """Verify and recover tell what is left and how to end it, and count it for nothing; who reads reads all once."""
    folder = tmp_path / "run"
    three_starts(folder)
    true, records, mark = commits(folder), list(RunJournal(folder).records()), tail_of(folder)
    interrupted(folder, monkeypatch, away=away)
    told = f"left by an interrupted compaction; luxloop audit compact {folder} ends it"
    left = [path.name for path in segments_of(folder)[1:]]
    audit = verify(folder, None, None)
    notes = [one for one in audit.findings if one.found == told]
    assert [(one.what, one.verdict) for one in notes] == [(name, "note") for name in left]
    assert (exit_code(audit), audit.mark) == (0, mark)
    assert list(RunJournal(folder).records()) == records
    code, document = ask("recover", folder)
    assert [part["file"] for part in document["segments"] if part["found"] == told] == left
    assert (code, document["lost"], commits(Path(document["out"]))) == (0, [], true)


def test_a_run_that_went_on_in_between_is_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its new segment has the number behind those that are left, and follows the first when they are away."""
    folder = tmp_path / "run"
    in_segments(folder, 2, 2)
    interrupted(folder, monkeypatch)
    write_run(folder, 1, first=4)
    true = [step.number for step in RunJournal(folder).steps()]
    assert true == list(range(5))
    assert sound(folder)
    assert ask("recover", folder)[0] == 0
    compact(folder)
    assert [path.name for path in segments_of(folder)] == ["audit-0001.mcap", "audit-0002.mcap"]
    assert sound(folder)
    assert [step.number for step in RunJournal(folder).steps()] == true


def test_a_segment_that_nobody_can_read_is_not_taken_for_one_that_is_left(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What a run wrote since, damaged before its first commit: it is refused and stays, for it may be mended."""
    folder = tmp_path / "run"
    in_segments(folder, 2, 2)
    interrupted(folder, monkeypatch)
    write_run(folder, 1, first=4)
    damaged = segments_of(folder)[-1]
    data = bytearray(damaged.read_bytes())
    data[data.index(b"zstd") + 40] ^= 0xFF
    damaged.write_bytes(data)
    assert not list(Scan(damaged))
    with suppress(LuxloopError):
        compact(folder)
    assert bytes(data) in [path.read_bytes() for path in segments_of(folder)]


def test_a_segment_of_another_run_is_not_taken_for_one_that_is_left(tmp_path: Path) -> None:
    """It begins before the first one's end too, but the first does not hold it."""
    in_segments(tmp_path / "run", 4)
    in_segments(tmp_path / "other", 2)
    (other,) = segments_of(tmp_path / "other")
    other.rename(tmp_path / "run" / "audit-0002.mcap")
    assert exit_code(verify(tmp_path / "run", None, None)) == 5
    assert len(RunJournal(tmp_path / "run").segments) == 2


def test_one_that_was_interrupted_before_is_done_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Killed when the old segments had a second name and nothing was replaced; also where there are no links."""
    folder = tmp_path / "run"
    three_starts(folder)
    true = commits(folder)

    def killed(*_: object) -> None:
        raise KeyboardInterrupt

    def no_links(*_: object) -> None:
        raise OSError("no links here")

    monkeypatch.setattr(os, "link", no_links)
    with monkeypatch.context() as patch:
        patch.setattr(compact_module, "_swap", killed)
        with pytest.raises(KeyboardInterrupt):
            compact(folder)
    assert commits(folder) == true
    compact(folder)
    assert (commits(folder), len(segments_of(folder))) == (true, 1)


def test_what_is_no_ended_run_is_refused(run: Path, tmp_path: Path) -> None:
    """Being written, killed, damaged, with segments of an earlier time: each with its mend."""
    journal = open_journal(tmp_path / "live")
    with pytest.raises(InputError, match="a run that has ended"):
        compact(tmp_path / "live")
    journal.close()
    with pytest.raises(InputError, match="luxloop campaign resume live"):
        compact(tmp_path / "live")
    (path,) = segments_of(run)
    whole = path.read_bytes()
    path.write_bytes(whole[:-3000])
    with pytest.raises(InputError, match="audit recover"):
        compact(run)
    path.write_bytes(whole)
    (run / "segments-before").mkdir()
    (run / "segments-before" / "audit-0001.mcap").touch()
    with pytest.raises(InputError, match="--remove"):
        compact(run)
    assert compact(run, remove=True).segments == 1
    with pytest.raises(InputError, match="RUN"):
        compact(tmp_path)


def test_nobody_goes_on_with_a_run_that_is_being_compacted(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A start at that moment finds the journal in use."""
    found: list[str] = []

    def try_to_write(paths: list[Path], fresh: Path) -> None:
        with pytest.raises(LuxloopError, match="being written by another process"):
            open_journal(paths[0].parent)
        found.append(fresh.name)

    monkeypatch.setattr(compact_module, "_compare", try_to_write)
    compact(run)
    assert found


def test_a_person_reads_sizes_before_and_after(run: Path) -> None:
    """As text, with the root that stays."""
    from typer.testing import CliRunner

    from tests.env_controller.test_recover import app

    text = CliRunner().invoke(app, ["compact", str(run), "--remove"]).stdout
    for wanted in ("1 made one", "bytes before", "as before", "removed"):
        assert wanted in text, wanted


def test_a_disk_that_gets_full_costs_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where, why and the mend are said; the run is as it was, and nothing else lies in its folder."""
    folder = tmp_path / "run"
    three_starts(folder)
    before = {path.name: path.read_bytes() for path in folder.iterdir()}

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(segment_module.SegmentFile, "finish", full)
    with pytest.raises(LuxloopError, match=r"cannot write in .*run: No space left on device; make room there"):
        compact(folder)
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


def test_a_copy_that_was_cut_is_made_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No second names, and the disk gets full in a copy: what is kept is whole, the next time comes to its end."""
    folder = tmp_path / "run"
    three_starts(folder)
    before = {path.name: path.read_bytes() for path in segments_of(folder)}

    def no_links(*_: object) -> None:
        raise OSError("no links here")

    def cut(path: Path, to: Path) -> None:
        if path.name == "audit-0002.mcap":
            to.write_bytes(path.read_bytes()[:1000])
            raise OSError(28, "No space left on device")
        to.write_bytes(path.read_bytes())

    monkeypatch.setattr(os, "link", no_links)
    with monkeypatch.context() as patch:
        patch.setattr(compact_module, "copy2", cut)
        with pytest.raises(LuxloopError, match="make room there"):
            compact(folder)
    assert [path.name for path in (folder / "segments-before").iterdir()] == ["audit-0001.mcap"]
    assert compact(folder).segments == 3
    assert {path.name: path.read_bytes() for path in (folder / "segments-before").iterdir()} == before
