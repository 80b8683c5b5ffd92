"""Whether a worker's answer can be what it says: before anybody learns from it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from luxloop.bus.frame import Array
from luxloop.failure import Failure
from luxloop.messages import Outcome

LEDGER = 1e-6  # of the emitted light; a sound ledger closes to 1e-12
OVER_ONE = 1e-6  # rounding of a flat map


def sound(kind: str, outcome: Outcome, arrays: Mapping[str, Array]) -> Outcome:
    """The outcome, where nothing speaks against it; else one with the failure `crashed`, which says what does."""
    why = _against(kind, outcome, arrays)
    if not why:
        return outcome
    failure = Failure(
        code="crashed",
        message=f"the answer of {outcome.worker or 'a worker'} does not hold: {why}"[:4000],
        mend="stop that worker; luxloop doctor says which releases run",
        where="controller",
    )
    return outcome.model_copy(update={"result": None, "failure": failure})


def _against(kind: str, outcome: Outcome, arrays: Mapping[str, Array]) -> str:
    result = dict(outcome.result or {})
    for name, array in arrays.items():
        if kind == "ray" and array.dtype.kind == "f" and not np.isfinite(array).all():
            return f"{name} holds values that are not finite"
    try:
        if kind == "ray" and "metrics" in result:
            return _ray(result)
        return _film(result) if kind == "film" and "table_sha256" in result else ""
    except (KeyError, TypeError, ValueError) as error:
        return f"it lacks {error}" if isinstance(error, KeyError) else str(error)


def _ray(result: dict[str, Any]) -> str:
    found = result["metrics"]["uniformity"]
    value, error = float(found["value"]), float(found["standard_error"])
    if not 0.0 <= value <= 1.0 + OVER_ONE:
        return f"a uniformity of {value:g} is not within 0 and 1"
    if not 0.0 <= error < np.inf:
        return f"a standard error of {error:g}"
    defect = float(result.get("ledger_defect", 0.0))
    return "" if abs(defect) < LEDGER else f"its ledger is off by {defect:g} of the light"


def _film(result: dict[str, Any]) -> str:
    sha256 = result["table_sha256"]
    if len(sha256) != 64 or not set(sha256) <= set("0123456789abcdef"):
        return "the hash of its table is none"
    return "" if int(result["table_bytes"]) > 0 else "its table is empty"
