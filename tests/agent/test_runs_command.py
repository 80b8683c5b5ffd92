"""Rows of `luxloop campaign list`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from agent.overview import overview
from agent.recorded import begun_by, object_in
from agent.runs_command import _row, _row_text
from luxloop.errors import InputError
from luxloop.journal.chain import GENESIS, Mark
from luxloop.journal.segment import FORMAT, Segment, SegmentFile, metadata_link
from luxloop.journal.topics import CHAIN, Checkpoint, log_record, record
from tests.env_controller.test_index import forged
from tests.journals import START_NS, write_run


def test_a_comparison_has_no_steps_and_no_best() -> None:
    """It had been listed as a campaign that found nothing yet; a campaign still is."""
    row = {"folder": "runs/a-compare", "kind": "validation", "state": "ended", "steps": 0, "best": None}
    assert _row_text(row).split() == ["a-compare", "validation", "ended"]
    assert _row_text(row | {"kind": "campaign"}).endswith("0 steps  nothing yet")


@pytest.mark.parametrize("facts", ["[]", "{", "[" * 100_000])
def test_facts_that_are_none_make_a_damaged_row(tmp_path: Path, facts: str) -> None:
    """Of an interrupted comparison, whose facts hold the command that goes on with it."""
    run = {"run": tmp_path.name, "kind": "validation", "facts": facts}
    Segment(tmp_path / "audit-0001.mcap", Mark(), {"run": run}, {}).close()
    row = _row(overview, tmp_path)
    assert "facts" in row["damaged"]
    assert "audit verify" in _row_text(row)


def test_what_began_a_run_is_told_where_it_is_a_list() -> None:
    """Anything else is none."""
    assert begun_by(object_in('{"argv": ["compare", "a b"]}', "facts")) == "luxloop compare 'a b'"
    assert begun_by({"argv": 5}) == begun_by({}) == ""
    with pytest.raises(InputError, match="facts"):
        object_in("null", "facts")


@pytest.mark.parametrize("offset", [1 << 63, (1 << 63) - 20, 1 << 40])
@pytest.mark.parametrize("kind", ["chunk", "metadata"])
def test_an_index_that_points_nowhere_makes_a_damaged_row(tmp_path: Path, kind: str, offset: int) -> None:
    """Of a finished run."""
    write_run(tmp_path, 1)

    def change(index: Any) -> None:
        if kind == "chunk":
            index.chunk_indexes[1].chunk_start_offset = offset
        else:
            index.metadata_indexes[1].offset = offset

    forged(tmp_path / "audit-0001.mcap", change)
    assert "damaged (" in _row(overview, tmp_path)["damaged"]


def test_a_run_that_began_with_records_is_listed(tmp_path: Path) -> None:
    """No opening of ours has any; a damaged one does not hide other runs."""
    file = SegmentFile(tmp_path / "audit-0001.mcap")
    links = [metadata_link("run", {"journal": FORMAT, "records_before": "0", "root_before": GENESIS})]
    links.append(log_record("a line", 0, START_NS))
    for link in links:
        file.add(link)
    mark = Mark().then(links)
    file.add(record(CHAIN, Checkpoint(records=mark.records, root=mark.root), 0, START_NS))
    file.sync()
    file.close()
    assert _row(overview, tmp_path)["state"] == "killed"
