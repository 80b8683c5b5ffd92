"""What sets of one light share: the anchor with which the fit of the first one ended."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from luxloop.model_file import find_model
from validation.blind_test.judging import Shared, SharedDiagnosing, SharedSolver
from validation.diagnosing import Diagnosing
from validation.prediction import Anchored

PAPER = find_model("paper")
MOVED = PAPER.with_value("environment.receiver.reflectance", 0.3)


def test_the_first_set_makes_its_anchor_anew_where_its_fit_moves_and_lends_the_last(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Where the twin ends at first may be far from where the fit ends: 311 /cm for 205, with nothing hidden."""
    shared = Shared("a")
    solver = SharedSolver(1000, 1, shared=shared)
    nobody: Any = None  # neither data nor workers are asked here
    engine: Any = SharedDiagnosing(PAPER, nobody, nobody, nobody, solver, (), shared=shared)

    def fitted(self: Any, model: Any) -> Any:
        asked = [self.solver.anchor(one) for one in (model, MOVED)]
        return SimpleNamespace(problem=SimpleNamespace(anchor=asked[-1]), asked=asked)

    monkeypatch.setattr(Diagnosing, "fitted", fitted)
    first, second = engine.fitted(PAPER), engine.fitted(PAPER)
    assert first.asked == [Anchored(PAPER, 1000, 1), Anchored(MOVED, 1000, 1)]
    assert second.asked == [Anchored(MOVED, 1000, 1)] * 2
