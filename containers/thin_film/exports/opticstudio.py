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

from containers.bsdf import Bsdf
from containers.thin_film.exports.exported import Exported, checked_text, lost_words, numbers
from containers.thin_film.table import Real
from luxloop.errors import InputError

ScatterType = Literal["BRDF", "BTDF"]
AXES = ("SampleRotation", "AngleOfIncidence", "ScatterAzimuth", "ScatterRadial")
RADIAL_DEG = (
    0,
    1,
    2,
    3,
    4,
    5,
    6,
    8,
    10,
    12,
    15,
    18,
    22,
    26,
    30,
    35,
    40,
    45,
    50,
    55,
    60,
    70,
    80,
    90,
    105,
    120,
    140,
    180,
)
AZIMUTH_DEG = tuple(range(0, 181, 10))
SPECULAR_DEG = tuple(range(0, 86, 5))
_FINE_RADIAL, _FINE_AZIMUTH = 24, 4


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
        fine = _refined(self.radial_deg, _FINE_RADIAL), _refined(self.azimuth_deg, _FINE_AZIMUTH)
        found = np.empty(self.specular_deg.size)
        for k, specular in enumerate(np.radians(self.specular_deg)):
            rows = np.stack([np.interp(fine[0], self.radial_deg, row) for row in self.values[k]])
            grid = np.stack([np.interp(fine[1], self.azimuth_deg, column) for column in rows.T], axis=1)
            found[k] = _half_space(grid, specular, *fine)
        return found


def opticstudio(
    bsdf: Bsdf,
    scatter_type: ScatterType,
    specular_deg: ArrayLike = SPECULAR_DEG,
    azimuth_deg: ArrayLike = AZIMUTH_DEG,
    radial_deg: ArrayLike = RADIAL_DEG,
    also_lost: Mapping[str, float] | None = None,
) -> Exported:
    """The tabular BSDF text of one surface, reflected (BRDF) or transmitted (BTDF) light.

    Parameters
    ----------
    specular_deg : (specular,), below 90 less the first radial step, angles of the specular ray.
    azimuth_deg, radial_deg : (azimuth,) from 0 to 180, (radial,) from 0 to at most 180.
    also_lost : what was lost before, for instance `surface.averaging_loss` of a film table.

    Notes
    -----
    A delta part becomes a cone about the specular ray that falls linearly to 0 at the first radial step and holds the
    same power. `lost`: "delta_spread_deg", that step, where there is a delta part; "delta_power", the largest power
    so spread; "grid", the largest error of the file's own integral (power ratio). TIS is the exact power.
    """
    specular, azimuth, radial = (np.asarray(a, float) for a in (specular_deg, azimuth_deg, radial_deg))
    _check_axis("azimuth_deg", azimuth, 180.0, whole=True)
    _check_axis("radial_deg", radial, 180.0, whole=False)
    _check_axis("specular_deg", specular, 90.0 - radial[1], whole=False)
    theta_in = _incidence(bsdf, scatter_type, np.radians(specular))
    deltas = bsdf.deltas(theta_in)
    delta = deltas.mirror if scatter_type == "BRDF" else deltas.refracted
    side = 1.0 if scatter_type == "BRDF" else -1.0
    fine = np.linspace(0.0, radial[-1], 1081), np.linspace(0.0, 180.0, 121)
    values, spread = np.empty((specular.size, azimuth.size, radial.size)), np.empty(specular.size)
    for k, angle in enumerate(np.radians(specular)):
        values[k] = bsdf.evaluate(theta_in[k], _directions(angle, radial, azimuth, side))
        spread[k] = _half_space(bsdf.evaluate(theta_in[k], _directions(angle, *fine, side)), angle, *fine)
    values[:, :, 0] += (delta / _cone(np.radians(specular), np.radians(radial[1])))[:, None]
    file = ScatterFile(scatter_type, specular, azimuth, radial, spread + delta, values)
    lost = dict(also_lost or {})
    if delta.any():
        lost |= {"delta_spread_deg": float(radial[1]), "delta_power": float(delta.max())}
    lost["grid"] = float(np.abs(file.integrals() - file.tis).max())
    return Exported(_text(file, lost_words(lost)), lost)


def read_opticstudio(text: str) -> ScatterFile:
    """What such a text holds; InputError naming the line where it is not one, or has several sample rotations."""
    lines = [line for line in checked_text("bsdf file", text).splitlines() if line.strip() and line[0] != "#"]
    heads = dict(line.split(None, 1) for line in lines[:11:1] if len(line.split(None, 1)) == 2)
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


def _incidence(bsdf: Bsdf, scatter_type: ScatterType, specular: Real) -> Real:
    if scatter_type == "BRDF":
        return specular
    sine = np.sin(specular) / bsdf.index_ratio
    if np.any(sine > 1.0):
        steepest = float(np.degrees(np.arcsin(min(bsdf.index_ratio, 1.0))))
        raise InputError(
            "specular_deg", float(np.degrees(specular.max())), f"transmitted rays, up to {steepest:.4g} deg"
        )
    return np.asarray(np.arcsin(sine))


def _directions(specular: float, radial_deg: Real, azimuth_deg: Real, side: float) -> Real:
    """Directions (azimuth, radial, 3) about the specular ray; azimuth 0 towards the normal."""
    radial, azimuth = np.radians(radial_deg), np.radians(azimuth_deg)[:, None]
    along, up, aside = np.cos(radial), np.sin(radial) * np.cos(azimuth), np.sin(radial) * np.sin(azimuth)
    s, c = np.sin(specular), np.cos(specular)
    return np.stack([along * s - up * c, aside, side * (along * c + up * s)], axis=-1)


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


def _cone(specular: Real, step: float) -> Real:
    """Projected solid angle of a cone of height 1 that falls linearly to 0 at `step` from the specular ray."""
    return np.asarray(np.pi / 2.0 * np.cos(specular) * (1.0 - np.sin(2.0 * step) / (2.0 * step)))


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
