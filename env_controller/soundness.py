"""Whether a worker's answer can be what it says: before anybody learns from it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from luxloop.bus.frame import Array
from luxloop.failure import Failure
from luxloop.journal.image import image_of
from luxloop.messages import Outcome, Task
from luxloop.ray import Film
from luxloop.words import parse

LEDGER = 1e-6  # of the emitted light; a sound ledger closes to 1e-12
OVER_ONE = 1e-6  # rounding of a flat map


def sound(task: Task, outcome: Outcome, arrays: Mapping[str, Array]) -> Outcome:
    """The outcome, where nothing speaks against it; else one with the failure `crashed`, which says what does."""
    why = _against(task, outcome, arrays)
    if not why:
        return outcome
    failure = Failure(
        code="crashed",
        message=f"the answer of {outcome.worker or 'a worker'} does not hold: {why}",
        mend="stop that worker; luxloop doctor says which releases run",
        where="controller",
    )
    return outcome.model_copy(update={"result": None, "failure": failure})


def _against(task: Task, outcome: Outcome, arrays: Mapping[str, Array]) -> str:
    """What speaks against an answer: not all is there that was asked for, or it is not what it can be."""
    result = outcome.result or {}
    if outcome.compute_s < 0.0:
        return f"a computing time of {outcome.compute_s:g} s"
    for name, array in arrays.items():
        if task.kind == "ray" and array.dtype.kind == "f" and not np.isfinite(array).all():
            return f"{name} holds values that are not finite"
    try:
        if task.kind == "ray" and "design" in task.inputs:
            image_of(arrays["map_lx"], 0)  # its largest, of 512 x 512 pixels, still travels in the frame
            return _evaluation(result)
        if task.kind == "film" and task.inputs.get("what") == "table":
            parse(Film, {"sha256": result["table_sha256"], "bytes": result["table_bytes"]}, "its table")
    except (KeyError, TypeError, ValueError) as error:
        return f"it lacks {error}" if isinstance(error, KeyError) else str(error)
    return ""


def _evaluation(result: Mapping[str, Any]) -> str:
    """What speaks against a design's figures."""
    found = result["metrics"]["uniformity"]
    value, error = float(found["value"]), float(found["standard_error"])
    if not 0.0 <= value <= 1.0 + OVER_ONE:
        return f"a uniformity of {value:g} is not within 0 and 1"
    if not 0.0 <= error < np.inf:
        return f"a standard error of {error:g}"
    defect = float(result.get("ledger_defect", 0.0))
    return "" if abs(defect) < LEDGER else f"its ledger is off by {defect:g} of the light"
