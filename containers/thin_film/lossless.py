"""Reflectance of families of smooth, lossless stacks: stacks that are the outer part of another share its sweep.

Seen from the outside, a stack that grows inwards changes one vector (B, C), the tangential fields at its inner face:

    (B, C) <- [[cos d, i sin d / y], [i y sin d, cos d]] (B, C),      start (1, y_outside)
    T = 4 y_inside y_outside / |y_inside B + C|^2,      R = 1 - T

so one sweep over the layers of the largest stack gives all the smaller ones on the way. Without absorption cos d,
y sin d and sin d / y are real (also where the layer is evanescent: cosh and sinh), hence Re B and Im C form one real
chain and Im B and Re C another. s and p share the phase d, and so do all layers of one kind (index and thickness):
a DBR costs two sines and two cosines per angle and wavelength. Where u reaches the index of either half space, R = 1.

R and T are those of light from either side at the same u. Source: the characteristic matrix of Abeles (Born and Wolf,
section 1.6); sharing the sweep is ours. The general kernel (`transfer_matrix`) gives the same to 1e-12.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from containers.compiled import kernel
from containers.stack import ALN, GAN, LayerOrder, StackRows, dbr_layers
from luxloop.errors import InputError

Real = NDArray[np.float64]
Integers = NDArray[np.int64]

MAX_DECAY = 300.0
"""Largest sum of Im(kz) k0 d over a stack, so that cosh and sinh do not overflow; beyond it: the general kernel."""

_BLOCK = 256  # points worked on at a time: their vectors stay in the first-level cache


def family_reflectance(
    inside: ArrayLike,
    outside: ArrayLike,
    kind_index: ArrayLike,
    kind_thickness_nm: ArrayLike,
    stacks: Sequence[Sequence[int]],
    wavelength_nm: ArrayLike,
    u: ArrayLike,
) -> Real:
    """R of smooth, lossless stacks from either side: (stack, wavelength, polarisation, u), polarisation s, p.

    Parameters
    ----------
    inside, outside : (wavelength,) or one number, real index of the half spaces.
    kind_index : (wavelength, kind) or (kind,), real index of each kind of layer.
    kind_thickness_nm : (kind,), thickness of each kind of layer.
    stacks : for each stack the kinds of its layers from the inside outwards; any lengths, 0 included.
    wavelength_nm : (wavelength,), in vacuum.
    u : (U,) or (wavelength, U), k_parallel / k0 >= 0.

    Raises
    ------
    InputError where an evanescent layer is too thick for this kernel (`MAX_DECAY`).

    Notes
    -----
    T = 1 - R. Equations and source: at the head of this module.
    """
    # copies: a read-only array would be another type to compile for
    wavelength, d = np.array(wavelength_nm, float), np.array(kind_thickness_nm, float)
    n = np.array(np.broadcast_to(np.asarray(kind_index, float), (wavelength.size, d.size)), order="C")
    ends = np.empty((wavelength.size, 2))
    ends[:, 0], ends[:, 1] = inside, outside
    nodes = np.array(np.broadcast_to(np.asarray(u, float), (wavelength.size, np.shape(u)[-1])), order="C")
    sequence, row, of_stack = _shared_sweeps(stacks)
    highest = np.minimum(nodes.max(axis=1), ends.min(axis=1))
    sweeps = [kinds[kinds >= 0] for kinds in sequence]
    if any(_decay(n[:, kinds], d[kinds], wavelength, highest) > MAX_DECAY for kinds in sweeps):
        raise InputError("kind_thickness_nm", float(d.max()), "thinner evanescent layers", "use the general kernel")
    R = np.ones((len(row[row >= 0]), wavelength.size, 2, nodes.shape[1]))
    _sweep(ends, n, d, sequence, row, wavelength, nodes, R)
    return R if of_stack == list(range(len(R))) else R[of_stack]


def dbr_reflectance(
    dbr_pairs: Sequence[float],
    wavelength_nm: ArrayLike,
    u: ArrayLike,
    *,
    n_gan: ArrayLike,
    n_aln: ArrayLike,
    gan_layer_nm: float,
    aln_layer_nm: float,
    layer_order: LayerOrder = "gan_first",
    n_outside: ArrayLike = 1.0,
) -> Real:
    """R of smooth, lossless DBRs on GaN, all pair counts at once, from either side: (pairs, wavelength, s p, u).

    Indices are real, (wavelength,) or one number; thicknesses in nm; u = k_parallel / k0, (U,) or (wavelength, U).
    Two sweeps (one for each material that may be outermost) give every count. T = 1 - R.
    """
    stacks = [dbr_layers(pairs, layer_order) for pairs in dbr_pairs]
    kinds = np.empty((np.size(wavelength_nm), 2))
    kinds[:, GAN], kinds[:, ALN] = n_gan, n_aln
    return family_reflectance(n_gan, n_outside, kinds, [gan_layer_nm, aln_layer_nm], stacks, wavelength_nm, u)


def applies(rows: StackRows) -> bool:
    """Whether this kernel may be used: no absorption, no roughness, coherent, no thick evanescent layer."""
    n = rows.index.real
    highest = np.minimum(n[:, 0], n[:, -1])
    return rows.lossless and _decay(n[:, 1:-1], rows.thickness_nm, rows.wavelength_nm, highest) <= MAX_DECAY


def stack_reflectance(rows: StackRows, u: ArrayLike) -> Real:
    """R of one smooth, lossless stack from either side: (wavelength, polarisation, u); ask `applies` first."""
    n, d = rows.index.real, rows.thickness_nm
    columns = [(n[:, j + 1].tobytes(), float(d[j])) for j in range(d.size)]
    kinds = {column: columns.index(column) for column in columns}
    first = sorted(kinds.values())
    stack = [first.index(kinds[column]) for column in columns]
    layers = [j + 1 for j in first]
    R = family_reflectance(n[:, 0], n[:, -1], n[:, layers], d[first], [stack], rows.wavelength_nm, u)
    return R.reshape(R.shape[1:])


def _shared_sweeps(stacks: Sequence[Sequence[int]]) -> tuple[Integers, Integers, list[int]]:
    """Kinds of each sweep from the outside inwards, the row it fills after k layers (-1: none), each stack's row."""
    outwards = [tuple(reversed(stack)) for stack in stacks]
    sweeps: list[tuple[int, ...]] = []
    for stack in sorted(set(outwards), key=len, reverse=True):
        if not any(sweep[: len(stack)] == stack for sweep in sweeps):
            sweeps.append(stack)
    longest = max((len(sweep) for sweep in sweeps), default=0)
    sequence, row = np.full((len(sweeps), longest), -1), np.full((len(sweeps), longest + 1), -1)
    for s, sweep in enumerate(sweeps):
        sequence[s, : len(sweep)] = sweep
    row_of: dict[tuple[int, ...], int] = {}
    for stack in outwards:
        if stack not in row_of:
            row_of[stack] = len(row_of)
            s = next(s for s, sweep in enumerate(sweeps) if sweep[: len(stack)] == stack)
            row[s, len(stack)] = row_of[stack]
    return sequence, row, [row_of[stack] for stack in outwards]


def _decay(n: Real, d: Real, wavelength: Real, highest: Real) -> float:
    """Largest sum of Im(kz) k0 d of layers at the highest u (wavelength,) that propagates on both sides."""
    if not d.size or (n.min(axis=1) >= highest).all():
        return 0.0
    kappa = np.sqrt(np.maximum(highest[:, None] ** 2 - n**2, 0.0))
    return float((2 * np.pi / wavelength * (kappa @ d)).max())


@kernel
def _sweep(
    ends: Real, n: Real, d: Real, sequence: Integers, row: Integers, wavelength: Real, u: Real, R: Real
) -> None:
    """Fill `R` where light propagates in both half spaces, block by block."""
    at_w, at_i = np.empty(_BLOCK, np.int64), np.empty(_BLOCK, np.int64)
    filled = 0
    for w in range(wavelength.size):
        for i in range(u.shape[1]):
            if u[w, i] < ends[w, 0] and u[w, i] < ends[w, 1]:
                at_w[filled], at_i[filled] = w, i
                filled += 1
            if filled == _BLOCK:
                _block(ends, n, d, sequence, row, wavelength, u, at_w, at_i, R)
                filled = 0
    if filled:
        _block(ends, n, d, sequence, row, wavelength, u, at_w[:filled], at_i[:filled], R)


@kernel
def _block(
    ends: Real,
    n: Real,
    d: Real,
    sequence: Integers,
    row: Integers,
    wavelength: Real,
    u: Real,
    at_w: Integers,
    at_i: Integers,
    R: Real,
) -> None:
    """All sweeps for a block of (wavelength, u) points, s and p."""
    kinds, points = d.size, at_w.size
    cos, over_y, times_y = np.empty((kinds, points)), np.empty((kinds, points)), np.empty((kinds, points))
    for j in range(kinds):
        for x in range(points):
            w = at_w[x]
            kz2 = n[w, j] ** 2 - u[w, at_i[x]] ** 2
            cos[j, x], over_y[j, x] = _phase(kz2, 2.0 * np.pi / wavelength[w] * d[j])
            times_y[j, x] = over_y[j, x] * kz2
    y_in, y_out, R_here = np.empty(points), np.empty(points), np.empty(points)
    for p in range(2):
        _admittance(p, ends[:, 0], u, at_w, at_i, y_in)
        _admittance(p, ends[:, 1], u, at_w, at_i, y_out)
        for j in range(kinds if p else 0):
            _from_s_to_p(n[:, j], at_w, over_y[j], times_y[j])
        for s in range(sequence.shape[0]):
            B_re, B_im, C_re, C_im = np.ones(points), np.zeros(points), y_out.copy(), np.zeros(points)
            for k in range(row.shape[1]):
                if row[s, k] >= 0:
                    _reflectance(y_in, y_out, B_re, B_im, C_re, C_im, R_here)
                    for x in range(points):
                        R[row[s, k], at_w[x], p, at_i[x]] = R_here[x]
                if k < sequence.shape[1] and sequence[s, k] >= 0:
                    j = sequence[s, k]
                    _layer(cos[j], over_y[j], times_y[j], B_re, B_im, C_re, C_im)


@kernel
def _admittance(p: int, n: Real, u: Real, at_w: Integers, at_i: Integers, y: Real) -> None:
    """Fill y = kz (s) or kz / n^2 (p) of a half space."""
    for x in range(y.size):
        n2 = n[at_w[x]] ** 2
        y[x] = np.sqrt(n2 - u[at_w[x], at_i[x]] ** 2) / (n2 if p else 1.0)


@kernel
def _from_s_to_p(n: Real, at_w: Integers, over_y: Real, times_y: Real) -> None:
    """Change y = kz into y = kz / n^2 in the terms of a layer."""
    for x in range(at_w.size):
        n2 = n[at_w[x]] ** 2
        over_y[x] *= n2
        times_y[x] /= n2


@kernel
def _phase(kz2: float, k0_d: float) -> tuple[float, float]:
    """cos(kz k0 d) and sin(kz k0 d) / kz, kz^2 of either sign."""
    kz = np.sqrt(abs(kz2))
    if kz * k0_d < 1e-8:
        return 1.0, k0_d
    if kz2 > 0.0:
        return np.cos(kz * k0_d), np.sin(kz * k0_d) / kz
    return np.cosh(kz * k0_d), np.sinh(kz * k0_d) / kz


@kernel
def _layer(cos: Real, over_y: Real, times_y: Real, B_re: Real, B_im: Real, C_re: Real, C_im: Real) -> None:
    """Take the fields through one layer inwards: cos d, sin d / y and y sin d of every point."""
    for x in range(cos.size):
        b, c = B_re[x], C_im[x]
        B_re[x], C_im[x] = b * cos[x] - over_y[x] * c, c * cos[x] + times_y[x] * b
        b, c = B_im[x], C_re[x]
        B_im[x], C_re[x] = b * cos[x] + over_y[x] * c, c * cos[x] - times_y[x] * b


@kernel
def _reflectance(y_in: Real, y_out: Real, B_re: Real, B_im: Real, C_re: Real, C_im: Real, R: Real) -> None:
    """R = 1 - T, the same for light from either side."""
    for x in range(R.size):
        re, im = y_in[x] * B_re[x] + C_re[x], y_in[x] * B_im[x] + C_im[x]
        R[x] = 1.0 - 4.0 * y_in[x] * y_out[x] / (re * re + im * im)
