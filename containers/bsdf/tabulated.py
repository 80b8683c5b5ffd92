"""Any Bsdf as arrays, sampled exactly: constant bsdf in cells of direction, linear between rows of incidence.

The power of a cell is its bsdf times its projected solid angle |sin^2 theta_1 - sin^2 theta_0| / 2 x (phi_1 - phi_0);
inside a cell sin^2 theta and phi are drawn uniformly. So a ray is one search in a row's cumulative powers and one
weight, the albedo, whether the lobe is 1 degree wide or flat: no cosine-drawn weights that would have to be clipped.
Between two nodes of theta_in the bsdf is the mixture (1 - a) row_i + a row_i+1; sampling draws the row first, hence
evaluation and sampling agree at every angle. A lobe narrower than the step in theta_in therefore shows as two lobes
between nodes: choose the nodes for the lobe.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from containers.bsdf.specular import specular_direction, totally_reflected
from containers.bsdf.surface import HALF_PI, Bsdf, Deltas, Real, checked_angle, direction_of, pick
from containers.checked import within
from luxloop.errors import InputError

ENERGY_TOLERANCE = 1e-9
COARSE = 0.05


def _no_power() -> Real:
    return np.zeros((1, 1, 1))


@dataclass(frozen=True)
class Tabulated(Bsdf):
    """A bsdf as a table; the verbs use its mean over the polarisations and, by `weight`, over the wavelengths.

    Raises
    ------
    InputError where axes do not fit, values are negative or not finite, or a row would create energy (named).
    """

    values: Real
    """bsdf in 1/sr, (wavelength, polarisation, theta_in, theta_out cell, phi_out cell)."""
    theta_in_rad: Real
    """(theta_in,), nodes; beyond the first and the last the table is constant."""
    theta_out_edges_rad: Real
    """From 0 to pi/2 (reflection only) or to pi, then with an edge at pi/2."""
    phi_out_edges_rad: Real
    """From 0 to 2 pi, or from 0 to pi for a table that is its own image in the plane of incidence."""
    mirror: Real = field(default_factory=_no_power)
    """Delta part into the mirror direction, (wavelength, polarisation, theta_in), or (1, 1, 1) for all."""
    refracted: Real = field(default_factory=_no_power)
    """Delta part into the refracted direction, the same shape."""
    index_ratio: float = 1.0
    """n_in / n_out."""
    wavelength_nm: Real = field(default_factory=lambda: np.zeros(1))
    """(wavelength,); a single 0 where the table holds for all."""
    weight: Real = field(default_factory=lambda: np.ones(1))
    """(wavelength,), of sum 1."""

    def __post_init__(self) -> None:
        _check_axes(self)
        for name in ("values", "mirror", "refracted"):
            array = getattr(self, name)
            if not np.all(np.isfinite(array)) or np.any(array < 0.0):
                raise InputError(name, float(np.min(array)), "finite numbers from 0")
        kept = (self.values * self.projected_sr).sum(axis=(-2, -1)) + self.mirror + self.refracted
        if np.any(kept > 1.0 + ENERGY_TOLERANCE):
            w, p, row = np.unravel_index(int(np.argmax(kept)), kept.shape)
            name = (
                f"wavelength {w}, polarisation {p}, theta_in row {row} ({np.degrees(self.theta_in_rad[row]):.3f} deg)"
            )
            raise InputError(f"albedo of {name}", round(float(kept.max()), 9), "at most 1", "it would create energy")

    @cached_property
    def projected_sr(self) -> Real:
        """Projected solid angle of each cell, (theta_out cell, phi_out cell); pi for a whole half space."""
        rings = np.abs(np.diff(np.sin(self.theta_out_edges_rad) ** 2)) / 2.0
        return rings[:, None] * np.diff(self.phi_out_edges_rad) * self.images

    @cached_property
    def mean(self) -> Real:
        """The bsdf (1/sr) that the verbs use, (theta_in, theta_out cell, phi_out cell)."""
        return self._averaged(self.values)

    def channel(self, wavelength: int, polarisation: int) -> Tabulated:
        """The table of one wavelength and one polarisation, by their numbers."""
        shape = self.values.shape[:3]
        one = {
            name: np.broadcast_to(getattr(self, name), shape)[wavelength, polarisation][None, None]
            for name in ("mirror", "refracted")
        }
        values = self.values[wavelength, polarisation][None, None]
        return replace(self, values=values, **one, wavelength_nm=self.wavelength_nm[[wavelength]], weight=np.ones(1))

    def deltas(self, theta_in_rad: ArrayLike) -> Deltas:
        """Shares of the incident power in the exact mirror and in the exact refracted direction."""
        theta = checked_angle(theta_in_rad)
        mirror, refracted = (self._between(theta, self._averaged(part)) for part in (self.mirror, self.refracted))
        return totally_reflected(Deltas(mirror, refracted), theta, self.index_ratio)

    @property
    def images(self) -> int:
        """How many azimuths each cell stands for: 2 where the table is its own mirror image, else 1."""
        return 2 if self.phi_out_edges_rad[-1] < 1.5 * np.pi else 1

    @cached_property
    def _cumulative(self) -> Real:
        """Power up to the end of each cell, (theta_in, cell), a leading 0."""
        powers = (self.mean * self.projected_sr).reshape(self.theta_in_rad.size, -1)
        return np.concatenate([np.zeros((self.theta_in_rad.size, 1)), np.cumsum(powers, axis=1)], axis=1)

    def _averaged(self, array: Real) -> Real:
        """Mean over polarisation, weighted mean over wavelength, of (wavelength, polarisation, theta_in, ...)."""
        full = np.broadcast_to(array, (self.weight.size, *array.shape[1:]))
        mean = np.tensordot(self.weight, full.mean(axis=1), axes=1)
        return np.broadcast_to(mean, (self.theta_in_rad.size, *mean.shape[1:]))

    def _place(self, theta_in: Real) -> tuple[np.ndarray[tuple[int, ...], np.dtype[np.intp]], Real]:
        """Row below each angle, and the share of the row above."""
        nodes = self.theta_in_rad
        if nodes.size == 1:
            return np.zeros(theta_in.shape, np.intp), np.zeros(theta_in.shape)
        row = np.clip(np.searchsorted(nodes, theta_in, "right") - 1, 0, nodes.size - 2)
        return row, np.clip((theta_in - nodes[row]) / (nodes[row + 1] - nodes[row]), 0.0, 1.0)

    def _between(self, theta_in: Real, rows: Real) -> Real:
        return np.asarray(np.interp(theta_in, self.theta_in_rad, rows))

    def _draw(self, u: Real, theta_in: Real) -> Real:
        row, above = self._place(theta_in)
        following = np.minimum(row + 1, self.theta_in_rad.size - 1)
        kept = self._cumulative[:, -1]
        mirror, refracted = self.deltas(theta_in)
        shares = [(1.0 - above) * kept[row], above * kept[following], mirror, refracted]
        part, _ = pick(u[:, 0], np.stack(shares, axis=-1))
        direction = specular_direction(part == 3, theta_in, self.index_ratio)
        for part_row in np.unique(np.where(part == 1, following, row)[part < 2]):
            rays = np.flatnonzero((part < 2) & (np.where(part == 1, following, row) == part_row))
            direction[rays] = self._draw_row(int(part_row), u[rays, 1], u[rays, 2])
        return direction

    def _draw_row(self, row: int, u: Real, v: Real) -> Real:
        """Directions in proportion to the powers of one row: u chooses the cell and its theta, v its phi."""
        ends = self._cumulative[row]
        at = u * ends[-1]
        cell = np.clip(np.searchsorted(ends, at, "right") - 1, 0, ends.size - 2)
        width = ends[cell + 1] - ends[cell]
        left = np.divide(at - ends[cell], width, out=np.zeros_like(at), where=width > 0.0)
        ring, sector = np.divmod(cell, self.phi_out_edges_rad.size - 1)
        squares = np.sin(self.theta_out_edges_rad) ** 2
        sine = np.sqrt(squares[ring] + left * (squares[ring + 1] - squares[ring]))
        upper = self.theta_out_edges_rad[ring + 1] <= HALF_PI * (1.0 + 1e-12)
        theta = np.where(upper, np.arcsin(sine), np.pi - np.arcsin(sine))
        sign = np.ones_like(v)
        if self.images == 2:
            sign, v = np.where(v < 0.5, 1.0, -1.0), np.where(v < 0.5, 2.0 * v, 2.0 * v - 1.0)
        phi = self.phi_out_edges_rad[sector] + v * np.diff(self.phi_out_edges_rad)[sector]
        return direction_of(theta, sign * phi)

    def _intensity(self, theta_in: Real, direction: Real) -> Real:
        x, y, z = np.moveaxis(direction, -1, 0)
        theta, phi = np.arctan2(np.hypot(x, y), z), np.arctan2(y, x)
        phi = np.abs(phi) if self.images == 2 else phi % (2.0 * np.pi)
        ring = np.searchsorted(self.theta_out_edges_rad, theta, "right") - 1
        sector = np.searchsorted(self.phi_out_edges_rad, phi, "right") - 1
        inside = (z >= 0.0) | (self.theta_out_edges_rad[-1] > 2.0)
        ring = np.minimum(ring, self.theta_out_edges_rad.size - 2)
        sector = np.minimum(sector, self.phi_out_edges_rad.size - 2)
        row, above = self._place(theta_in)
        following = np.minimum(row + 1, self.theta_in_rad.size - 1)
        value = (1.0 - above) * self.mean[row, ring, sector] + above * self.mean[following, ring, sector]
        return np.asarray(np.where(inside, value, 0.0) * np.abs(z))

    def _albedo(self, theta_in: Real) -> Real:
        mirror, refracted = self.deltas(theta_in)
        return self._between(theta_in, self._cumulative[:, -1]) + mirror + refracted


Intensity = Callable[[float, Real], Real]
"""Share of the incident power per solid angle (1/sr) from (theta_in, directions (..., 3))."""


def tabulate(
    bsdf: Bsdf,
    theta_in_rad: ArrayLike,
    theta_out_edges_rad: ArrayLike,
    phi_out_edges_rad: ArrayLike,
    order: int = 4,
) -> Tabulated:
    """Any Bsdf as a table: each cell holds its mean over the cell, each row the exact albedo of its node.

    Parameters
    ----------
    theta_in_rad, theta_out_edges_rad, phi_out_edges_rad : axes as in `Tabulated`; cells narrower than the lobe.
    order : points per cell and axis of the Gauss-Legendre rule for the mean.

    Raises
    ------
    InputError where a row's quadrature is off the albedo by more than 5 %: the cells are too coarse for the lobe.
    """
    nodes = np.atleast_1d(checked_angle(theta_in_rad))
    axes = nodes, np.asarray(theta_out_edges_rad, float), np.asarray(phi_out_edges_rad, float)
    return tabulate_intensity(bsdf.intensity, bsdf.albedo(nodes), bsdf.deltas(nodes), bsdf.index_ratio, axes, order)


def tabulate_intensity(
    intensity: Intensity,
    albedo: Real,
    deltas: Deltas,
    index_ratio: float,
    axes: tuple[Real, Real, Real],
    order: int = 4,
) -> Tabulated:
    """The table of light spread by `intensity` and of `deltas`, together `albedo` (theta_in,); else as `tabulate`."""
    nodes, theta_edges, phi_edges = axes
    theta, theta_weight = _points(theta_edges, order)
    phi, phi_weight = _points(phi_edges, order)
    direction = direction_of(theta[:, None], phi)
    solid_angle = (theta_weight * np.sin(theta))[:, None] * phi_weight
    shape = (theta_edges.size - 1, order, phi_edges.size - 1, order)
    values = np.zeros((1, 1, nodes.size, shape[0], shape[2]))
    mirror, refracted = (part[None, None] for part in deltas)
    table = Tabulated(values, nodes, theta_edges, phi_edges, mirror, refracted, index_ratio)
    spread = albedo - deltas.mirror - deltas.refracted
    for row, angle in enumerate(nodes):
        powers = (intensity(float(angle), direction) * solid_angle).reshape(shape).sum(axis=(1, 3)) * table.images
        found = float(powers.sum())
        if abs(found - spread[row]) > COARSE * max(spread[row], 1e-12) + 1e-12:
            mend = "finer theta_out and phi_out cells about the lobe"
            raise InputError(f"albedo of row {row}", found, f"{spread[row]:.6g} within 5 %", mend)
        values[0, 0, row] = powers / table.projected_sr * (spread[row] / found if found > 0.0 else 1.0)
    return replace(table, values=values)


def _points(edges: Real, order: int) -> tuple[Real, Real]:
    """Gauss-Legendre points and weights of all cells between the edges, in one row."""
    x, weight = np.polynomial.legendre.leggauss(order)
    half, middle = np.diff(edges) / 2.0, (edges[1:] + edges[:-1]) / 2.0
    return (middle[:, None] + half[:, None] * x).ravel(), (half[:, None] * weight).ravel()


def _check_axes(table: Tabulated) -> None:
    for name, ends in (("theta_out_edges_rad", (HALF_PI, np.pi)), ("phi_out_edges_rad", (np.pi, 2.0 * np.pi))):
        edges = getattr(table, name)
        good = edges.ndim == 1 and edges.size > 1 and edges[0] == 0.0 and bool(np.all(np.diff(edges) > 0.0))
        if not good or not np.isclose(edges[-1], ends, rtol=1e-12, atol=0.0).any():
            raise InputError(name, edges, f"increasing from 0 to {ends[0]:.6f} or {ends[1]:.6f}")
    theta = table.theta_out_edges_rad
    if theta[-1] > 2.0 and not np.isclose(theta, HALF_PI, rtol=1e-12).any():
        raise InputError("theta_out_edges_rad", theta, "an edge at pi/2", "it parts reflection from transmission")
    nodes = table.theta_in_rad
    within("theta_in_rad", nodes, 0.0, HALF_PI, "increasing angles")
    if nodes.ndim != 1 or not nodes.size or not np.all(np.diff(nodes) > 0.0):
        raise InputError("theta_in_rad", nodes, "increasing angles from 0 to pi/2", "sort them")
    within("index_ratio", table.index_ratio, 0.0, 20.0, "n_in / n_out", above=True)
    within("weight", table.weight, 0.0, 1.0 + 1e-9, "the share of each wavelength")
    cells = (theta.size - 1, table.phi_out_edges_rad.size - 1)
    polarisations = table.values.shape[1] if table.values.ndim == 5 else 0
    want = (table.wavelength_nm.size, polarisations, nodes.size, *cells)
    if table.values.shape != want or polarisations not in (1, 2):
        axes = "(wavelength, polarisation 1 or 2, theta_in, theta_out cell, phi_out cell)"
        raise InputError("values", table.values.shape, f"{axes} with {nodes.size}, {cells[0]}, {cells[1]} at the end")
    for name in ("mirror", "refracted"):
        if getattr(table, name).shape not in (want[:3], (1, 1, nodes.size), (1, 1, 1)):
            raise InputError(name, getattr(table, name).shape, f"{want[:3]}")
    if table.weight.shape != table.wavelength_nm.shape or abs(float(table.weight.sum()) - 1.0) > 1e-9:
        raise InputError("weight", table.weight.shape, "one for each wavelength, of sum 1")
