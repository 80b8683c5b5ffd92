"""When a run has enough histories: at a count, or when the standard error of its uniformity is small enough.

Whether to go on, and to which count, follows from results alone, so a request gives the same histories, hence the
same bits, on any machine. The clock decides one thing: a target that would take longer than the budget is refused.

    4 blocks, error e -> blocks x (e / target)^2 x 1.05, at most twice as many, -> ... until e <= target

The error is itself known to 13 % only (32 groups), and a run stops where it happens to be small: stated errors are
4 % too small on average, and 94 to 95.5 % of the 95 % intervals hold the truth (4,000 runs each with pure noise, for
targets 1 to 30 times below the first error; tests/containers/test_simulation.py repeats some).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import ceil, floor, inf, log10, sqrt
from time import perf_counter
from typing import Protocol, TypeVar

from containers.ray_tracing.monte_carlo import BLOCK, blocks_of
from containers.ray_tracing.tally import Tally
from luxloop.computation import Progress
from luxloop.errors import InputError

Found = TypeVar("Found")

FIRST_BLOCKS = 4
MARGIN = 1.05
OVERRUN = 2.0
"""A run whose estimate was within its budget goes on up to so many budgets: the estimate was not exact."""
POINTS = 100.0


class Solver(Protocol):
    """What traces histories, `MonteCarlo` or `Landing`."""

    tally: Tally

    def run_to(self, histories: int, report: Callable[[float], None] | None = None) -> Tally:
        """Trace until each group has `histories`, whole blocks."""
        ...


@dataclass(frozen=True)
class Target:
    """The error to reach and what it may take."""

    error: float
    """Standard error, as a share (0.003 for 0.3 points)."""
    budget_s: float


def run_to_count(solver: Solver, histories: int, progress: Progress) -> None:
    """Trace `histories` of all groups together, or up to a block of each more. Raises Stopped where cancelled."""
    each = blocks_of(histories, solver.tally.groups)
    solver.run_to(each, lambda share: progress.report(share, _note(each * solver.tally.groups)))


def run_to_error(
    solver: Solver, look: Callable[[Tally], tuple[float, Found]], target: Target, progress: Progress
) -> Found:
    """What a look at the tally finds once its error is at most the target's; traces until then.

    Parameters
    ----------
    look : standard error of what is wanted, infinity where the histories are too few to tell, and what it is of.

    Raises
    ------
    InputError : the target would take more than its budget; says how long, and which error the budget reaches.
    Stopped : cancelled.
    """
    begin_s, blocks, pilot = perf_counter(), FIRST_BLOCKS, True
    wanted = float(blocks)
    while True:
        done, note = solver.tally.histories / BLOCK, _note(blocks * BLOCK * solver.tally.groups)
        solver.run_to(blocks * BLOCK, lambda share: progress.report((done + share * (blocks - done)) / wanted, note))  # noqa: B023  # called in this pass only
        error, found = look(solver.tally)
        if error <= target.error:
            return found
        del found  # it may be large, and tracing goes on
        wanted = blocks * (error / target.error) ** 2 * MARGIN
        took_s = perf_counter() - begin_s
        _refuse_over_budget(target, error, took_s, took_s * wanted / blocks, 1.0 if pilot else OVERRUN)
        blocks, pilot = next_blocks(blocks, error, target.error), pilot and error == inf


def next_blocks(blocks: int, error: float, target: float) -> int:
    """The count to go on to: what error^2 ~ 1 / count asks for and 5 % more, at least one more, at most twice."""
    wanted = 2.0 * blocks if error == inf else blocks * (error / target) ** 2 * MARGIN
    return max(blocks + 1, min(ceil(wanted), 2 * blocks))


def _refuse_over_budget(target: Target, error: float, took_s: float, total_s: float, budgets: float) -> None:
    """InputError where the estimated time is over the budget; while nothing is known of the error, the time taken."""
    if (took_s if error == inf else total_s) <= budgets * target.budget_s:
        return
    asked = target.error * POINTS
    if error == inf:
        allowed = "an error that can be told"
        mend = f"{took_s:.3g} s were not enough to tell any error: raise budget_s, or give histories"
        raise InputError("target_error_points", asked, allowed, mend)
    reached = error * sqrt(MARGIN * took_s / target.budget_s) * POINTS
    raise InputError(
        "target_error_points",
        asked,
        f"{_upwards(reached):g} or more within budget_s = {target.budget_s:g}",
        f"it would take about {total_s:.2g} s here: raise budget_s, or ask for less",
    )


def _upwards(value: float) -> float:
    """`value` with two digits, not below it."""
    step = 10.0 ** (floor(log10(value)) - 1)
    return ceil(value / step) * step


def _note(histories: int) -> str:
    return f"{histories:,} histories"
