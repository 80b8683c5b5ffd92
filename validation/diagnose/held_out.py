"""The error in data that a fit has not seen: all shots of one sample are left out in turn, never random pixels.

    fold     the model's parameters from the other samples, on the linear model at the fit
    there    gain, offset, place and turn of the left-out images are fitted in them, and what only their sample has,
             held by their priors
    error    rms of what is left, and the mean logarithm of the density with which the fold predicts a pixel

Pixels of one image say the same twice, so a random split "improves" with every parameter. Noise common to several
images (a fixed pattern) counts as each image's own here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from luxloop.effect import EffectSpec, Scope
from validation.fit import Fit
from validation.fit.whitening import Whitening
from validation.measured import MeasuredSpectrum

Real = NDArray[np.float64]
Rows = NDArray[np.intp]

BLOCK_PX = 16


@dataclass(frozen=True, eq=False)
class HeldOut:
    """What a model leaves in the data that it was not fitted to, fold after fold."""

    residual: Real
    """(row,), in standard deviations of each row's own noise."""
    rows: Rows
    """Their numbers among all rows."""
    rms_percent: float
    """Of the images, over their mean signal (`levels_of`), all folds together; without images of the curves."""
    curves_percent: float | None = None
    """Of curves beside images."""

    def percent_of(self, effect: EffectSpec) -> float:
        """Of what an effect acts on: of curves beside images, where that is films alone."""
        of_films = effect.acts_on == ("films",)
        return self.curves_percent if of_films and self.curves_percent is not None else self.rms_percent

    @property
    def density(self) -> float:
        """Mean log predictive density per value, less that of perfect predictions: 0 is best, on average -1/2."""
        return -0.5 * float(np.mean(self.residual**2))


@dataclass(frozen=True)
class Change:
    """How the mean log predictive density per value changes from one model to another."""

    value: float
    error: float

    @property
    def falls(self) -> bool:
        """Whether the error falls, by more than twice its own error."""
        return self.value > 2.0 * self.error


def held_out(fit: Fit, folds: Sequence[tuple[str, Rows]]) -> HeldOut:
    """The errors of a fit in each fold (name, rows left out). ValueError without folds."""
    if not folds:
        raise ValueError("held-out error without folds")
    residual, columns, noise = _plain(fit)
    left, order = [], []
    shared = np.array([not _is_nuisance(name, fit) for name in fit.names], bool)
    for _, rows in folds:
        kept = np.setdiff1d(np.arange(len(residual)), rows)
        change = _solved(fit, columns[:, kept], residual[kept], fit.active)
        known = shared & np.any(columns[:, kept] != 0.0, axis=1)
        there = residual[rows] - (change * known) @ columns[:, rows]
        left.append(there - _solved(fit, columns[:, rows], there, fit.active & ~known) @ columns[:, rows])
        order.append(rows)
    rows, after = np.concatenate(order), np.concatenate(left)
    squares, level, images = (after * noise[rows]) ** 2, levels_of(fit)[rows], rows < fit.whitening.count
    percents = [percent(squares[part], level[part]) for part in (images, ~images) if part.any()]
    return HeldOut(after, rows, *percents)


def percent(squares: Real, level: Real) -> float:
    """The root mean square in percent of levels (row,), from squares (row,) of what is left or of its noise.

    Where all rows have one level it is divided by last, as in records of old, which are compared to the last bit.
    """
    if np.all(level == level[0]):
        return 100.0 * float(np.sqrt(np.mean(squares))) / float(level[0])
    return 100.0 * float(np.sqrt(np.mean(squares / level**2)))


def levels_of(fit: Fit) -> Real:
    """What the error of each row (row,) is told in percent of.

    For a pixel the mean of all used ones in DN; for a value of a curve the mean size of all that share its unit:
    R and T, psi and delta; a goniometer's scale is its own. 1 where all of them are 0, as of an opaque film's T.
    """
    images, curves = zip(fit.problem.images, fit.signals_dn, strict=True), fit.problem.curves
    parts = [("DN", dn[image.used]) for image, dn in images]
    units = ["deg" if one.is_angle else f"of {one.id}" if one.free_scale else "1" for one in curves]
    parts += [(unit, np.abs(one.value)) for unit, one in zip(units, curves, strict=True)]
    all_of = {unit: np.concatenate([part for own, part in parts if own == unit]) for unit in dict(parts)}
    level = {unit: np.mean(values) or 1.0 for unit, values in all_of.items()}
    return np.concatenate([np.full(len(part), level[unit]) for unit, part in parts])


def change(before: HeldOut, after: HeldOut) -> Change:
    """From one model to another on the same folds.

    Where the second is right, its residual is noise y and the first's y + d: the sum of (d y + d^2 / 2) has the
    standard deviation |d|. Of models about anchors of their own the noise of two runs of Monte Carlo is
    in d, and so in this: where it is s of a row's, the sum's deviation is larger by some s^2 / 4 of itself. About the
    anchor of the other one a model would fit worse than it does: by 80 of chi2, 12 errors away (decision 41).
    """
    if not np.array_equal(before.rows, after.rows):
        raise ValueError("two models are compared on the same folds")
    count = len(after.residual)
    difference = before.residual - after.residual
    return Change(after.density - before.density, float(np.linalg.norm(difference)) / count)


def folds_by_sample(fit: Fit) -> list[tuple[str, Rows]]:
    """All rows of each sample or film; fewer than two samples: no folds."""
    owners = _owners(fit)
    names = list(dict.fromkeys(owners))
    rows = np.array([names.index(owner) for owner in owners])
    return [(name, np.flatnonzero(rows == k)) for k, name in enumerate(names)] if len(names) > 1 else []


def folds_of(fit: Fit, scope: Scope = "global") -> list[tuple[str, Rows]]:
    """What is left out in turn: samples; for an effect that each sample has its own of, parts of every sample.

    Spectra of one film are parted by their angles, images in halves. Without folds: images of one sample else.
    """
    if scope != "per_sample" and (folds := folds_by_sample(fit)):
        return folds
    if fit.problem.images or not all(isinstance(one.source, MeasuredSpectrum) for one in fit.problem.curves):
        return folds_by_blocks(fit) if scope == "per_sample" else []
    return folds_by_angle(fit) or folds_by_blocks(fit)


def folds_by_angle(fit: Fit) -> list[tuple[str, Rows]]:
    """All rows of each angle of incidence, psi and delta together; a single angle: no folds."""
    sources = [curve.source for curve in fit.problem.curves if isinstance(curve.source, MeasuredSpectrum)]
    angles = np.concatenate([one.table.aoi_deg for one in sources])
    several = np.unique(angles)
    return [(f"{angle:g} deg", np.flatnonzero(angles == angle)) for angle in several] if len(several) > 1 else []


def folds_by_blocks(fit: Fit) -> list[tuple[str, Rows]]:
    """Two halves, blocks of 16 pixels, or of 16 values of a curve, in turn; a short curve has two blocks."""
    halves = []
    for image in fit.problem.images:
        row, column = np.nonzero(image.used)
        halves.append((row // BLOCK_PX + column // BLOCK_PX) % 2)
    counts = [len(curve.value) for curve in fit.problem.curves]
    halves += [np.arange(count) // min(BLOCK_PX, -(-count // 2)) % 2 for count in counts]
    side = np.concatenate(halves)
    return [("even blocks", np.flatnonzero(side == 0)), ("odd blocks", np.flatnonzero(side == 1))]


def _owners(fit: Fit) -> list[str]:
    owners: list[str] = []
    for image in fit.problem.images:
        owners += [image.sample.id] * int(image.used.sum())
    for curve in fit.problem.curves:
        source = getattr(curve.source, "film", None) or getattr(curve.source, "sample", None)
        owners += [getattr(source, "id", curve.id)] * len(curve.value)
    return owners


def _is_nuisance(name: str, fit: Fit) -> bool:
    """Whether a parameter is one of a single shot."""
    shots = [image.shot.id for image in fit.problem.images] + [curve.id for curve in fit.problem.curves]
    return any(name.startswith(f"{shot}.") for shot in shots)


def _plain(fit: Fit) -> tuple[Real, Real, Real]:
    """Residual and columns by each row's own noise alone; that noise in DN (or a curve's unit).

    The fit's own rows cannot be used: whitening mixes the images of one camera.
    """
    images = fit.problem.images
    weights = []
    for image, signal in zip(images, fit.signals_dn, strict=True):
        variance = image.noise_dn2(signal)
        weights.append(np.where(image.used, 1.0 / np.sqrt(np.where(image.used, variance, 1.0)), 0.0))
    white = Whitening(
        tuple(image.used for image in images), tuple(weights), (), curve_sigma=fit.whitening.curve_sigma
    )
    at = fit.problem.evaluate(fit.values)
    residual, columns = at.residual(white), at.columns(white)
    sigma = [1.0 / w[image.used] for w, image in zip(weights, images, strict=True)]
    noise = np.concatenate([*sigma, *fit.whitening.curve_sigma])
    return residual, columns, noise


def _solved(fit: Fit, columns: Real, residual: Real, active: NDArray[np.bool_]) -> Real:
    """The change of the active parameters that the rows ask for, priors held."""
    change = np.zeros(len(columns))
    length = np.sqrt(np.sum(columns**2, axis=1))
    seen = active & (length > 0.0)
    if not seen.any():
        return change
    weight = 1.0 / np.array([parameter.prior_sd for parameter in fit.problem.unknowns.parameters])
    pull = np.array([p.prior_mean for p in fit.problem.unknowns.parameters]) - fit.values
    with_prior = seen & (weight > 0.0)
    priors = np.diag(weight / np.where(seen, length, 1.0))[with_prior][:, seen]
    rows = np.vstack([(columns[seen] / length[seen, None]).T, priors])
    target = np.concatenate([residual, (pull * weight)[with_prior]])
    change[seen] = np.linalg.lstsq(rows, target, rcond=1e-10)[0] / length[seen]
    return change
