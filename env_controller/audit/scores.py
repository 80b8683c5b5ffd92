"""Differences in standard errors: whether two results of one question agree, and whether their errors are honest.

    z = (now - logged) / sqrt(error_now^2 + error_logged^2)

With other random numbers the squares of z have mean 1 where the errors are right; with the same ones z is near 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

AGREES = 5.0
"""Largest |z| of two numbers that agree: 32 groups on both sides pass it once in 200,000 times."""
AGREES_PIXEL = 6.0
"""The same of the worst pixel of a map, of which some hundred are independent."""
EDGES = np.arange(-3.0, 3.01, 0.5)
BAR = 40


def z_of(now: float, now_error: float, logged: float, logged_error: float) -> float | None:
    """The difference in joint standard errors; None where both have none and the numbers differ."""
    error = float(np.hypot(now_error, logged_error))
    if error == 0.0:
        return 0.0 if now == logged else None
    return (now - logged) / error


def summary(z: Sequence[float]) -> dict[str, Any]:
    """Count, mean square and how far from 1 it usually is, largest |z|, and a histogram: below the first edge,
    between edges, above the last. Designs of one walk share their seed: their z are not quite independent."""
    values = np.asarray(z, np.float64)
    counts = np.bincount(np.searchsorted(EDGES, values, side="right"), minlength=EDGES.size + 1)
    return {
        "count": int(values.size),
        "chi2_per_count": float(np.mean(values**2)),
        "chi2_error": float(np.sqrt(2.0 / values.size)),
        "largest": float(np.max(np.abs(values))),
        "histogram": {"edges": EDGES.tolist(), "counts": counts.tolist()},
    }


def as_text(what: str, one: dict[str, Any]) -> list[str]:
    """A summary for people, with bars."""
    expected = f"1 +- {one['chi2_error']:.2f} for new seeds and right errors"
    numbers = f"chi2/n {one['chi2_per_count']:.2f} ({expected}), largest |z| {one['largest']:.2f}"
    head = f"z of {what}: {one['count']:,} compared, {numbers}"
    edges, counts = one["histogram"]["edges"], one["histogram"]["counts"]
    names = [f"below {edges[0]:g}", *(f"{low:g} to {low + 0.5:g}" for low in edges[:-1]), f"above {edges[-1]:g}"]
    most = max(*counts, 1)
    return [head, *(f"  {name:>12} {count:>6} {'#' * round(BAR * count / most)}".rstrip()
                    for name, count in zip(names, counts, strict=True))]  # fmt: skip
