"""A second opinion: a Monte Carlo of the periodic cell in plain numpy, from the physics alone, face by face.

It shares no code with the kernels and none of their short cuts: no unfolding, no folding, no weights, no low
discrepancy. Every ray is a photon that is followed to its end; what it meets is found anew at every step.

    z = D  ────────────── receiver: Lambertian, counts every arrival
    z = T     ┌─────┐     top: R(u), the rest goes through; sides: Fresnel
    z = 0  ───┴─────┴──── substrate: Gaussian lobe; below the chip a mirror, or the substrate itself
          -S/2      S/2   beyond: the next cell, the same again
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Real = NDArray[np.float64]
NEAR_UM = 1e-7
"""A ray that has just left a face is this far from it."""


@dataclass(frozen=True)
class PlainCell:
    """All that the physics needs to know; lengths in um."""

    distance: float
    spacing: float
    width: float
    thickness: float
    index: float
    absorption: float
    """1/um"""
    layer_depth: float | None
    mirror: float | None
    """Reflectance of a mirror below the chip; None: the substrate in contact."""
    substrate: float
    sigma_rad: float
    receiver: float
    top_reflectance: Callable[[Real], Real]
    """R against u = n sin(theta), below 1, from either side."""
    rise: float = 0.0
    """1/um, of the absorption: so much more at the chip's top, and less at its bottom, than halfway up."""


def fresnel(n_in: float, n_out: float, cosine: Real) -> Real:
    """Mean reflectance of s and p, from the laws of sines and tangents; 1 beyond the critical angle."""
    a = np.arccos(np.clip(cosine, 0.0, 1.0 - 1e-12))
    sine = n_in / n_out * np.sin(a)
    b = np.arcsin(np.minimum(sine, 1.0))
    s, p = np.sin(a - b) / np.sin(a + b), np.tan(a - b) / np.tan(a + b)
    return np.where(sine >= 1.0, 1.0, (s**2 + p**2) / 2.0)


def arrivals(cell: PlainCell, photons: int, seed: int) -> tuple[Real, NDArray[np.int64], dict[str, int]]:
    """Places (arrival, 2) within the cell and the photon (arrival,) of each arrival, and how many ended where."""
    rng = np.random.default_rng(seed)
    photon = np.arange(photons)
    half, T = cell.width / 2.0, cell.thickness
    at = rng.uniform(-half, half, (photons, 3))
    at[:, 2] = rng.uniform(0.0, T, photons) if cell.layer_depth is None else cell.layer_depth * T
    way = rng.normal(size=(photons, 3))
    way /= np.linalg.norm(way, axis=1)[:, None]
    within = np.ones(photons, bool)
    places, whose, ends = [], [], dict.fromkeys(("chip", "bottom", "substrate", "receiver"), 0)

    while photon.size:
        alive = np.ones(photon.size, bool)
        for chosen, step in ((within, _inside), (~within, _outside)):
            rays = np.flatnonzero(chosen)
            if not rays.size:
                continue
            at[rays], way[rays], inside, end, landed = step(cell, at[rays], way[rays], rng)
            places.append(at[rays][landed, :2])
            whose.append(photon[rays][landed])
            for name, ended in end.items():
                ends[name] += int(ended.sum())
                alive[rays[ended]] = False
            within[rays] = inside
        at, way, within, photon = at[alive], way[alive], within[alive], photon[alive]
    return np.concatenate(places), np.concatenate(whose), ends


Step = tuple[Real, Real, NDArray[np.bool_], dict[str, NDArray[np.bool_]], NDArray[np.bool_]]


def _inside(cell: PlainCell, at: Real, way: Real, rng: np.random.Generator) -> Step:
    """To the next face of the chip, or to where the chip absorbs."""
    half, count = cell.width / 2.0, len(at)
    low, high = np.array([-half, -half, 0.0]), np.array([half, half, cell.thickness])
    path = np.where(way > 0.0, high - at, low - at) / way
    axis = path.argmin(axis=1)
    rows = np.arange(count)
    length = path[rows, axis]
    halfway = at[:, 2] + way[:, 2] * length / 2.0
    absorption = cell.absorption + cell.rise * (2.0 * halfway / cell.thickness - 1.0)
    dead = rng.exponential(size=count) < absorption * length
    at = at + way * length[:, None]
    down = (axis == 2) & (way[:, 2] < 0.0)
    cosine = np.abs(way[rows, axis])
    u = cell.index * np.sqrt(1.0 - cosine**2)
    R = fresnel(cell.index, 1.0, cosine)
    R = np.where(axis == 2, np.where(u < 1.0, cell.top_reflectance(np.minimum(u, 1.0)), 1.0), R)
    out = ~down & (rng.random(count) >= R)
    through = _refracted(way, axis, cell.index)
    back = way.copy()
    back[rows, axis] *= -1.0
    lost = np.zeros(count, bool)
    if cell.mirror is not None:
        lost = down & (rng.random(count) >= cell.mirror)
    elif down.any():
        lost = down & (rng.random(count) >= cell.substrate)
        back[down] = _lobe(back[down], cell.sigma_rad, rng)
    way = np.where(out[:, None], through, back)
    at[rows, axis] += NEAR_UM * np.sign(way[rows, axis])
    return at, way, ~out, {"chip": dead, "bottom": lost & ~dead}, np.zeros(count, bool)


def _outside(cell: PlainCell, at: Real, way: Real, rng: np.random.Generator) -> Step:
    """To the receiver, the substrate, the chip in the middle of the cell, or the next cell."""
    half, count = cell.width / 2.0, len(at)
    rows = np.arange(count)
    low, high = np.array([-half, -half, 0.0]), np.array([half, half, cell.thickness])
    to_plane = np.where(way[:, 2] > 0.0, cell.distance - at[:, 2], -at[:, 2]) / way[:, 2]
    to_edge = (np.copysign(cell.spacing / 2.0, way[:, :2]) - at[:, :2]) / way[:, :2]
    first, second = (low - at) / way, (high - at) / way
    entries, leaving = np.minimum(first, second), np.maximum(first, second).min(axis=1)
    face, enter = entries.argmax(axis=1), entries.max(axis=1)
    to_chip = np.where((enter > 0.0) & (enter < leaving), enter, np.inf)
    paths = np.column_stack([to_plane, to_edge, to_chip])
    what = paths.argmin(axis=1)
    at = at + way * paths[rows, what][:, None]

    landed, bottom, chip = (what == 0) & (way[:, 2] > 0.0), (what == 0) & (way[:, 2] < 0.0), what == 3
    way = way.copy()
    for axis in (0, 1):
        beyond = what == axis + 1
        at[beyond, axis] = np.copysign(cell.spacing / 2.0, -way[beyond, axis])
    lost = bottom & (rng.random(count) >= cell.substrate)
    way[bottom, 2] *= -1.0
    way[bottom] = _lobe(way[bottom], cell.sigma_rad, rng)
    kept = landed & (rng.random(count) >= cell.receiver)
    phi, share = rng.uniform(0.0, 2.0 * np.pi, count), rng.random(count)
    lambert = np.column_stack([np.sqrt(share) * np.cos(phi), np.sqrt(share) * np.sin(phi), -np.sqrt(1.0 - share)])
    way = np.where(landed[:, None], lambert, way)
    at[landed, 2], at[bottom, 2] = cell.distance - NEAR_UM, NEAR_UM

    cosine = np.abs(way[rows, face])
    R = fresnel(1.0, cell.index, cosine)
    R = np.where(face == 2, cell.top_reflectance(np.sqrt(1.0 - cosine**2)), R)
    enters = chip & (rng.random(count) >= R)
    refused = np.flatnonzero(chip & ~enters)
    through = _refracted(way, face, 1.0 / cell.index)
    way = np.where(enters[:, None], through, way)
    way[refused, face[refused]] *= -1.0
    at[chip, face[chip]] += NEAR_UM * np.sign(way[chip, face[chip]])
    return at, way, enters, {"substrate": lost, "receiver": kept}, landed


def _refracted(way: Real, axis: NDArray[np.intp], ratio: float) -> Real:
    """Directions beyond a face across `axis`, by Snell's law; where there is none, nonsense that is not used."""
    rows = np.arange(len(way))
    through = ratio * way
    through[rows, axis] = 0.0
    left = 1.0 - (through**2).sum(axis=1)
    through[rows, axis] = np.sign(way[rows, axis]) * np.sqrt(np.maximum(left, 0.0))
    return through


def _lobe(mirror: Real, sigma_rad: float, rng: np.random.Generator) -> Real:
    """Directions (n, 3) about those of the mirror: polar angle by Rayleigh, drawn again until above the surface."""
    found = np.zeros_like(mirror)
    left = np.arange(len(mirror))
    while left.size:
        axis = mirror[left]
        helper = np.where(np.abs(axis[:, :1]) < 0.6, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
        e = np.cross(axis, helper)
        e /= np.linalg.norm(e, axis=1)[:, None]
        f = np.cross(axis, e)
        theta, phi = rng.rayleigh(sigma_rad, left.size), rng.uniform(0.0, 2.0 * np.pi, left.size)
        tried = np.cos(theta)[:, None] * axis
        tried += np.sin(theta)[:, None] * (np.cos(phi)[:, None] * e + np.sin(phi)[:, None] * f)
        good = tried[:, 2] > 0.0
        found[left[good]] = tried[good]
        left = left[~good]
    return found
