"""`luxloop audit info|verify`: what is there is told, what is not what was written is found."""

from __future__ import annotations

import json
import random
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import typer
from mcap.writer import Writer
from typer.testing import CliRunner

from env_controller.audit import commands
from env_controller.audit.machine import machine
from luxloop.errors import InputError
from luxloop.journal.chain import Mark
from luxloop.journal.reader import RunJournal, segments_of
from luxloop.journal.scan import Scan
from luxloop.journal.segment import Segment
from luxloop.journal.topics import Record, step_record
from tests.journals import METADATA, a_step, open_journal, put, records_of_step, write_run

app = typer.Typer()
app.command()(commands.info)
app.command()(commands.verify)


def ask(*argv: object) -> tuple[int, dict[str, Any]]:
    """Exit code and document of a command."""
    done = CliRunner().invoke(app, [*map(str, argv), "--json"], catch_exceptions=False)
    return done.exit_code, json.loads(done.stdout)


def said(document: dict[str, Any]) -> str:
    """All findings that are no `ok`, in one text."""
    return "; ".join(
        f"{f['verdict']} {f['what']}: {f['found']}" for f in document["findings"] if f["verdict"] != "ok"
    )


def rewritten(folder: Path, records: list[Record]) -> Path:
    """A journal of these records in a folder of its own, each step a commit: what a forger with our code can make."""
    folder.mkdir()
    segment = Segment(folder / "audit-0001.mcap", Mark(), METADATA, {})
    for place, entry in enumerate(records):
        segment.write(entry)
        if place + 1 == len(records) or records[place + 1].sequence != entry.sequence:
            segment.commit()
    segment.finish()
    return folder


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A finished run of six steps, as `runs/a-run`."""
    write_run(tmp_path / "runs" / "a-run", 6)
    return tmp_path / "runs" / "a-run"


def test_what_was_written_is_found_whole(run: Path) -> None:
    """Exit 0; all lines ok; the chain's count is that of the records, metadata and attachments."""
    code, document = ask("verify", run)
    assert (code, said(document)) == (0, "")
    assert document["chain"]["records"] == len(list(RunJournal(run).records())) + 4


def test_info_says_what_is_there(run: Path) -> None:
    """Counts, sizes, the best step, the root that the side file has."""
    code, document = ask("info", "a-run", "--runs", run.parent)
    assert code == 0
    assert (document["run"], document["kind"], document["state"], document["steps"]) == (
        "a-run",
        "campaign",
        "finished",
        6,
    )
    assert document["topics"]["/map/sim"] == document["topics"]["/request/ray"] == 6
    assert (document["best"]["number"], document["best"]["uniformity"]) == (5, 0.55)
    assert document["best_final"] is None
    assert document["size_bytes"] == segments_of(run)[0].stat().st_size
    assert document["span_s"] == pytest.approx(0.005, abs=1e-4)
    assert f"{document['chain']['root']} {document['chain']['records']}\n" == (run / "audit.sha256").read_text()
    assert document["attachments"] == {"model.toml": 20, "empty": 0}


def test_info_for_people_has_units(run: Path) -> None:
    """The same as text."""
    text = CliRunner().invoke(app, ["info", str(run)]).stdout
    assert "a-run (campaign), finished" in text
    assert "uniformity 55.00 +- 0.00 %: D 180, W 28, S 500, T 35 um, 6.5 pairs (lane 0, step 5)" in text
    assert " MB in 1 segment" in text


def test_the_best_is_feasible_and_finalists_are_told_apart(tmp_path: Path) -> None:
    """An infeasible step, a failed one and a finalist do not win the walk."""
    bad = a_step(0, 0.99, feasible=False, reason="chips overlap")
    failed = a_step(1, 0.98, failure={"code": "crashed", "message": "no"})
    steps = [bad, failed, a_step(2, 0.7), a_step(3, 0.9, final=True, role="finalist")]
    entries = [records_of_step(step.number)[3] for step in steps]
    folder = rewritten(
        tmp_path / "r", [step_record(s, e.sequence, e.log_time_ns) for s, e in zip(steps, entries, strict=True)]
    )
    _, document = ask("info", folder)
    assert (document["best"]["number"], document["best_final"]["number"]) == (2, 3)


def test_two_segments_are_one_chain(tmp_path: Path) -> None:
    """Killed after three steps, resumed, finished: nothing is wrong; the first part's end is mentioned."""
    write_run(tmp_path, 3, finish=False)
    write_run(tmp_path, 2, first=3)
    code, document = ask("verify", tmp_path)
    assert code == 0
    assert said(document) == "note audit-0001.mcap: was not finished; the run went on in the next"
    assert ask("info", tmp_path)[1]["steps"] == 5


def test_an_unfinished_run_may_lack_its_tail(tmp_path: Path) -> None:
    """Exit 3, until a root and a count that were kept say that all is there."""
    write_run(tmp_path, 3, finish=False)
    code, document = ask("verify", tmp_path)
    assert code == 3
    assert "lost audit-0001.mcap: was not finished" in said(document)
    kept = document["chain"]
    assert ask("verify", tmp_path, "--root", kept["root"], "--records", kept["records"])[0] == 0
    assert ask("info", tmp_path)[1]["state"] == "not finished"


def test_a_run_that_is_being_written_is_no_loss(tmp_path: Path) -> None:
    """While its process lives."""
    journal = open_journal(tmp_path)
    put(journal, records_of_step(0))
    code, document = ask("verify", tmp_path)
    assert (code, said(document)) == (0, "note audit-0001.mcap: is being written")
    assert ask("info", tmp_path)[1]["state"] == "being written"
    journal.close()


def test_torn_bytes_are_told(tmp_path: Path) -> None:
    """A batch that was cut in the middle was never acknowledged."""
    write_run(tmp_path, 3, finish=False)
    (path,) = segments_of(tmp_path)
    path.write_bytes(path.read_bytes()[:-50])
    code, document = ask("verify", tmp_path)
    assert code == 3
    assert "of a batch that was never acknowledged" in said(document)


@pytest.mark.parametrize("seed", range(4))
def test_flipped_bits_are_found(run: Path, seed: int) -> None:
    """Anywhere in a finished segment: index, headers, checksums, contents, attachments."""
    (path,) = segments_of(run)
    whole = path.read_bytes()
    draw = random.Random(seed)
    missed = []
    for _ in range(60):
        place, bit = draw.randrange(len(whole)), draw.randrange(8)
        damaged = bytearray(whole)
        damaged[place] ^= 1 << bit
        path.write_bytes(damaged)
        try:
            found = ask("verify", run)[0] == 5
        except InputError:  # its name in the header: a file of another program
            found = place < 60
        if not found:
            missed.append((place, bit))
    assert missed == []


FORGERIES: dict[str, Callable[[list[Record]], list[Record]]] = {
    "edited": lambda records: [*records[:9], replace(records[9], data=records[3].data), *records[10:]],
    "reordered": lambda records: [records[1], records[0], *records[2:]],
    "deleted": lambda records: records[:2] + records[3:],
    "cut": lambda records: records[:-1],
    "another time": lambda records: [replace(records[0], log_time_ns=1), *records[1:]],
    "inserted": lambda records: [*records[:8], records[8], *records[8:]],
}


@pytest.mark.parametrize("forgery", FORGERIES)
def test_a_file_written_anew_does_not_have_the_root_that_left_the_machine(
    run: Path, tmp_path: Path, forgery: str
) -> None:
    """Its own checksums, chain and side file are all right: only what was kept elsewhere tells."""
    kept = ask("verify", run)[1]["chain"]
    records = list(RunJournal(run).records())
    honest = rewritten(tmp_path / "honest", records)
    assert ask("verify", honest)[0] == 0
    forged = rewritten(tmp_path / "forged", FORGERIES[forgery](records))
    code, document = ask("verify", forged, "--root", kept["root"], "--records", kept["records"])
    assert code == 5
    assert "broken the given root and count" in said(document)
    assert ask("verify", forged, "--root", kept["root"])[0] == 5


@pytest.mark.parametrize("forgery", [forgery for forgery in FORGERIES if forgery != "cut"])
def test_a_changed_record_under_the_old_marks_is_found(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, forgery: str
) -> None:
    """A forger who rewrites the file with right checksums but the chain's marks as they were."""
    marks = [Mark()]

    def remember(mark: Mark, links: Any) -> Mark:
        marks.append(true_then(mark, links))
        return marks[-1]

    true_then = Mark.then
    records = list(RunJournal(run).records())
    monkeypatch.setattr(Mark, "then", remember)
    rewritten(tmp_path / "honest", records)
    old = iter(marks[1:])
    monkeypatch.setattr(Mark, "then", lambda mark, _: next(old, mark))
    forged = rewritten(tmp_path / "forged", FORGERIES[forgery](records))
    monkeypatch.undo()
    code, document = ask("verify", forged)
    assert code == 5, said(document)


def test_a_tail_cut_off_is_found_by_what_was_kept(tmp_path: Path) -> None:
    """After a kill nothing in the file itself can tell; a root and a count can, or a count alone."""
    write_run(tmp_path, 3, finish=False)
    (path,) = segments_of(tmp_path)
    kept = ask("verify", tmp_path)[1]["chain"]
    scan = Scan(path)
    ends = [scan.read_bytes for _ in scan]
    path.write_bytes(path.read_bytes()[: ends[-1]])
    code, document = ask("verify", tmp_path, "--root", kept["root"], "--records", kept["records"])
    assert code == 5
    assert "a tail is cut off" in said(document)
    assert ask("verify", tmp_path, "--records", kept["records"])[0] == 5
    assert ask("verify", tmp_path, "--root", kept["root"])[0] == 5
    assert ask("verify", tmp_path)[0] == 3


def test_the_side_file_sees_a_finished_run_that_was_cut(run: Path) -> None:
    """It lies in the same folder: good against accidents."""
    (path,) = segments_of(run)
    path.write_bytes(path.read_bytes()[:-9000])
    code, document = ask("verify", run)
    assert code == 5
    assert "audit.sha256" in said(document)


def test_an_earlier_root_is_part_of_a_longer_run(tmp_path: Path) -> None:
    """What was printed when the first part ended."""
    write_run(tmp_path, 2)
    kept = ask("verify", tmp_path)[1]["chain"]
    write_run(tmp_path, 2, first=2)
    code, document = ask("verify", tmp_path, "--root", kept["root"], "--records", kept["records"])
    assert code == 0
    assert any("records after it" in finding["found"] for finding in document["findings"])


def test_a_missing_or_foreign_segment_breaks_the_run(run: Path, tmp_path: Path) -> None:
    """Removed, or taken from another run."""
    write_run(run, 1, first=6)
    write_run(run, 1, first=7)
    assert ask("verify", run)[0] == 0
    missing = Path(shutil.copytree(run, tmp_path / "missing"))
    (missing / "audit-0002.mcap").unlink()
    code, document = ask("verify", missing)
    assert code == 5
    assert "segment 2 is missing" in said(document)
    write_run(tmp_path / "other", 6)
    shutil.copy(tmp_path / "other" / "audit-0001.mcap", run)
    code, document = ask("verify", run)
    assert code == 5
    assert "of another root" in said(document)


def test_steps_and_replies_are_counted(tmp_path: Path) -> None:
    """A step that is missing, one that is there twice, a request without a reply, one whose id is not its inputs'."""
    steps = [records_of_step(number) for number in range(4)]
    gap = rewritten(tmp_path / "gap", steps[0] + steps[2])
    assert "broken steps: 1 missing in the sequence, the first is 1" in said(ask("verify", gap)[1])
    twice = rewritten(tmp_path / "twice", steps[0] + steps[1] + [replace(steps[2][3], sequence=1)])
    assert "broken steps: 1 numbers are there twice: 1" in said(ask("verify", twice)[1])
    code, document = ask("verify", rewritten(tmp_path / "silent", steps[0] + steps[1][:1] + steps[1][2:]))
    assert code == 3
    assert "lost requests: 1 of 2 without a reply" in said(document)
    other = steps[0][0].data.replace(b'\\"power\\":0.1', b'\\"power\\":0.2')
    assert other != steps[0][0].data
    code, document = ask("verify", rewritten(tmp_path / "id", [replace(steps[0][0], data=other), *steps[0][1:]]))
    assert code == 5
    assert "has not the id of its inputs" in said(document)


def test_a_step_number_out_of_all_bounds_is_no_trouble(tmp_path: Path) -> None:
    """Four thousand million missing steps are counted, not listed."""
    records = records_of_step(0)[3:4]
    folder = rewritten(tmp_path / "r", [*records, replace(records[0], sequence=2**32 - 1)])
    assert "4,294,967,294 missing in the sequence, the first is 1" in said(ask("verify", folder)[1])


def test_a_lane_counts_its_steps(tmp_path: Path) -> None:
    """A number left out, one that is there twice, two that have changed places: named with their lanes."""
    steps = [a_step(number, lane=lane) for number in range(3) for lane in range(2)]

    def told(name: str, change: dict[int, int]) -> str:
        changed = [step.model_copy(update={"number": change.get(i, step.number)}) for i, step in enumerate(steps)]
        code, document = ask(
            "verify", rewritten(tmp_path / name, [step_record(step, i, 9) for i, step in enumerate(changed)])
        )
        assert code == (5 if change else 0)
        return said(document)

    assert told("whole", {}) == ""
    assert "broken audit-0001.mcap: step 3 is action 70,000 of lane 1, where action 1 is due" in told(
        "gap", {3: 70_000}
    )
    assert "step 4 is action 1 of lane 0, where action 2 is due" in told("twice", {4: 1})
    assert "step 1 is action 1 of lane 1, where action 0 is due" in told("swapped", {1: 1, 3: 0})
    both = told("both", {2: 2, 3: 2})
    assert both.count("is due") == 2


def test_a_lane_counts_on_in_the_next_segment(tmp_path: Path) -> None:
    """Which repeats a number of the one before."""
    write_run(tmp_path, 3)
    journal = open_journal(tmp_path)
    put(journal, [step_record(a_step(2), 3, 9)])
    journal.finish()
    journal.close()
    code, document = ask("verify", tmp_path)
    assert code == 5
    assert "broken audit-0002.mcap: step 3 is action 2 of lane 0, where action 3 is due" in said(document)


@pytest.mark.parametrize("topic", ["/step", "/agent", "/note", "/log", "/map/sim"])
@pytest.mark.parametrize("data", [b"{not json", b"\xff\xfe", b'{"run":"x"}', b"[" * 100_000])
def test_a_record_that_is_none_breaks_the_journal(tmp_path: Path, topic: str, data: bytes) -> None:
    """It was not written by the controller; which one it is, is told."""
    records = records_of_step(0)
    folder = rewritten(tmp_path / "r", [*records, Record(topic, 0, 9, data)])
    code, document = ask("verify", folder)
    assert code == 5
    assert f"broken audit-0001.mcap: {topic} of step 0" in said(document)


def test_another_format_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the whole run, or of one segment of several: what this release would read there may mean something else."""
    with monkeypatch.context() as patch:
        patch.setattr("luxloop.journal.segment.FORMAT", "2")
        write_run(tmp_path / "whole", 2)
    told = "broken audit-000{}.mcap: written in format 2; this release reads 1"
    code, document = ask("verify", tmp_path / "whole")
    assert (code, told.format(1) in said(document)) == (5, True)
    write_run(tmp_path / "mixed", 2)
    with monkeypatch.context() as patch:
        patch.setattr("luxloop.journal.segment.FORMAT", "2")
        write_run(tmp_path / "mixed", 2, first=2)
    code, document = ask("verify", tmp_path / "mixed")
    assert (code, told.format(2) in said(document), told.format(1) in said(document)) == (5, True, False)


def foreign(folder: Path) -> None:
    """A run's folder with an MCAP file of another program."""
    folder.mkdir()
    with (folder / "audit-0001.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start("ros2", "libother")
        writer.finish()  # type: ignore[no-untyped-call]  # mcap leaves its return type open


@pytest.mark.parametrize("command", ["info", "verify"])
def test_bad_input_names_what_is_wrong(run: Path, tmp_path: Path, command: str) -> None:
    """No such run, nearly such a run, a file, an empty folder, another program's file, no folder of runs at all."""
    foreign(tmp_path / "foreign")
    (tmp_path / "empty").mkdir()
    for argv, named in {
        ("b-run", "--runs", run.parent): "did you mean a-run?",
        ("zzzzzz", "--runs", run.parent): "there are a-run",
        ("", "--runs", run.parent): "RUN",
        ("x", "--runs", tmp_path / "nowhere"): "--runs",
        (run / "audit-0001.mcap",): "it is a file",
        (tmp_path / "empty",): "audit-",
        (tmp_path / "foreign",): "libother",
    }.items():
        with pytest.raises(InputError, match=re.escape(named)):
            ask(command, *argv)


def test_a_text_under_the_name_of_a_journal_is_none(tmp_path: Path) -> None:
    """Nothing to tell of it; to the auditor it is a damaged file."""
    (tmp_path / "audit-0001.mcap").write_text("this is no such file at all")
    with pytest.raises(InputError, match="none with the beginning of a journal"):
        ask("info", tmp_path)
    code, document = ask("verify", tmp_path)
    assert code == 5
    assert "damaged after 0 bytes: not a valid MCAP file" in said(document)


@pytest.mark.parametrize("root", ["", "abc", "g" * 64, "A" * 64])
def test_a_root_has_64_digits(run: Path, root: str) -> None:
    """Said with the option's name."""
    with pytest.raises(InputError, match="--root"):
        ask("verify", run, "--root", root)


def test_a_count_is_at_least_one(run: Path) -> None:
    """Bad usage is exit 2."""
    assert CliRunner().invoke(app, ["verify", str(run), "--records", "0"]).exit_code == 2


def test_the_machine_is_described_in_text() -> None:
    """Metadata of such files is text by name; the packages that write it are named."""
    facts = machine()
    assert all(facts.values())
    assert facts["mcap"][0].isdigit()
