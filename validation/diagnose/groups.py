"""Groups of one effect as one: chips stand off along x and along y alike, and all members share one spread."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from validation.diagnose.score import Candidate


def joined(candidates: Sequence[Candidate]) -> list[Candidate]:
    """The candidates, those of one effect's parameters per chip in one shape put together into the first of them."""
    found: list[Candidate] = []
    for one in candidates:
        alike = next((k for k, other in enumerate(found) if one.is_group and _same(one, other)), None)
        if alike is None:
            found.append(one)
        else:
            found[alike] = replace(found[alike], columns=np.concatenate([found[alike].columns, one.columns]))
    return found


def _same(one: Candidate, other: Candidate) -> bool:
    """Whether two groups are of one effect and shape, in one unit and range."""
    kinds = [(c.effect.name, c.shape, c.parameter.unit, c.parameter.lower, c.parameter.upper) for c in (one, other)]
    return other.is_group and kinds[0] == kinds[1]
