"""The nonlinear fit: Levenberg and Marquardt over whitened columns, the variance renewed with the prediction.

Within an iteration the whitening is held, so chi2 before and after a step mean the same; a new whitening is made from
each accepted prediction (letting the variance answer to the step would favour predictions with large variances).
About an anchor the columns are the twin's (`problem`), so what is solved is columns' residual + priors = 0, and that
is not where chi2 is least. A step is therefore good that lowers chi2, or what the columns still find in the residual:
the square of its projection on them, which the linear model expects to gain. It has converged where that is less than
0.1 and no pose would move by 0.001 px; that last step is taken on the linear model, whose own error is of the next
order. About an anchor with noise the last steps are others (`_settled`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from validation.fit.least_squares import Reduced, Step, prior_chi2, reduce
from validation.fit.parameters import gain_of
from validation.fit.problem import Evaluation, Problem
from validation.fit.result import Fit, conclude
from validation.fit.whitening import Whitening

Real = NDArray[np.float64]

GAP = 0.1  # chi2
NOISY_GAP = 1.0  # chi2: what derivatives with noise of their own may still promise
STALLS = 2  # steps in a row that gain nothing
SETTLED, SETTLING = 0.1, 8  # of an error that the last step about a noisy anchor may be long; most steps
FAR = 30.0  # errors: a step as long is not one of the last, and by noisy columns may lead anywhere
LEAST_TAKEN = 0.1  # of a step
RISE = 30.0  # chi2: what is solved for instead of the least chi2 lies within some errors of it
POSE_PX = 1e-3
MAX_ITERATIONS = 40
PROMISED = 3.0  # times what columns promise: a bent way may gain as much
MAX_DAMPING = 1e6


def refitted(problem: Problem, values: Real, most: int = MAX_ITERATIONS, below: float = np.inf) -> Fit:
    """The fit of a problem from given values, about the anchor that it has, in so many iterations at most.

    It is to the problem's own pixels, all of them, so that chi2 is that of the fits beside it.
    `below`: what chi2 of data and priors is to reach; where columns no longer promise that, the fit ends as it is.
    """
    return _descend(problem, values, 0, most, below)


def unclipped(problem: Problem, values: Real, done: int = 0, most: int = MAX_ITERATIONS) -> Fit:
    """The optimum, without pixels that may have been clipped, or been kept because noise made them darker."""
    found = _descend(problem, values, done, most)
    images = []
    for image, signal_dn in zip(problem.images, found.signals_dn, strict=True):
        used = image.used & ~image.may_be_clipped(signal_dn)
        images.append(image if used.sum() in (0, image.used.sum()) else replace(image, used=used))
    if all(new is old for new, old in zip(images, problem.images, strict=True)):
        return found
    return _descend(replace(problem, images=tuple(images)), found.values, found.iterations, most)


def _descend(problem: Problem, values: Real, done: int, most: int, below: float = np.inf) -> Fit:
    """Iterates from `values` to the optimum, or as far as it goes."""
    noisy = problem.anchor is not None and problem.anchor.histories > 0
    evaluation, damping, stalled, pace = problem.evaluate(values), 0.0, 0, Pace()
    for iteration in range(done, done + most):
        white, reduced, columns = linearised(evaluation)
        last = reduced.step()
        if noisy and reduced.chi2 - last.chi2 < NOISY_GAP:
            return _settled(evaluation, iteration)
        if has_converged(problem, reduced, last):
            return conclude(evaluation, white, reduced, columns, last, iteration, True)
        if reduced.chi2 - PROMISED * (reduced.chi2 - last.chi2) > below:
            return conclude(evaluation, white, reduced, columns, last, iteration, False)
        stepped, damping, gained = _step_down(evaluation, white, reduced, columns, damping, pace)
        if stepped is None:  # no step is good: the prediction and its derivatives disagree
            break
        evaluation = stepped
        stalled = stalled + 1 if gained < GAP else 0
        if stalled == STALLS:  # derivatives have noise of their own: what they still promise is theirs
            break
    if noisy:
        return _settled(evaluation, iteration + 1)
    white, reduced, columns = linearised(evaluation)
    last = reduced.step()
    near = reduced.chi2 - last.chi2 < NOISY_GAP
    return conclude(evaluation, white, reduced, columns, last, iteration + 1, near)


def _settled(evaluation: Evaluation, iteration: int) -> Fit:
    """The solution about an anchor with noise, from near it: columns' residual + priors = 0.

    Its steps are by the product of columns with columns of another walk. Steps by their own product fall short along
    what the data hardly know, for there most of a column is noise, and end up to an error from the solution. Where
    they are long, or chi2 would rise, or they take all light from an image, they are none of the last, and none is
    taken: the fit has not converged. Where noise is the larger part of a column they go too far, back, and further:
    what two of them show of that is made good (`Pace`).
    """
    problem, others, turn = evaluation.problem, evaluation.others(), 0
    pace = Pace()
    first = evaluation.whitening()
    highest = _chi2(evaluation, first) + RISE
    while True:
        white, reduced, columns = linearised(evaluation, None if turn else first)
        other = evaluation.other_columns(white, others)
        step = crossed(evaluation, white, reduced, columns, other)
        error = np.sqrt(np.diag(reduced.covariance_of(columns, other, 1.0, ~step.at_limit & ~reduced.blind)))
        seen = np.isfinite(error) & (error > 0.0)
        steps = np.where(seen, step.change / np.where(seen, error, 1.0), 0.0)
        longest = float(np.max(np.abs(steps), initial=0.0))
        near, turn = longest < SETTLED, turn + 1
        stepped = problem.unknowns.within(evaluation.values + pace.share_of(steps) * step.change)
        ends = near or longest > FAR or turn == SETTLING or is_dark(problem, stepped)
        there = None if ends else problem.evaluate(stepped)
        if there is None or _chi2(there, first) > highest:
            return conclude(evaluation, white, reduced, columns, step, iteration + turn, near, other)
        evaluation = there


def _chi2(evaluation: Evaluation, white: Whitening) -> float:
    """Of data and priors, by a given whitening."""
    residual = evaluation.residual(white)
    return float(residual @ residual) + prior_chi2(evaluation.problem.unknowns.parameters, evaluation.values)


def crossed(evaluation: Evaluation, white: Whitening, reduced: Reduced, columns: Real, other: Real) -> Step:
    """The step by the product of columns with others whose noise is independent.

    What is at a limit stays there where this step itself would lead beyond: the least chi2 of noisy columns is drawn
    towards where they were taken, so what began at a limit would never leave it.
    """
    parameters, values = reduced.parameters, evaluation.values
    at, held = reduced.at_limit(np.zeros(len(values))), np.zeros(len(values), bool)
    lower, upper = (np.array([getattr(one, side) for one in parameters]) for side in ("lower", "upper"))
    while True:
        change = reduced.crossed_step(columns, other, evaluation.residual(white), ~held & ~reduced.blind)
        beyond = at & ~held & ((values + change <= lower) | (values + change >= upper)) & (change != 0.0)
        if not beyond.any():
            break
        held |= beyond
    longest = np.array([one.longest_step for one in parameters])
    change = evaluation.problem.unknowns.within(values + np.clip(change, -longest, longest)) - values
    return Step(change, reduced.chi2_after(change), held)


@dataclass
class Pace:
    """How much of a step to take where steps go too far and back, for each makes another whitening: Aitken's way.

    For vectors: Irons and Tuck, Int. J. Numer. Methods Eng. 1, 275 (1969). A step that goes on is taken whole.
    """

    share: float = 1.0
    before: Real | None = None
    """The last step that was asked about."""

    def share_of(self, step: Real) -> float:
        """The share of a step to take; all parameters in units alike."""
        before, self.before = self.before, step
        if before is None or before @ step >= 0.0:
            self.share = 1.0
        else:
            back = step - before
            self.share = float(np.clip(-self.share * (before @ back) / (back @ back), LEAST_TAKEN, 1.0))
        return self.share


def linearised(evaluation: Evaluation, white: Whitening | None = None) -> tuple[Whitening, Reduced, Real]:
    """The whitening (that of the point, or a given one), the reduced linear problem and its whitened columns."""
    white = white or evaluation.whitening()
    columns = evaluation.columns(white)
    parameters = evaluation.problem.unknowns.parameters
    return white, reduce(columns, evaluation.residual(white), parameters, evaluation.values), columns


def has_converged(problem: Problem, reduced: Reduced, last: Step) -> bool:
    """Whether nothing worth having is left to gain."""
    return reduced.chi2 - last.chi2 < GAP and pose_move_px(problem, last.change) < POSE_PX


def pose_move_px(problem: Problem, change: Real) -> float:
    """How far a change moves any pixel of any image; a turn moves the corners most."""
    by_name = problem.unknowns.named(change)
    moves = [0.0]
    for image in problem.images:
        shot, corner_px = image.shot.id, np.hypot(*image.signal_dn.shape) / 2.0
        moves.append(np.hypot(by_name[f"{shot}.shift_row_px"], by_name[f"{shot}.shift_column_px"]))
        moves.append(np.radians(abs(by_name[f"{shot}.rotation_deg"])) * corner_px)
    return float(max(moves))


def _step_down(
    evaluation: Evaluation, white: Whitening, reduced: Reduced, columns: Real, damping: float, pace: Pace
) -> tuple[Evaluation | None, float, float]:
    """The next evaluation that is better under the same whitening and columns; the next damping; what was gained."""
    problem, expected = evaluation.problem, reduced.gap
    share = pace.share_of(reduced.step(short=True).change * reduced.length)
    while damping <= MAX_DAMPING:
        step = reduced.step(damping, short=True)
        stepped = problem.unknowns.within(evaluation.values + share * step.change)
        if problem.model.effects and is_dark(problem, stepped):  # no sensor has such a gain
            damping = max(10.0 * damping, 1e-3)
            continue
        trial = problem.evaluate(stepped)
        there = reduce(columns, trial.residual(white), problem.unknowns.parameters, trial.values)
        gained = max(reduced.chi2 - there.chi2, expected - there.gap)
        if gained >= -GAP:
            return trial, 0.0 if damping < 1e-4 else damping / 10.0, gained
        damping = max(10.0 * damping, 1e-3)
    return None, damping, 0.0


def is_dark(problem: Problem, values: Real) -> bool:
    """Whether an image would have a gain of zero: all of its light would be an offset."""
    by_name = problem.unknowns.named(values)
    return any(gain_of(image, by_name) <= 0.0 for image in problem.images)
