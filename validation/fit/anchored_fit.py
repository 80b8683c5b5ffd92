"""The fit of a model: by the twin first, then about Monte Carlo where that ended, and again where that moves it.

How it comes down about what it stands about is `descent`; here is what that is, and with how many histories.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from luxloop.errors import InputError
from luxloop.model import Model
from validation.fit.descent import MAX_ITERATIONS, unclipped
from validation.fit.least_squares import Parameter
from validation.fit.parameters import CurveData, Discrepancy, free_paths, unknowns_of
from validation.fit.problem import CurvePredictor, ImagePredictor, Problem, view_of
from validation.fit.result import Fit, wanted_histories
from validation.fit.start import start_values
from validation.measured import MeasuredImage
from validation.prediction import Anchored, Pose

AnchorAt = Callable[[Model], Anchored | None]

TWIN_STEPS = 10  # before there is an anchor: where a model lacks much, more go about a bent valley for nothing
MAX_ANCHORS = 3
AT_FIRST = 4  # times fewer histories, for the anchor where the twin has led: the next one is elsewhere
WORTH_MORE = 1.2  # times as many histories: for fewer no anchor is made anew
NEAR = 2.0  # errors from its anchor: nearer, the last one, of more histories, may be the next
ANCHOR_MOVE = 0.3  # of a parameter's error: further from its anchor, the anchor is renewed


def fit(
    model: Model,
    images: Sequence[MeasuredImage],
    predictor: ImagePredictor,
    *,
    free: Sequence[str] | None = None,
    anchor_at: AnchorAt | None = None,
    curves: Sequence[CurveData] = (),
    predict_curves: CurvePredictor | None = None,
    others: Sequence[Parameter] = (),
    discrepancies: Sequence[Discrepancy] = (),
    start: Mapping[str, float] | None = None,
    most_histories: int = 0,
) -> Fit:
    """The best fit of the model to images and curves.

    `free`: paths of the model that move; none: those that its [fit] tables free; (): nothing but gains, offsets,
    poses and scales, as `compare` does. `others`: parameters that only curves know (films), their values in `start`,
    where any other value to start from may stand too. `anchor_at`: gives the Monte Carlo anchor at a model; it is
    asked after the twin has been fitted, and again where the fit has moved away from it. `most_histories`: the last
    anchor is made once more with as many as bring its noise down to `WANTED_NOISE`, at most so many.

    Raises InputError where there is nothing to fit, no more than is fitted to it, or a path has no limits.
    """
    if not images and not curves:
        raise InputError("shots", 0, "at least one image or curve", "see luxloop dataset check")
    paths = free_paths(model) if free is None else tuple(free)
    unknowns = unknowns_of(model, paths, images, curves, others, discrepancies)
    values = sum(int(image.used.sum()) for image in images) + sum(curve.value.size for curve in curves)
    loose = sum(not np.isfinite(one.prior_sd) for one in unknowns.parameters)
    if values <= loose:
        mend = "measure more, or free less"
        raise InputError("shots", f"{values} values in all", f"more than the {loose} that are fitted to them", mend)
    problem = Problem(
        model, unknowns, tuple(images), predictor, tuple(curves), predict_curves, tuple(discrepancies),
        _lent(model, anchor_at, images, paths),
    )  # fmt: skip
    if model.effects and images and anchor_at is None:  # a worker refuses those that the twin cannot represent
        predictor.images(model, [view_of(image, Pose()) for image in images])
    anchored_later = anchor_at is not None and bool(images)
    most = TWIN_STEPS if anchored_later else MAX_ITERATIONS
    found = unclipped(problem, start_values(problem, start or {}), most=most)
    refuse_dark(found)
    for further in reversed(range(MAX_ANCHORS if anchored_later else 0)):
        anchor = anchor_at(found.model) if anchor_at is not None else None
        if anchor is None:
            break
        begins = bool(paths) and further == MAX_ANCHORS - 1 and anchor.model == found.model
        anchor = replace(anchor, poses=tuple(found.poses.values()))
        anchored = replace(found.problem, anchor=first_of(anchor) if begins else anchor)
        at_anchor, found = found, unclipped(anchored, found.values, found.iterations)
        if begins:
            continue
        move = moved(found, at_anchor, paths) if found.converged else np.inf
        if move < ANCHOR_MOVE:
            break
        if further == 1 and move < NEAR and _quieter_anchor(found, most_histories) is not None:  # it is made here
            break
    quieter = _quieter_anchor(found, most_histories)
    if quieter is None:
        return found
    return unclipped(replace(found.problem, anchor=quieter), found.values, found.iterations)


def refuse_dark(found: Fit) -> None:
    """InputError for the image that is fitted best by no light at all."""
    for image in found.problem.images:
        if found.gains[image.shot.id] <= 0.0:
            mend = "it does not look like its sample: another image, inverted, dark and image exchanged?"
            raise InputError(f"{image.shot.file}: gain", 0.0, "above 0", mend)


def first_of(anchor: Anchored) -> Anchored:
    """With fewer histories, where the twin has led: by what it errs a fit moves by more than their noise moves it."""
    return replace(anchor, histories=-(-anchor.histories // AT_FIRST))


def _lent(
    model: Model, anchor_at: AnchorAt | None, images: Sequence[MeasuredImage], paths: Sequence[str]
) -> Anchored | None:
    """What a fit begins about: the start's chip exits stand for all, so that chi2 is smooth.

    Where nothing of the model moves, the anchor itself will do.
    """
    if not images or not (paths or anchor_at):
        return None
    return Anchored(model, 0) if paths or anchor_at is None else anchor_at(model)


def _quieter_anchor(found: Fit, most_histories: int) -> Anchored | None:
    """An anchor where the fit is, of as many histories of each sample as its noise asks for; None: it has enough."""
    anchor = found.problem.anchor
    if anchor is None or not anchor.histories:
        return None
    asked = wanted_histories(found.problem, found.whitening)
    now = {sample: anchor.histories_of(sample) for sample in asked}
    wanted = {sample: max(had, min(asked[sample], most_histories)) for sample, had in now.items()}
    if all(wanted[sample] < WORTH_MORE * had for sample, had in now.items()):
        return None
    most = max(wanted.values())
    return replace(
        anchor, model=found.model, poses=tuple(found.poses.values()), histories=most,
        enough=tuple((sample, histories) for sample, histories in wanted.items() if histories < most),
    )  # fmt: skip


def moved(found: Fit, before: Fit, paths: Sequence[str]) -> float:
    """The largest move of a model parameter, in its own errors."""
    moves = [
        abs(found.value(path) - before.value(path)) / found.error(path) for path in paths if found.error(path) > 0.0
    ]
    return max(moves, default=0.0)
