"""A film table as a surface that a tracer or another program can use, and what averaging it costs."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from containers.bsdf import Bsdf, Deltas, SpecularTable
from containers.bsdf.tabulated import tabulate_intensity
from containers.thin_film.angles import indices, linear_nodes, powers_at, start_angles
from containers.thin_film.scatter import AbcSpectrum, lobe
from containers.thin_film.table import FilmTable, Powers, Real, Side

TOLERANCE_RATIO = 1e-4
"""Largest error between two nodes of a surface without scatter; each of its nodes is two numbers."""
SCATTER_TOLERANCE_RATIO = 1e-3
"""The same with scatter, where a node is a whole hemisphere."""
_MOST_NODES, _MOST_ROWS = 2000, 400
_ROWS = np.linspace(0.0, np.pi / 2, 46)
"""At least these: a lobe narrower than the step shows as two between them."""
_THETA_EDGES = np.linspace(0.0, np.pi, 91)
_PHI_EDGES = np.linspace(0.0, np.pi, 46)


def film_bsdf(table: FilmTable, side: Side, faces: AbcSpectrum | None = None) -> Bsdf:
    """The surface that light from one side meets: mean of s and p, mean over the line, both in power.

    Parameters
    ----------
    table : of the film.
    side : where the light comes from.
    faces : power spectrum of the rough faces, which gives the scattered powers S_R, S_T their directions (lobe at the
        peak of the line, 2 deg x 4 deg cells); None leaves them out, as if absorbed (`averaging_loss` says how much).

    Notes
    -----
    The powers of one encounter, at angles of incidence chosen so that linear interpolation between them errs by at
    most `TOLERANCE_RATIO` (with scatter `SCATTER_TOLERANCE_RATIO`). Refracted light leaves at the angle of the peak's
    indices; what other wavelengths would still send through beyond the peak's critical angle is reflected.
    """
    at = int(np.argmax(table.weight))
    n_in, n_out = (float(n[at]) for n in indices(table, side))
    scatters = any(f"{name}_{side}" in table.losses for name in ("S_R", "S_T"))
    if faces is None or not scatters:
        nodes = _nodes(table, side, TOLERANCE_RATIO, _MOST_NODES)
        powers = _means(table, side, nodes)
        return SpecularTable(nodes, powers.R, powers.T, n_in / n_out)
    nodes = np.union1d(_nodes(table, side, SCATTER_TOLERANCE_RATIO, _MOST_ROWS), _ROWS)
    R, T, S_R, S_T, _ = _means(table, side, nodes)
    u = n_in * np.sin(nodes)
    wavelength_nm = float(table.wavelength_nm[at])

    def intensity(angle: float, direction: Real) -> Real:
        row = int(np.argmin(np.abs(nodes - angle)))
        x, y, z = np.moveaxis(direction, -1, 0)
        polar, phi = np.arccos(np.minimum(np.abs(z), 1.0)), np.arctan2(y, x)
        found = np.empty(z.shape)
        for half, scattered, n_exit in ((z > 0.0, S_R, n_in), (z <= 0.0, S_T, n_out)):
            there = polar[half], phi[half]
            found[half] = lobe(faces, float(scattered[row]), float(u[row]), n_exit, wavelength_nm, *there)
        return found

    axes = nodes, _THETA_EDGES, _PHI_EDGES
    return tabulate_intensity(intensity, R + T + S_R + S_T, Deltas(R, T), n_in / n_out, axes)


def averaging_loss(table: FilmTable, side: Side, faces: AbcSpectrum | None = None) -> Mapping[str, float]:
    """Largest errors in R and T (power ratios) of `film_bsdf(table, side, faces)` in place of the table, by name.

    "polarisation_ratio", "wavelength_ratio": the mean over s and p, over the line, for each of them (for wavelengths
    of more than 1 % of the peak's weight). Where they are not 0: "scatter_ratio", the largest S_R + S_T, which is
    left out without `faces`; "dispersion_ratio", what is reflected instead of refracted because the surface has the
    critical angle of the peak.
    """
    theta = start_angles(table, side)
    powers = powers_at(table, side, theta)
    both = np.stack([powers.R, powers.T])
    seen = table.weight > 0.01 * table.weight.max()
    over_line = np.tensordot(both, table.weight, axes=(1, 0))
    lost = {
        "polarisation_ratio": float(np.abs(both - both.mean(axis=2, keepdims=True)).max()),
        "wavelength_ratio": float(np.abs(both[:, seen] - over_line[:, None]).max()),
    }
    if faces is None and (scattered := float((powers.S_R + powers.S_T).max())) > 0.0:
        lost["scatter_ratio"] = scattered
    n_in, n_out = (n[int(np.argmax(table.weight))] for n in indices(table, side))
    beyond = n_in * np.sin(theta) >= n_out
    if (refracted := float(over_line[1].mean(axis=0)[beyond].max(initial=0.0))) > 0.0:
        lost["dispersion_ratio"] = refracted
    return lost


def _nodes(table: FilmTable, side: Side, tolerance: float, most: int) -> Real:
    def values(theta: Real) -> Real:
        return np.stack(_means(table, side, theta)[:4])

    return linear_nodes(values, start_angles(table, side), tolerance, most)


def _means(table: FilmTable, side: Side, theta: Real) -> Powers:
    """Powers of unpolarised light of the whole line, each (angle,)."""
    powers = powers_at(table, side, theta)
    return Powers(*(np.tensordot(table.weight, power.mean(axis=1), axes=1) for power in powers))
