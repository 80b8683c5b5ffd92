"""Angles for programs that interpolate linearly in the angle: few where a film is smooth, many where it turns.

A film's powers rise as a square root at the critical angle of every wavelength, so equal steps in angle err by 0.3
there. Here intervals are quartered until all values are linear within half the tolerance; what is then there in
excess is thinned out, again within half of it. `worst_between` measures what remains, at other angles than these.

Powers at an angle are computed from the table's stack, not interpolated in its nodes: at its own angles a file or a
surface has no error at all.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from containers.stack import resolve
from containers.thin_film import lossless
from containers.thin_film.table import FilmTable, Powers, Side
from containers.thin_film.transfer_matrix import solve

Real = NDArray[np.float64]
Values = Callable[[Real], Real]
"""(k, angle) of angles (angle,): all that is to be interpolated."""

NARROWEST_RAD = 1e-8
_QUARTERS = np.array([0.25, 0.5, 0.75])
FIFTHS = np.array([0.2, 0.4, 0.6, 0.8])  # no quarters: what is measured is to see other angles than `_refined`
_BLOCK = 100_000  # wavelengths x angles computed at a time


def powers_at(table: FilmTable, side: Side, theta_rad: Real) -> Powers:
    """Powers of the table's stack, each (wavelength, polarisation, angle), computed at angles (angle,)."""
    return _powers(table, side, theta_rad, (side,))[0]


def powers_of_both(table: FilmTable, side: Side, theta_rad: Real) -> tuple[Powers, Powers]:
    """The same, and those of light from the other side at the angles where such light goes on; beyond the critical
    angle, where there is none, its R reads 1."""
    here, there = _powers(table, side, theta_rad, (side, "outside" if side == "inside" else "inside"))
    return here, there


def _powers(table: FilmTable, side: Side, theta_rad: Real, sides: Sequence[Side]) -> list[Powers]:
    """Of light from `sides` at u = n sin(theta), n that of `side`."""
    rows = resolve(table.stack, table.wavelength_nm)
    index = rows.index.copy()
    index[:, 0], index[:, -1] = table.n_inside, table.n_outside  # a table takes half spaces without their k
    rows = replace(rows, index=index)
    n, _ = indices(table, side)
    u = n[:, None] * np.sin(theta_rad)
    if lossless.applies(rows):
        R = lossless.stack_reflectance(rows, u)
        return [Powers(R, 1.0 - R, *np.zeros((3, *R.shape)))] * len(sides)
    held = np.empty((len(sides), len(Powers._fields), n.size, 2, theta_rad.size))
    width = max(1, _BLOCK // n.size)
    for part in (slice(a, a + width) for a in range(0, theta_rad.size, width)):
        found = solve(rows.index, rows.thickness_nm, rows.roughness_nm, rows.wavelength_nm, u[:, part])
        held[..., part] = [[getattr(found, f"{name}_{one}") for name in Powers._fields] for one in sides]
    return [Powers(*one) for one in held]


def indices(table: FilmTable, side: Side) -> tuple[Real, Real]:
    """Index (wavelength,) of the half space that the light comes from, and of the other one."""
    return (table.n_inside, table.n_outside) if side == "inside" else (table.n_outside, table.n_inside)


def start_angles(table: FilmTable, side: Side) -> Real:
    """The table's own nodes as angles at the peak of the line, and the critical angle of every wavelength."""
    n_in, n_out = indices(table, side)
    own = table.u[: table.nodes(side)] / n_in[int(np.argmax(table.weight))]
    sines = np.concatenate([[0.0, 1.0], own, n_out / n_in])
    angle = np.unique(np.arcsin(sines[sines <= 1.0]))
    return np.asarray(angle[np.append(np.diff(angle) > NARROWEST_RAD, True)])


def linear_nodes(values: Values, start: Real, tolerance: float, most: int, weight: Values | None = None) -> Real:
    """Angles (rad, increasing, ends of `start` included) between which all values are linear within `tolerance`.

    Parameters
    ----------
    values : (k, angle) of angles (angle,) in rad.
    start : (m,) increasing angles, dense enough that a quarter of an interval does not hide a dip.
    tolerance : largest deviation from linear between two angles.
    most : where these do not suffice, that many angles, put where the deviation is largest.
    weight : (k, angle) of angles (angle,), what a deviation is multiplied by before it is compared; default 1.
    """
    weight = weight or _one
    angle, value = _refined(values, start, tolerance / 2.0, 12 * most, weight)
    counts = weight(angle)
    chosen = np.zeros(angle.size, bool)
    chosen[[0, -1]] = True
    while (room := most - int(chosen.sum())) > 0:
        line = np.stack([np.interp(angle, angle[chosen], row[chosen]) for row in value])
        deviation = (np.abs(value - line) * counts).max(axis=0)
        ends = np.flatnonzero(chosen)
        worst = np.array([a + int(deviation[a:b].argmax()) for a, b in pairwise(ends)])
        worst = worst[deviation[worst] > tolerance / 2.0]
        if not worst.size:
            break
        chosen[worst[np.argsort(-deviation[worst])][:room]] = True
    return angle[chosen]


def worst_between(values: Values, nodes: Real) -> Real:
    """(k,), largest deviation of each value from linear between nodes (angle,); outside them the ends are held."""
    inside = (nodes[:-1, None] + np.diff(nodes)[:, None] * FIFTHS).ravel()
    ends = [np.linspace(a, b, 101) for a, b in ((0.0, nodes[0]), (nodes[-1], np.pi / 2)) if b > a]
    between = np.concatenate([inside, *ends])
    exact, held = values(between), values(nodes)
    lines = np.stack([np.interp(between, nodes, row) for row in held])
    return np.asarray(np.abs(exact - lines).max(axis=1, initial=0.0))


def _one(theta: Real) -> Real:
    return np.ones((1, theta.size))


def _refined(values: Values, start: Real, tolerance: float, most: int, weight: Values) -> tuple[Real, Real]:
    """`start` and what was put between, with the values: intervals quartered until the quarters are on a line."""
    angle, value = start, values(start)
    opened = np.ones(angle.size - 1, bool)
    while opened.any() and angle.size < most:
        at = np.flatnonzero(opened)
        between = angle[at, None] + (angle[at + 1] - angle[at])[:, None] * _QUARTERS
        found = values(between.ravel())
        line = value[:, at, None] + (value[:, at + 1] - value[:, at])[..., None] * _QUARTERS
        deviation = np.abs(found.reshape(line.shape) - line) * weight(between.ravel()).reshape(-1, *between.shape)
        bent = deviation.max(axis=(0, 2)) > tolerance
        bent &= angle[at + 1] - angle[at] > NARROWEST_RAD
        opened = np.zeros(angle.size, bool)
        opened[at] = bent
        angle = np.concatenate([angle, between.ravel()])
        order = np.argsort(angle, kind="stable")
        angle = angle[order]
        value = np.concatenate([value, found], axis=1)[:, order]
        opened = np.concatenate([opened, np.repeat(bent, 3)])[order][:-1]
    return angle, value
