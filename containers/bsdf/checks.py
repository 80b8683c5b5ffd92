"""Laws a surface obeys or is known to break: Helmholtz reciprocity and conservation of energy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from containers.bsdf.mixture import Coated
from containers.bsdf.surface import HALF_PI, Bsdf, Real, checked_angle, direction_of
from containers.bsdf.tabulated import ENERGY_TOLERANCE, Tabulated
from luxloop.errors import InputError

MOST_CELLS = 45
"""Rings of theta_out, and sectors of phi_out, that one reciprocity check looks at."""


def reciprocity_defect(
    bsdf: Bsdf, theta_rad: ArrayLike, phi_rad: ArrayLike = (0.05, 0.3, 0.8, 1.4, 2.0, 2.6, 3.1)
) -> float:
    """Largest |f(a -> b) - f(b -> a)| over the largest f, for reflection between all pairs of directions.

    Parameters
    ----------
    theta_rad : (m,), polar angles of both directions, below pi/2; for a table its nodes of theta_in.
    phi_rad : (k,), azimuths between the mirror direction's and the outgoing one.

    Notes
    -----
    Delta parts into the mirror direction are reciprocal by themselves; for refracted ones see `transmission_defect`.
    Lambertian and symmetrised tables give 0, a Gaussian lobe does not.
    """
    theta, phi = np.atleast_1d(checked_angle(theta_rad)), np.asarray(phi_rad, float)
    there = bsdf.evaluate(
        theta[:, None, None],
        np.broadcast_to(direction_of(theta[:, None], phi), (theta.size, theta.size, phi.size, 3)),
    )
    # exchanging the directions turns phi into -phi
    back = bsdf.evaluate(
        theta[:, None, None],
        np.broadcast_to(direction_of(theta[:, None], -phi), (theta.size, theta.size, phi.size, 3)),
    )
    largest = float(there.max())
    return float(np.abs(there - back.swapaxes(0, 1)).max()) / largest if largest > 0.0 else 0.0


def one_way_share(bsdf: Bsdf) -> float:
    """Share of the light that goes from a to b by reflection but would not go from b to a, over all pairs (a, b).

    Notes
    -----
    sum |f(a -> b) - f(b -> a)| / 2 sum f, each pair by its projected solid angles: 0 for a reciprocal surface, 1 at
    most. A table is asked at the centres of its own cells, every n-th where it has more than `MOST_CELLS` rings or
    sectors, anything else at those of 2 deg x 6 deg. A table of a reciprocal surface has a small share too, of what
    it holds constant in a cell. Delta parts and transmission are left out (`transmission_defect`).
    """
    theta, ring, phi, sector = _cells_of(bsdf)
    shape = theta.size, theta.size, phi.size, 3
    there, back = (
        bsdf.evaluate(theta[:, None, None], np.broadcast_to(direction_of(theta[:, None], sign * phi), shape))
        for sign in (1.0, -1.0)  # exchanging the directions turns phi into -phi
    )
    weight = ring[:, None, None] * ring[:, None] * sector
    lost = float((np.abs(there - back.swapaxes(0, 1)) * weight).sum())
    total = float(((there + back) * weight).sum())
    return lost / total if total > 0.0 else 0.0


def _cells_of(bsdf: Bsdf) -> tuple[Real, Real, Real, Real]:
    """Centres theta_out and sizes in sin^2 theta of reflection, centres and sizes in phi_out."""
    if isinstance(bsdf, Coated):
        return _cells_of(bsdf.base)
    theta, phi = np.linspace(0.0, HALF_PI, 46), np.linspace(0.0, np.pi, 31)
    if isinstance(bsdf, Tabulated):
        theta, phi = bsdf.theta_out_edges_rad, bsdf.phi_out_edges_rad
        theta = theta[theta < HALF_PI * (1.0 + 1e-9)]
    steps = (slice(None, None, -(-(edges.size - 1) // MOST_CELLS)) for edges in (theta, phi))
    sizes = np.diff(np.sin(theta) ** 2), np.diff(phi)
    centres = ((edges[1:] + edges[:-1]) / 2.0 for edges in (theta, phi))
    (theta, ring), (phi, sector) = (
        (centre[step], size[step]) for centre, size, step in zip(centres, sizes, steps, strict=True)
    )
    return theta, ring, phi, sector


def transmission_defect(front: Bsdf, back: Bsdf, theta_rad: ArrayLike) -> float:
    """Largest |T_front(theta) - T_back(theta_t)| of the refracted delta parts of the two sides of one face.

    `theta_rad` (m,) are angles on the front; those beyond its critical angle are left out.
    """
    if not np.isclose(front.index_ratio * back.index_ratio, 1.0, rtol=1e-9):
        raise InputError("index_ratio", (front.index_ratio, back.index_ratio), "reciprocals: two sides of one face")
    theta = np.atleast_1d(checked_angle(theta_rad))
    sine = front.index_ratio * np.sin(theta)
    theta, sine = theta[sine < 1.0], sine[sine < 1.0]
    return float(np.abs(front.deltas(theta).refracted - back.deltas(np.arcsin(sine)).refracted).max(initial=0.0))


def check_energy(bsdf: Bsdf, theta_rad: ArrayLike) -> float:
    """The largest albedo over the angles (m,); InputError naming the angle where it is above 1."""
    theta = np.atleast_1d(checked_angle(theta_rad))
    albedo = bsdf.albedo(theta)
    row = int(np.argmax(albedo))
    if albedo[row] > 1.0 + ENERGY_TOLERANCE:
        field = f"albedo at theta_in {np.degrees(theta[row]):.3f} deg (row {row})"
        raise InputError(field, round(float(albedo[row]), 9), "at most 1", "it would create energy")
    return float(albedo[row])


def symmetrised(table: Tabulated) -> Tabulated:
    """The table with bsdf(a -> b) and bsdf(b -> a) replaced by their mean, reciprocal at its nodes.

    Needs as many theta_in nodes as theta_out cells of reflection, one node in each cell; a table over 2 pi is
    averaged with phi -> -phi. Between the nodes reciprocity holds only as far as a table is fine. Row powers change;
    InputError where one then exceeds 1.
    """
    edges = table.theta_out_edges_rad[table.theta_out_edges_rad < np.pi / 2 * (1.0 + 1e-9)]
    nodes = table.theta_in_rad
    if nodes.size != edges.size - 1 or np.any(np.searchsorted(edges, nodes, "right") - 1 != np.arange(nodes.size)):
        raise InputError("theta_in_rad", nodes, "one node within each theta_out cell of reflection")
    back = table.values[:, :, :, : nodes.size].swapaxes(2, 3)
    if table.phi_out_edges_rad[-1] > 4.0:
        if not np.allclose(np.diff(table.phi_out_edges_rad), np.diff(table.phi_out_edges_rad)[::-1]):
            raise InputError("phi_out_edges_rad", table.phi_out_edges_rad, "edges that are their own mirror image")
        back = back[..., ::-1]
    values = table.values.copy()
    values[:, :, :, : nodes.size] = (values[:, :, :, : nodes.size] + back) / 2.0
    return replace(table, values=values)
