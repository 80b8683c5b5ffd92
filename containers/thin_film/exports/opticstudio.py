"""The OpticStudio tabular BSDF (`*.bsdf`): scattered light about the specular direction.

    Source  Measured                      Symmetry  PlaneSymmetrical       SpectralContent  Monochrome
    ScatterType  BRDF | BTDF
    SampleRotation, AngleOfIncidence, ScatterAzimuth, ScatterRadial: each a count, then a line of values
    Monochrome, DataBegin, then for each angle "TIS x" and a line of radial values for each azimuth; DataEnd

Values in 1/sr, angles in degrees. "AngleOfIncidence" is the angle of the SPECULAR ray, reflected or transmitted (the
format's own description calls the name a misnomer), so of a refracting face it is the angle after refraction. Radial
is the angle from the specular ray, azimuth 0 points from it to the normal of the sample, 180 away from it.
Plane-symmetrical data hold azimuths 0 to 180. The layout follows the maker's public article. Not verified: how the
program interpolates between radials and angles; whether it takes the strength from TIS or from the surface's coating.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from containers.bsdf import Bsdf, SpecularTable, Tabulated
from containers.checked import reals
from containers.thin_film.angles import FIFTHS, NARROWEST_RAD, linear_nodes
from containers.thin_film.exports.exported import Exported, checked_text, lost_words, numbers
from containers.thin_film.table import Real
from luxloop.errors import InputError

ScatterType = Literal["BRDF", "BTDF"]
AXES = ("SampleRotation", "AngleOfIncidence", "ScatterAzimuth", "ScatterRadial")
RADIAL_DEG = (*range(7), 8, 10, 12, 15, 18, 22, 26, *range(30, 61, 5), 70, 80, 90, 105, 120, 140, 180)
AZIMUTH_DEG = tuple(range(0, 181, 10))
TOLERANCE_RATIO = 5e-3
"""Largest error of the power between two angles of a file, where the program interpolates linearly."""
MOST_ANGLES = 400
_FINE_RADIAL, _FINE_AZIMUTH = 24, 4
_START_DEG = 0.1
NO_POWER = 1e-12
_CONE_RULE = np.polynomial.legendre.leggauss(64)


@dataclass(frozen=True)
class ScatterFile:
    """What such a file holds, for one sample rotation."""

    scatter_type: str
    specular_deg: Real
    """(specular,), the file's AngleOfIncidence."""
    azimuth_deg: Real
    radial_deg: Real
    tis: Real
    """(specular,), total integrated scatter."""
    values: Real
    """bsdf in 1/sr, (specular, azimuth, radial)."""

    def integrals(self) -> Real:
        """Integral of the bsdf x cos over the half space for each specular angle, linear between the nodes."""
        angles = zip(self.values, np.radians(self.specular_deg), strict=True)
        return np.array([_integral(values, angle, self.radial_deg, self.azimuth_deg) for values, angle in angles])


def opticstudio(
    bsdf: Bsdf,
    scatter_type: ScatterType,
    specular_deg: ArrayLike | None = None,
    azimuth_deg: ArrayLike = AZIMUTH_DEG,
    radial_deg: ArrayLike = RADIAL_DEG,
    also_lost: Mapping[str, float] | None = None,
) -> Exported:
    """The tabular BSDF text of one surface, reflected (BRDF) or transmitted (BTDF) light.

    Parameters
    ----------
    specular_deg : (specular,), 0 to 90, angles of the specular ray; by default those of `own_angles_deg`.
    azimuth_deg, radial_deg : (azimuth,) from 0 to 180, (radial,) from 0 to at most 180.
    also_lost : what was lost before, for instance `surface.averaging_loss` of a film table.

    Notes
    -----
    A delta part becomes a cone about the specular ray that falls linearly to 0 at the first radial step and holds the
    same power. TIS is the exact power. `lost`: "delta_spread_deg", that step, where there is a delta part;
    "delta_power_ratio", the largest power so spread; "grid_ratio", the largest error of the file's own integral at
    its angles, of spread light before it was scaled to the exact power; "between_angles_ratio", the largest error of
    its integral between them (and beyond the first and last, where those are held), the values being interpolated
    linearly in the specular angle.
    """
    azimuth, radial = reals("azimuth_deg", azimuth_deg), reals("radial_deg", radial_deg)
    _check_axis("azimuth_deg", azimuth, 180.0, whole=True)
    _check_axis("radial_deg", radial, 180.0, whole=False)
    surface = _Surface(bsdf, scatter_type, azimuth, radial)
    specular = surface.own_angles_deg() if specular_deg is None else reals("specular_deg", specular_deg)
    _check_axis("specular_deg", specular, 90.0, whole=False)
    angles = np.radians(specular)
    delta, (spread, spread_power, off) = surface.delta(angles), surface.spread(angles)
    values = spread.copy()
    values[:, :, 0] += (delta / surface.cone(angles))[:, None]
    file = ScatterFile(scatter_type, specular, azimuth, radial, delta + spread_power, values)
    lost = dict(also_lost or {})
    if delta.any():
        lost |= {"delta_spread_deg": float(radial[1]), "delta_power_ratio": float(delta.max())}
    lost["grid_ratio"] = float((np.abs(file.integrals() - file.tis) + off).max())
    lost["between_angles_ratio"] = surface.between(angles, spread)
    return Exported(_text(file, lost_words(lost)), lost)


@dataclass(frozen=True)
class _Surface:
    """One kind of light of a surface, by the angle of its specular ray (rad)."""

    bsdf: Bsdf
    scatter_type: ScatterType
    azimuth_deg: Real
    radial_deg: Real

    @property
    def steepest(self) -> float:
        """The largest angle that a specular ray can have."""
        refracted = self.scatter_type == "BTDF" and self.bsdf.index_ratio < 1.0
        return float(np.arcsin(self.bsdf.index_ratio)) if refracted else np.pi / 2

    def incidence(self, specular: Real) -> Real:
        """The angles of incidence (rad) that belong to specular rays."""
        if self.scatter_type == "BRDF":
            return specular
        if np.any(specular > self.steepest * (1.0 + 1e-12)):
            allowed = f"transmitted rays, up to {np.degrees(self.steepest):.4g} deg"
            raise InputError("specular_deg", float(np.degrees(specular.max())), allowed, "leave them out")
        return np.asarray(np.arcsin(np.minimum(np.sin(specular) / self.bsdf.index_ratio, 1.0)))

    def delta(self, specular: Real) -> Real:
        """Power in the specular ray itself."""
        deltas = self.bsdf.deltas(self.incidence(specular))
        return deltas.mirror if self.scatter_type == "BRDF" else deltas.refracted

    def cone(self, specular: Real) -> Real:
        """Projected solid angle of a cone of height 1 that falls linearly to 0 at the first radial step.

        As far as it is above the surface: a + b cos(azimuth) is the cosine to the normal on a ring about the ray.
        """
        step = np.radians(self.radial_deg[1])
        radial, weight = step / 2.0 * (_CONE_RULE[0] + 1.0), step / 2.0 * _CONE_RULE[1]
        a = np.cos(specular)[:, None] * np.cos(radial)
        b = np.maximum(np.sin(specular)[:, None] * np.sin(radial), 1e-300)
        end = np.arccos(np.clip(-a / b, -1.0, 1.0))
        rings = 2.0 * (a * end + b * np.sin(end)) * np.sin(radial) * (1.0 - radial / step)
        return np.asarray(rings @ weight)

    def spread(self, specular: Real) -> tuple[Real, Real, Real]:
        """Bsdf (1/sr) without the delta part on the file's directions, (specular, azimuth, radial), and its powers.

        Towards the horizon, where a lobe's bsdf has no bound, cosines count as that of half the first radial step at
        least; then the values are scaled so that the file's own integral is the exact power. Returned are the values,
        that power (specular,), and by how much the integral was off before.
        """
        lowest = np.sin(np.radians(self.radial_deg[1]) / 2.0)
        values = np.zeros((specular.size, self.azimuth_deg.size, self.radial_deg.size))
        power, off = np.zeros(specular.size), np.zeros(specular.size)
        for k, (theta_in, angle) in enumerate(zip(self.incidence(specular), specular, strict=True)):
            power[k] = self._spread_power(float(theta_in), angle)
            if power[k] > 0.0:
                w = _directions(angle, self.radial_deg, self.azimuth_deg, self._side)
                values[k] = self._intensity(theta_in, w) / np.maximum(np.abs(w[..., 2]), lowest)
                found = _integral(values[k], angle, self.radial_deg, self.azimuth_deg)
                off[k] = abs(found - power[k])
                values[k] *= power[k] / found if found > 0.0 else 1.0
        return values, power, off

    def _spread_power(self, theta_in: float, specular: float) -> float:
        """Power without the delta part, by a finer quadrature."""
        if float(self.bsdf.albedo(theta_in) - np.add(*self.bsdf.deltas(theta_in))) < NO_POWER:
            return 0.0
        radial_deg, azimuth_deg = np.linspace(0.0, self.radial_deg[-1], 1081), np.linspace(0.0, 180.0, 121)
        intensity = self._intensity(theta_in, _directions(specular, radial_deg, azimuth_deg, self._side))
        radial = np.radians(radial_deg)
        rings = (intensity * np.sin(radial)) @ _trapezoid(radial)
        return float(2.0 * rings @ _trapezoid(np.radians(azimuth_deg)))

    def _intensity(self, theta_in: float, direction: Real) -> Real:
        """Power per solid angle (1/sr), 0 for directions on the other side of the surface."""
        return np.asarray(self.bsdf.intensity(theta_in, direction) * (direction[..., 2] * self._side > 0.0))

    @property
    def _side(self) -> float:
        return 1.0 if self.scatter_type == "BRDF" else -1.0

    def own_angles_deg(self) -> Real:
        """Angles between which powers, and their values in 1/sr, are linear to `TOLERANCE_RATIO`."""

        def powers(specular: Real) -> Real:
            """Delta and spread power, as they are and over the cone, by which values in 1/sr go."""
            theta_in = self.incidence(specular)
            rest = self.bsdf.albedo(theta_in) - np.add(*self.bsdf.deltas(theta_in))
            both = np.stack([self.delta(specular), rest])
            return np.concatenate([both, both / self.cone(specular)])

        def weight(specular: Real) -> Real:
            cone = self.cone(specular)
            return np.stack([np.ones_like(cone), np.ones_like(cone), cone, cone])

        even = np.linspace(0.0, self.steepest, int(np.degrees(self.steepest) / _START_DEG) + 2)
        own = self.bsdf.theta_in_rad if isinstance(self.bsdf, SpecularTable | Tabulated) else np.empty(0)
        sines = np.append(np.sin(own), min(1.0, 1.0 / self.bsdf.index_ratio))  # the critical angle with them
        sines = sines if self.scatter_type == "BRDF" else sines * self.bsdf.index_ratio
        start = np.unique(np.concatenate([even, np.arcsin(sines[sines <= np.sin(self.steepest)])]))
        start = start[np.append(np.diff(start) > NARROWEST_RAD, True)]
        return np.degrees(linear_nodes(powers, start, TOLERANCE_RATIO, MOST_ANGLES, weight))

    def between(self, specular: Real, spread: Real) -> float:
        """Largest error in power between the angles, and beyond them; errors of delta and spread light added."""
        steps = np.diff(specular)
        wide = steps > 2.0 * NARROWEST_RAD  # a jump between two angles that are next to each other is carried
        ends = [np.linspace(a, b, 21) for a, b in ((0.0, specular[0]), (specular[-1], self.steepest)) if b > a]
        check = np.concatenate([(specular[:-1, None] + steps[:, None] * FIFTHS)[wide].ravel(), *ends])
        held = np.interp(check, specular, self.delta(specular) / self.cone(specular)) * self.cone(check)
        of_delta = float(np.abs(held - self.delta(check)).max(initial=0.0))
        if not spread.any():
            return of_delta
        middle = np.concatenate([specular[:-1][wide] + steps[wide] / 2.0, *ends])
        place = np.interp(middle, specular, np.arange(specular.size))
        low = np.minimum(place.astype(int), specular.size - 2)
        share = (place - low)[:, None, None]
        off = spread[low] * (1.0 - share) + spread[low + 1] * share - self.spread(middle)[0]
        axes = self.radial_deg, self.azimuth_deg
        return of_delta + max(abs(_integral(v, angle, *axes)) for v, angle in zip(off, middle, strict=True))


def read_opticstudio(text: str) -> ScatterFile:
    """What such a text holds; InputError naming the line where it is not one, or has several sample rotations."""
    lines = [line for line in checked_text("bsdf file", text).splitlines() if line.strip() and line[0] != "#"]
    heads = dict(line.split(None, 1) for line in lines[:11] if len(line.split(None, 1)) == 2)
    axes = []
    for number, name in enumerate(AXES):
        at = 4 + 2 * number
        if len(lines) < 14 or lines[at].split()[0] != name:
            raise InputError("bsdf file", lines[at] if at < len(lines) else "the end", f"a line {name}")
        count = int(numbers(name, lines[at].split()[1:], 1)[0])
        axes.append(np.array(numbers(name, lines[at + 1].split(), count)))
    rotation, specular, azimuth, radial = axes
    want = 14 + rotation.size * specular.size * (1 + azimuth.size) + 1
    if rotation.size != 1 or len(lines) != want or lines[13] != "DataBegin" or lines[-1] != "DataEnd":
        allowed = f"{want} lines from Source to DataEnd, one SampleRotation"
        raise InputError("bsdf file", f"{len(lines)} lines", allowed, "it was cut or edited")
    tis, values = np.empty(specular.size), np.empty((specular.size, azimuth.size, radial.size))
    for k in range(specular.size):
        block = lines[14 + k * (1 + azimuth.size) :][: 1 + azimuth.size]
        tis[k] = numbers("TIS", block[0].split()[1:], 1)[0]
        values[k] = [numbers(f"angle {k}", line.split(), radial.size) for line in block[1:]]
    return ScatterFile(heads.get("ScatterType", "").strip(), specular, azimuth, radial, tis, values)


def _text(file: ScatterFile, comment: str) -> str:
    rows = [f"# luxloop; {comment}", "Source  Measured", "Symmetry  PlaneSymmetrical", "SpectralContent  Monochrome"]
    rows.append(f"ScatterType  {file.scatter_type}")
    for name, axis in zip(AXES, (np.zeros(1), file.specular_deg, file.azimuth_deg, file.radial_deg), strict=True):
        rows += [f"{name}  {axis.size}", "\t".join(f"{x:.10g}" for x in axis)]
    rows += ["", "Monochrome", "DataBegin"]
    for tis, block in zip(file.tis, file.values, strict=True):
        rows.append(f"TIS {tis:.9g}")
        rows += ["\t".join(f"{x:.8e}" for x in line) for line in block]
    return "\n".join([*rows, "DataEnd"]) + "\n"


def _directions(specular: float, radial_deg: Real, azimuth_deg: Real, side: float) -> Real:
    """Directions (azimuth, radial, 3) about the specular ray; azimuth 0 towards the normal."""
    radial, azimuth = np.radians(radial_deg), np.radians(azimuth_deg)[:, None]
    along, up, aside = np.cos(radial), np.sin(radial) * np.cos(azimuth), np.sin(radial) * np.sin(azimuth)
    s, c = np.sin(specular), np.cos(specular)
    return np.stack([along * s - up * c, aside, side * (along * c + up * s)], axis=-1)


def _integral(values: Real, specular: float, radial_deg: Real, azimuth_deg: Real) -> float:
    """Integral of values (azimuth, radial) x cos over the half space, linear between the nodes."""
    fine = _refined(radial_deg, _FINE_RADIAL), _refined(azimuth_deg, _FINE_AZIMUTH)
    rows = np.stack([np.interp(fine[0], radial_deg, row) for row in values])
    grid = np.stack([np.interp(fine[1], azimuth_deg, column) for column in rows.T], axis=1)
    return _half_space(grid, specular, *fine)


def _half_space(bsdf: Real, specular: float, radial_deg: Real, azimuth_deg: Real) -> float:
    """Integral of values (azimuth, radial) x cos over the half space, trapezoidal, both mirror halves."""
    radial, azimuth = np.radians(radial_deg), np.radians(azimuth_deg)
    height = np.maximum(_directions(specular, radial_deg, azimuth_deg, 1.0)[..., 2], 0.0)
    rings = (bsdf * height * np.sin(radial)) @ _trapezoid(radial)
    return float(2.0 * rings @ _trapezoid(azimuth))


def _trapezoid(axis: Real) -> Real:
    """Weights of the trapezoidal rule."""
    steps = np.diff(axis)
    return np.asarray(np.concatenate([steps, [0.0]]) + np.concatenate([[0.0], steps])) / 2.0


def _refined(axis: Real, parts_each: int) -> Real:
    parts = [np.linspace(a, b, parts_each, endpoint=False) for a, b in pairwise(axis)]
    return np.concatenate([*parts, axis[-1:]])


def _check_axis(field: str, axis: Real, top: float, *, whole: bool) -> None:
    good = (
        axis.ndim == 1 and axis.size > 1 and bool(np.all(np.diff(axis) > 0.0)) and axis[0] >= 0.0 and axis[-1] <= top
    )
    if not good or (axis[0] != 0.0 and field != "specular_deg") or (whole and axis[-1] != top):
        raise InputError(
            field, axis, f"two or more increasing angles from 0 {'to' if whole else 'up to'} {top:g} deg"
        )
