"""A film table as a surface that a tracer or another program can use, and what averaging it costs."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from containers.bsdf import Bsdf, Deltas, SpecularTable
from containers.bsdf.tabulated import tabulate_intensity
from containers.thin_film.scatter import AbcSpectrum, lobe
from containers.thin_film.table import FilmTable, Real, Side

_NODES = 46
_THETA_EDGES = np.linspace(0.0, np.pi, 91)
_PHI_EDGES = np.linspace(0.0, np.pi, 46)


def film_bsdf(table: FilmTable, side: Side, faces: AbcSpectrum | None = None) -> Bsdf:
    """The surface that light from one side meets: mean of s and p, mean over the line, both in power.

    Parameters
    ----------
    table : of the film.
    side : where the light comes from.
    faces : power spectrum of the rough faces, which gives the scattered powers S_R, S_T their directions (lobe at the
        peak of the line, 2 deg x 4 deg cells); None leaves them out, as if absorbed.

    Notes
    -----
    Exact for one encounter. Indices of the half spaces are those of the peak: dispersion of a direction within the
    line is neglected. Without `faces` the nodes are the table's own; with them 46, uniform in angle.
    """
    at = int(np.argmax(table.weight))
    n_in, n_out = (float(n[at]) for n in _ordered(table, side))
    powers = table.average(side)
    own = table.u[: table.nodes(side)] <= n_in
    theta = np.arcsin(table.u[: table.nodes(side)][own] / n_in)
    if faces is None or not (powers.S_R.any() or powers.S_T.any()):
        return SpecularTable(theta, powers.R[own], powers.T[own], n_in / n_out)
    nodes = np.linspace(0.0, np.pi / 2, _NODES)
    u = n_in * np.sin(nodes)
    R, T, S_R, S_T = (table.at(power, u) for power in (powers.R, powers.T, powers.S_R, powers.S_T))
    T = np.where(u < n_out, T, 0.0)
    wavelength_nm = float(table.wavelength_nm[at])

    def intensity(angle: float, direction: Real) -> Real:
        row = int(np.argmin(np.abs(nodes - angle)))
        x, y, z = np.moveaxis(direction, -1, 0)
        polar, phi = np.arccos(np.minimum(np.abs(z), 1.0)), np.arctan2(y, x)
        back = lobe(faces, float(S_R[row]), float(u[row]), n_in, wavelength_nm, polar, phi)
        on = lobe(faces, float(S_T[row]), float(u[row]), n_out, wavelength_nm, polar, phi)
        return np.asarray(np.where(z > 0.0, back, on))

    axes = nodes, _THETA_EDGES, _PHI_EDGES
    return tabulate_intensity(intensity, R + T + S_R + S_T, Deltas(R, T), n_in / n_out, axes)


def averaging_loss(table: FilmTable, side: Side) -> Mapping[str, float]:
    """Largest errors in R (power ratios) of using the mean over s and p, and over the line, in place of each."""
    R = table.powers(side).R
    over_line = np.tensordot(table.weight, R, axes=1)
    seen = table.weight > 0.01 * table.weight.max()
    return {
        "polarisation": float(np.abs(R - R.mean(axis=1, keepdims=True)).max()),
        "wavelength": float(np.abs(R[seen] - over_line).max()),
    }


def _ordered(table: FilmTable, side: Side) -> tuple[Real, Real]:
    return (table.n_inside, table.n_outside) if side == "inside" else (table.n_outside, table.n_inside)
