"""The field of a tally: which of its modes are light and which are noise.

The receiver's first light carries all the detail. Its modes fall off less regularly than those of a Lambertian point
(x K1(x), `field.mode_count`): light that leaves a clear chip along its side faces draws a cross on the receiver, so
on S_b3 the modes (0, 5) to (0, 7) are 15 to 80 times that amplitude, and six modes alone put the uniformity 0.5
points too low. Therefore more modes are taken than that rule asks for, and each is weighed by the share of light in
the power of its neighbourhood (empirical Bayes, Wiener's weights).

Light that comes back from above is smooth: mode k of it has gone the way receiver - substrate - receiver, 2kD K1(2kD)
of its mean, or misses where chips stand, (W/S)^2 of what first light may show. That is the prior of its weights.

A mode with weight w keeps w of its mean; its groups keep sqrt(w) of their spread, for its error is then that of the
noise that was kept and of the light that may have been lost together. Of a module, whose mirror images leave a mode
few neighbours, the weights themselves err: there the groups keep what Stein's estimate says (decision 68). So every
later estimate has an honest error.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from containers.ray_tracing.field import Axis, Field, ModuleField, lambert_transform, mode_count
from containers.ray_tracing.tally import FIRST, LATER, Tally
from containers.scene import Array, Scene

Real = NDArray[np.float64]

FEWEST_MODES, MORE_MODES = 10, 1.5
"""Modes of first light: at least these, and this much more than the rule for a Lambertian point."""
CAUTION = 0.3
"""Power over noise that a neighbourhood of pure noise often has; it counts as noise."""
WIDELY = 4
"""How far around a mode of a module errors are averaged: 25 modes of all where mirror images leave one in four."""


def light_of(tally: Tally, scene: Scene) -> Field:
    """The field of a tally: of a cell in relative illuminance, of a module in 1/mm^2 per flux of a nominal chip."""
    if isinstance(scene.layout, Array):
        field = unweighed(tally, scene)
        share = _share_of_first(field)
        return replace(field, coefficients=_weighed(field, share, _error_over_noise(field, share)))
    spacing, height = scene.layout.spacing_um, scene.height_um
    modes = max(FEWEST_MODES, round(MORE_MODES * mode_count(height, spacing)))
    first, later = (tally.cell_field(layer, spacing, height, modes) for layer in (FIRST, LATER))
    of_first, of_later = _share_of_first(first), _share_of_later(later, scene)
    return replace(first, coefficients=_weighed(first, of_first, of_first) + _weighed(later, of_later, of_later))


def unweighed(tally: Tally, scene: Scene) -> ModuleField:
    """The field of a module with all modes as they were counted: linear in the light, its noise that of its groups.

    Weights would depend on what they weigh, and so make an error that groups of one run share.
    """
    assert isinstance(scene.layout, Array)  # noqa: S101  the caller knows
    histories = tally.total_histories / tally.groups / float(scene.layout.power.sum())
    return ModuleField.from_bins(tally.cell_bins(), histories, tally.box.ends_um, scene.height_um)


def _weighed(field: Field, share: Real, over_noise: Real) -> Real:
    """Coefficients whose mean is weighed by the share of light, their spread by the root of its error over noise."""
    mean = field.coefficients.mean(axis=0)
    return np.asarray(mean * share + (field.coefficients - mean) * np.sqrt(over_noise))


def _share_of_first(field: Field) -> Real:
    """(function along y, along x), share of light in each mode, from the power around it."""
    mean, noise = _mean_and_noise(field)
    over_noise = _around(field, mean**2) / np.maximum(_around(field, noise), 1e-300) - 1.0
    excess = np.maximum(over_noise - CAUTION, 0.0)
    share = np.where(noise > 0.0, excess / (1.0 + excess), 0.0)
    share[0, 0] = 1.0
    return share


def _error_over_noise(field: Field, share: Real) -> Real:
    """(function along y, along x), of the modes around each one: squared error once they are weighed by a share of
    `_share_of_first`, over their noise.

    Notes
    -----
    A mode m with noise v that becomes w m errs by v (2 d(w m)/dm - 1) + (1 - w)^2 m^2 on average, whatever light
    there is: the noise that is kept, the light that is lost, and what w itself errs by (C. Stein, Ann. Stat. 9, 1135,
    1981). With power P and noise N around the mode w = e / (1 + e) and e = P / N - 1 - `CAUTION`. An average below 0
    is taken as 0, so where there is next to no light, and all modes have noise, 5 % of it are told too much.
    """
    mean, noise = _mean_and_noise(field)
    by_weight = 2.0 * mean**2 * (1.0 - share) ** 2 / np.maximum(_around(field, noise), 1e-300)
    slope = np.where(share > 0.0, share + by_weight, 0.0)
    error = np.where(noise > 0.0, noise * (2.0 * slope - 1.0) + ((1.0 - share) * mean) ** 2, 0.0)
    found = _around(field, error, WIDELY) / np.maximum(_around(field, noise, WIDELY), 1e-300)
    found[0, 0] = 1.0
    return np.maximum(found, 0.0)


def _share_of_later(field: Field, scene: Scene) -> Real:
    """(function along y, along x), share of light in each mode, from what it can be."""
    mean, noise = _mean_and_noise(field)
    k = np.sqrt(np.add.outer(field.y.wavenumber_per_um**2, field.x.wavenumber_per_um**2))
    covered = (scene.chip.width_um / scene.layout.spacing_um) ** 2
    amplitude = lambert_transform(2.0 * k * scene.distance_um) + covered * lambert_transform(k * scene.height_um)
    light = (2.0 * amplitude * mean[0, 0]) ** 2
    share = np.where(noise > 0.0, light / np.maximum(light + noise, 1e-300), 0.0)
    share[0, 0] = 1.0
    return share


def _mean_and_noise(field: Field) -> tuple[Real, Real]:
    """Mean over groups, and its variance, of each coefficient."""
    return field.coefficients.mean(axis=0), field.coefficients.var(axis=0, ddof=1) / field.groups


def _around(field: Field, power: Real, reach: int = 1) -> Real:
    """Sum of each mode and its neighbours, cosines and sines each among themselves; the mean stays out."""
    near = range(2 * reach + 1)
    others = power.copy()
    others[0, 0] = 0.0
    found = np.zeros_like(power)
    for rows in _kinds(field.y):
        for columns in _kinds(field.x):
            part = others[rows, columns]
            (height, width), padded = part.shape, np.pad(part, reach)
            found[rows, columns] = sum(padded[i : i + height, j : j + width] for i in near for j in near)
    return found


def _kinds(axis: Axis) -> tuple[slice, ...]:
    """The cosines of an axis, and its sines where it has them."""
    both = slice(0, axis.modes + 1), slice(axis.modes + 1, None)
    return both if axis.kind == "periodic" else both[:1]
