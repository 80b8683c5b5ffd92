"""What is left of spectra and far fields: by wavelength, by angle, and by optical thickness.

    contrast = sum of whitened residuals over a class of rows,   z = contrast / what the fit leaves of noise there
    power at an optical thickness L = n d cos(angle inside):  of the residual in cos and sin of 4 pi L / wavelength,
                                      mean of the two squares in standard deviations: 1 where only noise is left

A layer that is missing, or too thick, leaves fringes: equally spaced in 1 / wavelength, so they are one peak at the
layer's L. With dispersion n is the group index n - wavelength dn/dwavelength, and its change widens the peak. Far
fields have no such transform.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr, ndtri_exp

from validation.contrasts import Region
from validation.fit import CurveData, Fit
from validation.measured import MeasuredFarField, MeasuredSpectrum

Real = NDArray[np.float64]
Words = NDArray[np.str_]
Plain = dict[str, Any]

NORMAL_95 = 1.959964
POWER_95 = 2.995732
"""Of the mean of two squares of unit normal numbers, 95 % are below."""
BANDS, POINTS = 12, 60
"""Classes of wavelength or theta: as regions, and as points of a profile."""
LEAST_ROWS = 8
"""Of a line that is transformed."""
MOST_THICKNESSES = 400
VANISHED = 1e-6
"""Share of a contrast's variance below which the fit has taken it all."""


@dataclass(frozen=True, eq=False)
class Left:
    """The rows of one curve: two coordinates, the whitened residual, and what the fit did to noise there."""

    curve: CurveData
    x: Real
    """Wavelength in nm, or theta in deg."""
    line: Words
    """What rows with the same other coordinates are called: the angle of incidence and polarisation, or phi."""
    names: tuple[str, str]
    residual: Real
    sigma: Real
    data: Real
    """(row, parameter): the fit's basis in these rows."""

    def covariance(self, weights: Real) -> Real:
        """(..., contrast, contrast) of weights (..., contrast, row) on noise after the fit."""
        taken = weights @ self.data
        return np.asarray(weights @ np.swapaxes(weights, -1, -2) - taken @ np.swapaxes(taken, -1, -2))

    @property
    def unit(self) -> str:
        """Of x."""
        return "nm" if self.names[0] == "wavelength" else "deg"


def left_of(fit: Fit) -> list[Left]:
    """The curves of a fit."""
    start, found = fit.whitening.count, []
    for curve, sigma in zip(fit.problem.curves, fit.whitening.curve_sigma, strict=True):
        rows = slice(start, start + len(curve.value))
        start = rows.stop
        x, line, names = _coordinates(curve)
        found.append(Left(curve, x, line, names, fit.residual[rows], sigma, fit.basis.data[rows]))
    return found


def curve_regions(fit: Fit, scale: float = 1.0) -> list[Region]:
    """Of each curve and family the region that is least like noise; `scale`: the variance scale of the data."""
    return [region for left in left_of(fit) for region in _regions(left, scale)]


def curve_profiles(fit: Fit) -> list[Plain]:
    """Mean of measured minus model against wavelength or theta, line by line, and against the angle."""
    found: list[Plain] = []
    for left in left_of(fit):
        bands = _bands(left.x, POINTS)
        for line in dict.fromkeys(left.line.tolist()):
            here = left.line == line
            found.append(_profile(left, left.names[0], left.unit, here, bands, line))
        angle = _angle(left)
        if len(np.unique(angle)) > 1:
            everywhere = np.ones(len(left.x), bool)
            found.append(_profile(left, left.names[1], "deg", everywhere, angle, ""))
    return found


def fourier(fit: Fit, scale: float = 1.0) -> list[Plain]:
    """The power of each spectrum's residual against optical thickness, line by line, and its largest peak."""
    found = []
    for left, line, thickness_um, power in _powers(fit, scale):
        most = int(np.argmax(power))
        found.append({
            "shot": left.curve.id, "line": line, "unit": "um", "band": POWER_95,
            "optical_thickness_um": _plain(thickness_um), "power": _plain(power),
            "peak": {
                "optical_thickness_um": float(f"{thickness_um[most]:.5g}"), "power": float(f"{power[most]:.5g}"),
                "log_chance": _log_chance(float(power[most]), len(power)),
            },
        })  # fmt: skip
    return found


def _powers(fit: Fit, scale: float) -> Iterator[tuple[Left, str, Real, Real]]:
    for left in left_of(fit):
        for line in dict.fromkeys(left.line.tolist()) if left.names[0] == "wavelength" else ():
            here = left.line == line
            thickness_um = _thicknesses_um(left.x[here])
            if len(thickness_um):
                yield left, line, thickness_um, _power(left, here, thickness_um) / scale


def _thicknesses_um(wavelength_nm: Real) -> Real:
    """Half a resolved step apart, as far as the spacing of the wavelengths tells fringes; none of too few rows."""
    per_um = np.unique(1e3 / wavelength_nm)
    if len(per_um) < LEAST_ROWS:
        return np.zeros(0)
    step_um = 1.0 / (2.0 * (per_um[-1] - per_um[0]))
    finest_um = 1.0 / (4.0 * float(np.median(np.diff(per_um))))
    count = min(MOST_THICKNESSES, int(2.0 * finest_um / step_um))
    return np.asarray(0.5 * step_um * np.arange(2, max(3, count + 1)))


def _power(left: Left, here: NDArray[np.bool_], thickness_um: Real) -> Real:
    """Mean of the two squares, in standard deviations, at each optical thickness."""
    phase = 4.0 * np.pi * thickness_um[:, None] * 1e3 / left.x
    weights = np.stack([np.cos(phase), np.sin(phase)], axis=1) * here
    size = np.maximum(np.linalg.norm(weights, axis=-1, keepdims=True), 1e-300)
    weights = weights / size
    value = weights @ left.residual
    covariance = left.covariance(weights) + VANISHED * np.eye(2)
    whole = np.linalg.solve(covariance, value[..., None])[..., 0]
    return np.asarray((value * whole).sum(axis=-1) / 2.0)


def _regions(left: Left, scale: float) -> Iterator[Region]:
    bands = _bands(left.x, BANDS)
    across, along = left.names
    yield from _worst(left, across, bands, scale)
    if len(np.unique(left.line)) > 1:
        lines = np.unique(left.line, return_inverse=True)[1]
        yield from _worst(left, along, lines, scale)
        yield from _worst(left, f"{across} and {along}", bands * (lines.max() + 1) + lines, scale)
    if across == "wavelength":
        yield from _thickest(left, scale)


def _worst(left: Left, family: str, labels: NDArray[np.intp], scale: float) -> Iterator[Region]:
    """The class of rows whose sum is largest in its own standard deviation."""
    names = np.unique(labels)
    weights = (labels == names[:, None]).astype(float)
    counts = weights.sum(axis=1)
    variance = np.diagonal(left.covariance(weights))
    kept = variance > VANISHED * counts
    if not kept.any():
        return
    z = np.where(kept, weights @ left.residual / np.sqrt(np.where(kept, variance, 1.0) * scale), 0.0)
    worst = int(np.argmax(np.abs(z)))
    chance = min(0.0, float(np.log(2.0 * kept.sum()) + log_ndtr(-abs(z[worst]))))
    words = _words(left, labels == names[worst], family)
    yield Region(family, left.curve.id, words, float(z[worst]), chance)


def _thickest(left: Left, scale: float) -> Iterator[Region]:
    """The strongest fringes of all lines."""
    best: tuple[float, float, str, int] | None = None
    for line in dict.fromkeys(left.line.tolist()):
        here = left.line == line
        thickness_um = _thicknesses_um(left.x[here])
        if len(thickness_um):
            power = _power(left, here, thickness_um) / scale
            most = int(np.argmax(power))
            looks = len(power) + (best[3] if best else 0)
            top = max((best or (0.0, 0.0, "", 0))[:3], (float(power[most]), float(thickness_um[most]), line))
            best = (*top, looks)
    if best is not None:
        power_, at_um, line, looks = best
        words = f"optical thickness {at_um:.3g} um" + (f", {line}" if len(set(left.line)) > 1 else "")
        z = float(-ndtri_exp(min(-power_, -1e-9)))
        yield Region("optical thickness", left.curve.id, words, z, _log_chance(power_, looks))


def _log_chance(power: float, looks: int) -> float:
    """Logarithm of the chance that noise is as strong at one of the thicknesses; half of them are independent."""
    return min(0.0, float(np.log(max(1.0, looks / 2.0)) - power))


def _words(left: Left, here: NDArray[np.bool_], family: str) -> str:
    """A class of rows for people."""
    low, high = left.x[here].min(), left.x[here].max()
    span = f"{low:.4g}-{high:.4g} {left.unit}" if high > low else f"{low:.4g} {left.unit}"
    span = f"theta {span}" if left.names[0] == "theta" else span
    lines = list(dict.fromkeys(left.line[here].tolist()))
    if family == left.names[0]:
        return span
    return lines[0] if family == left.names[1] else f"{span}, {lines[0]}"


def _profile(left: Left, against: str, unit: str, here: NDArray[np.bool_], labels: NDArray[Any], line: str) -> Plain:
    """Means over classes of rows, weighted by their errors; the band is that of noise alone."""
    factor, value_unit = _told_in(left)
    axis = left.x if against == left.names[0] else _angle(left)
    x, mean, band = [], [], []
    for name in np.unique(labels[here]):
        rows = here & (labels == name)
        weight = 1.0 / left.sigma[rows] ** 2
        x.append(float(axis[rows].mean()))
        mean.append(factor * float((weight * left.residual[rows] * left.sigma[rows]).sum() / weight.sum()))
        band.append(factor * NORMAL_95 / float(np.sqrt(weight.sum())))
    return {
        "against": against, "unit": unit, "shot": left.curve.id, "dbr_pairs": None, "line": line,
        "x": _plain(np.array(x)), "difference": _plain(np.array(mean)), "band": _plain(np.array(band)),
        "value_unit": value_unit,
    }  # fmt: skip


def _told_in(left: Left) -> tuple[float, str]:
    """Factor and unit of a difference: R and T in points of a percent, far fields in percent of their peak."""
    if left.curve.is_angle:
        return 1.0, "deg"
    if left.curve.free_scale:
        return 100.0 / max(float(np.abs(left.curve.value).max()), 1e-300), "% of the peak"
    return 100.0, "percentage points"


def _coordinates(curve: CurveData) -> tuple[Real, Words, tuple[str, str]]:
    source = curve.source
    if isinstance(source, MeasuredSpectrum):
        table = source.table
        several = len(set(table.polarisation)) > 1
        lines = [
            f"{aoi:g} deg" + (f" {one}" if several else "")
            for aoi, one in zip(table.aoi_deg, table.polarisation, strict=True)
        ]
        return table.wavelength_nm, np.array(lines), ("wavelength", "angle of incidence")
    if isinstance(source, MeasuredFarField):
        lines = [f"phi {phi:g} deg" for phi in source.table.phi_deg]
        return source.table.theta_deg, np.array(lines), ("theta", "phi")
    return curve.axis, np.array(["" for _ in curve.axis]), (f"axis in {curve.axis_unit}", "line")


def _angle(left: Left) -> Real:
    """The other coordinate as a number: angle of incidence or phi."""
    table = getattr(left.curve.source, "table", None)
    return np.asarray(getattr(table, "phi_deg" if left.names[0] == "theta" else "aoi_deg", np.zeros(len(left.x))))


def _bands(x: Real, most: int) -> NDArray[np.intp]:
    """Numbers of at most so many classes of one width; each value its own where there are few."""
    values = np.unique(x)
    if len(values) <= most:
        return np.asarray(np.searchsorted(values, x))
    width = (values[-1] - values[0]) / most
    return np.asarray(np.minimum(((x - values[0]) / width).astype(np.intp), most - 1))


def _plain(values: Real) -> list[float]:
    return [float(f"{value:.6g}") for value in values]
