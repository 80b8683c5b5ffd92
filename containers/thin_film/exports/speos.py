"""The Speos coated surface (`*.coated`): R and T in percent per polarisation, wavelength and angle of incidence.

    OPTIS - Coated surface file v1.0
    <comment, one line>
    <angles> <wavelengths>
    TAB 400 TAB TAB 401.5 TAB TAB ...
    0 TAB R_p TAB T_p TAB R_p TAB T_p ...      P row of an angle: a pair for each wavelength
      TAB R_s TAB T_s TAB R_s TAB T_s ...      S row of the same angle

Wavelengths in nm, angles in degrees; no tabs in the first three lines. This layout, P before S included, is the one
of the maker's public article on the format. A file holds for light that crosses in one direction, so a film has two.
Not verified: whether Speos interpolates linearly between angles (assumed in `lost`), and how it takes the angle's
medium; the angle here is that in the medium the light comes from.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from containers.checked import reals
from containers.thin_film.angles import Values, linear_nodes, powers_at, start_angles, worst_between
from containers.thin_film.exports.exported import Exported, checked_text, lost_words, numbers
from containers.thin_film.table import FilmTable, Real, Side
from luxloop.errors import InputError

HEADER = "OPTIS - Coated surface file v1.0"
MAX_ROWS = 100_000
TOLERANCE_RATIO = 1e-3
"""Largest error of linear interpolation between two angles of a file."""
MAX_VALUES = 200_000
"""Wavelengths x angles of a file, four numbers each."""


@dataclass(frozen=True)
class CoatedSurface:
    """Powers of one side of a coating."""

    wavelength_nm: Real
    """(wavelength,)"""
    aoi_deg: Real
    """(angle,)"""
    R: Real
    """(wavelength, polarisation s, p, angle)"""
    T: Real
    """(wavelength, polarisation s, p, angle)"""


def coated_surface(table: FilmTable, side: Side, aoi_deg: ArrayLike | None = None) -> CoatedSurface:
    """The film's powers seen from one side, computed at the angles (angle,), by default those of `own_angles_deg`."""
    aoi = own_angles_deg(table, side) if aoi_deg is None else reals("aoi_deg", aoi_deg)
    if aoi.ndim != 1 or not aoi.size or not np.all(np.diff(aoi) > 0.0) or not 0.0 <= aoi[0] <= aoi[-1] <= 90.0:
        raise InputError("aoi_deg", aoi, "increasing angles from 0 to 90 deg", "leave them out: they are then chosen")
    powers = powers_at(table, side, np.radians(aoi))
    return CoatedSurface(table.wavelength_nm, aoi, powers.R, powers.T)


def own_angles_deg(table: FilmTable, side: Side) -> Real:
    """Angles (angle,) from 0 to 90 deg: R and T of all wavelengths, s and p, are linear between them.

    To `TOLERANCE_RATIO`; less where more than `MAX_VALUES` values would be needed. With dispersion there are about 40
    to each wavelength: each has a critical angle of its own.
    """
    most = max(100, MAX_VALUES // table.wavelength_nm.size)
    return np.degrees(linear_nodes(_values(table, side), start_angles(table, side), TOLERANCE_RATIO, most))


def speos(table: FilmTable, side: Side, aoi_deg: ArrayLike | None = None) -> Exported:
    """The `*.coated` text for light from one side.

    Parameters
    ----------
    aoi_deg : (angle,), increasing, in the medium of `side`; by default those of `own_angles_deg`, dense about the
        critical angles.

    Notes
    -----
    `lost`: "scatter_ratio", the largest S_R + S_T, which the format books as absorbed (100 - R - T);
    "interpolation_ratio", the largest error in R and T where they are interpolated linearly between the angles of the
    file and held beyond its first and last, at any wavelength and polarisation of the file.
    """
    surface = coated_surface(table, side, aoi_deg)
    theta = np.radians(surface.aoi_deg)
    scattering = powers_at(table, side, start_angles(table, side))
    lost = {
        "scatter_ratio": float((scattering.S_R + scattering.S_T).max()),
        "interpolation_ratio": float(worst_between(_values(table, side), theta).max()),
    }
    comment = f"luxloop, light from {side}; {lost_words(lost)}; {table.stack}"
    return Exported(_text(surface, comment), lost)


def _values(table: FilmTable, side: Side) -> Values:
    """R and T of every wavelength and polarisation in rows, as a function of the angles."""

    def values(theta: Real) -> Real:
        powers = powers_at(table, side, theta)
        return np.concatenate([power.reshape(-1, theta.size) for power in (powers.R, powers.T)])

    return values


def _text(surface: CoatedSurface, comment: str) -> str:
    percent = 100.0 * np.stack([surface.R, surface.T], axis=-1)
    rows = [HEADER, " ".join(comment.split())[:1000], f"{surface.aoi_deg.size} {surface.wavelength_nm.size}"]
    rows.append("\t" + "".join(f"{nm:.10g}\t\t" for nm in surface.wavelength_nm))
    for k, aoi in enumerate(surface.aoi_deg):
        for label, polarisation in ((f"{aoi:.15g}", 1), ("", 0)):
            rows.append(f"{label}\t" + "".join(f"{x:.12g}\t" for x in percent[:, polarisation, k].ravel()))
    return "\n".join(rows) + "\n"


def read_speos(text: str) -> CoatedSurface:
    """The surface in a `*.coated` text; InputError naming the line where it is not one."""
    lines = checked_text("coated file", text).splitlines()
    if len(lines) < 4 or lines[0].strip() != HEADER:
        raise InputError("coated file, line 1", lines[0] if lines else "", HEADER)
    counts = numbers("coated file, line 3", lines[2].split(), 2)
    if any(not 1 <= n <= MAX_ROWS or n != int(n) for n in counts) or len(lines) < 4 + 2 * int(counts[0]):
        raise InputError("coated file, line 3", lines[2], f"counts of the {len(lines)} lines", "it was cut short")
    angles, wavelengths = (int(n) for n in counts)
    if 8 * angles * wavelengths > len(text):  # four numbers of each, a digit and a gap at least
        raise InputError("coated file, line 3", lines[2], f"counts of {len(text)} characters", "it was cut short")
    wavelength_nm = np.array(numbers("coated file, line 4", lines[3].split(), wavelengths))
    aoi_deg, percent = np.empty(angles), np.empty((wavelengths, 2, angles, 2))
    for k in range(angles):
        first, second = lines[4 + 2 * k].split(), lines[5 + 2 * k].split()
        row = numbers(f"coated file, line {5 + 2 * k}", first, 1 + 2 * wavelengths)
        aoi_deg[k] = row[0]
        percent[:, 1, k] = np.reshape(row[1:], (wavelengths, 2))
        s_row = numbers(f"coated file, line {6 + 2 * k}", second, 2 * wavelengths)
        percent[:, 0, k] = np.reshape(s_row, (wavelengths, 2))
    return CoatedSurface(wavelength_nm, aoi_deg, percent[..., 0] / 100.0, percent[..., 1] / 100.0)
