"""Rows of `luxloop campaign list`."""

from __future__ import annotations

from agent.runs_command import _row_text


def test_a_comparison_has_no_steps_and_no_best() -> None:
    """It had been listed as a campaign that found nothing yet; a campaign still is."""
    row = {"folder": "runs/a-compare", "kind": "validation", "state": "ended", "steps": 0, "best": None}
    assert _row_text(row).split() == ["a-compare", "validation", "ended"]
    assert _row_text(row | {"kind": "campaign"}).endswith("0 steps  nothing yet")
