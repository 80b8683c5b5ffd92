"""What a ray does at a surface, as kernels: any `Bsdf` packed into shares of parts, drawn exactly.

A surface is a list of parts (mirror, refracted, Lambert, lobe, table, facets). Against the place of incidence it
holds the cumulative shares of the parts; the last one is the albedo, the rest is absorbed. One uniform chooses the
part, two or three more the direction. `packing` makes the arrays; the frame is that of `containers.bsdf.surface`:
normal +z on the side the light comes from, but here the incoming direction points INTO the surface, as a ray does.

Nodes lie where powers are smooth, for u = n_in sin(theta_in):

    u < 1     uniform in sqrt(1 - u^2), the cosine on the air side          (nodes of them)
    u >= 1    uniform in sqrt((u^2 - 1) / (n_in^2 - 1))                     (as many again, inside a chip only)
"""

from __future__ import annotations

from math import cos, pi, sin, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from containers.compiled import borrowing_kernel, inlined_kernel
from containers.ray_tracing.facet_kernel import MOST_HITS, meet_facet, unmasked
from containers.ray_tracing.philox import Stream, draw
from containers.ray_tracing.quick import cos_sin_turn, cos_sinc, minus_log

ABSORBED, REFLECTED, TRANSMITTED = range(3)
"""What became of a ray at a surface."""
MIRROR, REFRACTED, LAMBERT, LAMBERT_THROUGH, LOBE, TABLE, FACETS = range(7)
"""Kinds of parts."""
PARTS, NODES, STRIDE, AT, BEYOND, FLAT, SIGMA_AT, CELLS_AT, KIND = range(9)
"""Columns of `layout` (STRIDE: from one wavelength to the next, 0 for all the same); from KIND on follow the
kinds of up to `MOST_PARTS` parts."""
MOST_PARTS = 6
ROWS, RINGS, SECTORS, IMAGES = range(4)
"""The head of a table of cells, followed by angles and powers of rows, sin^2 of rings, hemisphere of rings, phi of
sectors, and for each row the cumulative powers of its cells (a leading 0, the last 1)."""
MOST_ATTEMPTS = 1 << 20


class Surfaces(NamedTuple):
    """All surfaces of a scene."""

    layout: NDArray[np.int64]
    """(surface, column)"""
    tables: NDArray[np.float64]
    """Everything else, one after the other."""


@inlined_kernel
def node_of(surfaces: Surfaces, s: int, wave: int, u2: float, n2: float) -> tuple[int, float]:
    """Where the shares begin in `tables`, and the fraction of the way to the next node, for u^2 and n_in^2."""
    row = surfaces.layout[s]
    nodes = row[NODES]
    at = row[AT] + wave * row[STRIDE]
    if row[FLAT]:
        return at, 0.0
    if u2 < 1.0:
        place = sqrt(1.0 - u2) * (nodes - 1)
        node = min(int(place), nodes - 2)
        return at + node * row[PARTS], place - node
    if not row[BEYOND]:
        return at, 0.0
    place = sqrt(min((u2 - 1.0) / (n2 - 1.0), 1.0)) * (nodes - 1)
    node = min(int(place), nodes - 2)
    return at + (nodes + node) * row[PARTS], place - node


@inlined_kernel
def share(surfaces: Surfaces, s: int, at: int, above: float, part: int) -> float:
    """Cumulative share up to a part, at a place of `node_of`."""
    here: float = surfaces.tables[at + part]
    if above == 0.0:
        return here
    return float(here + above * (surfaces.tables[at + surfaces.layout[s, PARTS] + part] - here))


@borrowing_kernel
def scatter(
    surfaces: Surfaces,
    s: int,
    wave: int,
    n_in: float,
    n_out: float,
    x: float,
    y: float,
    z: float,
    stream: Stream,
    kind: int,
    scale: float = 1.0,
) -> tuple[int, float, float, float]:
    """What becomes of a ray with direction (x, y, z < 0) in surface space, and where it goes.

    `n_in`, `n_out` are 1 for an opaque surface. Draws the numbers of the current event of `kind`. It goes on with
    probability albedo / `scale`.
    """
    at, above = node_of(surfaces, s, wave, n_in * n_in * max(0.0, 1.0 - z * z), n_in * n_in)
    a, b, c, d = draw(stream, kind, 0)
    a *= scale
    parts = surfaces.layout[s, PARTS]
    part, below, until = 0, 0.0, share(surfaces, s, at, above, 0)
    while a >= until:
        part += 1
        if part == parts:
            return ABSORBED, 0.0, 0.0, 0.0
        below, until = until, share(surfaces, s, at, above, part)
    chosen = surfaces.layout[s, KIND + part]
    if chosen == MIRROR:
        return REFLECTED, x, y, -z
    if chosen == REFRACTED:
        ratio = n_in / n_out
        cosine2 = 1.0 - ratio * ratio * (1.0 - z * z)
        if cosine2 <= 0.0:
            return REFLECTED, x, y, -z
        return TRANSMITTED, ratio * x, ratio * y, -sqrt(cosine2)
    if chosen == LOBE:
        sigma = surfaces.tables[surfaces.layout[s, SIGMA_AT] + part]
        x, y, z = lobe(sigma, x, y, -z, b, c, stream, kind)
        return REFLECTED, x, y, z
    if chosen == TABLE:
        return from_table(surfaces, surfaces.layout[s, CELLS_AT], x, y, z, (a - below) / (until - below), b, c, d)
    if chosen == FACETS:
        return from_facets(surfaces.tables[surfaces.layout[s, SIGMA_AT] + part], n_in, n_out, x, y, z, stream, kind)
    across, along = cos_sin_turn(c)
    sine = sqrt(b)
    if chosen == LAMBERT:
        return REFLECTED, sine * across, sine * along, sqrt(1.0 - b)
    return TRANSMITTED, sine * across, sine * along, -sqrt(1.0 - b)


@borrowing_kernel
def lobe(
    sigma: float, x: float, y: float, z: float, u: float, v: float, stream: Stream, kind: int
) -> tuple[float, float, float]:
    """A direction about the mirror direction (x, y, z >= 0): the Gaussian lobe, drawn again until it is above."""
    a = 1.0 / (1.0 + z)
    xy = -x * y * a
    for attempt in range(1, MOST_ATTEMPTS):
        theta2 = 2.0 * sigma * sigma * minus_log(u)
        if theta2 <= pi * pi:
            across, aside = cos_sin_turn(v)
            along, sinc = cos_sinc(theta2)
            sine = sqrt(theta2) * sinc
            p, q = sine * across, sine * aside
            up = along * z - p * x - q * y
            if up > 0.0:
                return along * x + p * (1.0 - x * x * a) + q * xy, along * y + p * xy + q * (1.0 - y * y * a), up
        u, v, _, _ = draw(stream, kind, attempt)
    return x, y, z


@borrowing_kernel
def from_facets(
    deviation: float, n_in: float, n_out: float, x: float, y: float, z: float, stream: Stream, kind: int
) -> tuple[int, float, float, float]:
    """From facet to facet of a rough clear face until the ray leaves; `deviation` is that of slopes along an axis."""
    through = False
    for hit in range(1, MOST_HITS):
        a, b, c, d = draw(stream, kind, hit)
        if through:
            crossed, x, y, z = meet_facet(n_out, n_in, deviation, x, y, z, a, b, c)
        else:
            crossed, x, y, z = meet_facet(n_in, n_out, deviation, x, y, z, a, b, c)
        if crossed:
            through, z = not through, -z
        if z > 0.0 and d < unmasked(z, deviation):
            break
    length = 1.0 / sqrt(x * x + y * y + z * z)
    x, y, z = x * length, y * length, abs(z) * length
    if through:
        return TRANSMITTED, x, y, -z
    return REFLECTED, x, y, z


@borrowing_kernel
def from_table(
    surfaces: Surfaces, at: int, x: float, y: float, z: float, a: float, b: float, c: float, d: float
) -> tuple[int, float, float, float]:
    """A direction out of a table of cells: a chooses the row of incidence, b the cell and its theta, c the phi."""
    t = surfaces.tables
    rows, rings, sectors, images = int(t[at]), int(t[at + 1]), int(t[at + 2]), int(t[at + 3])
    angles = at + 4
    totals = angles + rows
    squares = totals + rows
    uppers = squares + rings + 1
    edges = uppers + rings
    cells = edges + sectors + 1
    theta = np.arccos(min(1.0, -z))
    row = _below(t, angles, rows, theta)
    if row < rows - 1 and theta > t[angles + row]:
        above = (theta - t[angles + row]) / (t[angles + row + 1] - t[angles + row])
        here, there = (1.0 - above) * t[totals + row], above * t[totals + row + 1]
        if a * (here + there) < there:
            row += 1
    powers = cells + row * (rings * sectors + 1)
    cell = _below(t, powers, rings * sectors + 1, b)
    cell = min(cell, rings * sectors - 1)
    left = (b - t[powers + cell]) / (t[powers + cell + 1] - t[powers + cell])
    ring, sector = cell // sectors, cell % sectors
    square = t[squares + ring] + left * (t[squares + ring + 1] - t[squares + ring])
    sine, cosine = sqrt(square), sqrt(1.0 - square)
    phi = t[edges + sector] + c * (t[edges + sector + 1] - t[edges + sector])
    if images == 2 and d < 0.5:
        phi = -phi
    across, aside = sine * cos(phi), sine * sin(phi)
    flat = sqrt(x * x + y * y)
    ex, ey = (x / flat, y / flat) if flat > 0.0 else (1.0, 0.0)
    out_x, out_y = across * ex - aside * ey, across * ey + aside * ex
    if t[uppers + ring] > 0.0:
        return REFLECTED, out_x, out_y, cosine
    return TRANSMITTED, out_x, out_y, -cosine


@inlined_kernel
def _below(t: NDArray[np.float64], first: int, count: int, value: float) -> int:
    """Number of the last of `count` increasing entries that is not above `value`; 0 where all are."""
    low, high = 0, count
    while high - low > 1:
        middle = (low + high) // 2
        if t[first + middle] <= value:
            low = middle
        else:
            high = middle
    return low


@inlined_kernel
def albedo(surfaces: Surfaces, s: int, wave: int, cosine: float) -> float:
    """Share of light that an opaque surface sends back."""
    at, above = node_of(surfaces, s, wave, max(0.0, 1.0 - cosine * cosine), 1.0)
    return share(surfaces, s, at, above, surfaces.layout[s, PARTS] - 1)


@inlined_kernel
def plain_lobe(surfaces: Surfaces, s: int) -> tuple[float, float]:
    """sigma and reflectance of a surface that is one Gaussian lobe and nothing else; sigma 0: it is not."""
    row = surfaces.layout[s]
    if row[PARTS] == 1 and row[FLAT] and row[KIND] == LOBE:
        return surfaces.tables[row[SIGMA_AT]], surfaces.tables[row[AT]]
    return 0.0, 0.0
