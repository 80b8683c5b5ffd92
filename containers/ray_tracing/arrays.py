"""The one form in which kernels see a scene: numbers by name, surfaces, and tables of the emission and the chips."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from containers.ray_tracing.surfaces import Surfaces

Real = NDArray[np.float64]

TOP_IN, TOP_OUT, SIDE_IN, SIDE_OUT, BOTTOM, SUBSTRATE, RECEIVER, EDGE = range(8)
"""Rows of `Surfaces.layout`: faces of the chip from inside and outside, what lies below it, and the module's."""

(
    SPACING,
    DISTANCE,
    HALF_WIDTH,
    THICKNESS,
    ABSORPTION,
    ABSORPTION_RISE,
    TILT_X,
    TILT_Y,
    HALF_X,
    HALF_Y,
    ORIGIN_X,
    ORIGIN_Y,
    SPREAD_SHARE,
    SPREAD_SIGMA,
    LEAK_SHARE,
    LEAK_LENGTH,
    INDEX,
) = range(17)
"""Entries of `numbers`, the last one where the refractive indices begin: lengths in um, absorption in 1/um, tilt in
1/um, spread and leak as share and um."""

(
    PERIODIC,
    ROWS,
    COLUMNS,
    WALLS,
    UNFOLD,
    AIR_GAP,
    CLOSED,
    FROM_TOP,
    TOP_LOSSY,
    RESPONSE_AT,
    RESPONSE,
    OFFSETS_AT,
    CONES,
    SHUT,
    FLAGS,
) = range(15)
"""Entries of `flags`: a cell that repeats; chips of a finite array; specular walls at its edge; side faces that are
smooth and lossless, below a top that does not scatter; air below the chip; a chip bottom that neither absorbs nor
scatters; emission from the top face into air; a top face that takes light beyond its critical angle; where the
receiver's response begins in the tables and how many numbers it has; where the chips' displacements begin; a chip
whose light never changes |dx|, |dy|, |dz|, so that it is born inside the escape cones only; one with as
good a top and bottom, whose sides are so nearly smooth (`packing.NEARLY_SMOOTH`) that light which begins a walk
outside these cones stays inside."""


class SceneArrays(NamedTuple):
    """A scene as the kernels of the ray's way read it (`packing`); few arrays, since kernels hand them on."""

    numbers: Real
    """Lengths and so on (see above), then the refractive index of the chip at each wavelength."""
    flags: NDArray[np.int64]
    surfaces: Surfaces
    """With the receiver's response and the displacements of the chips at the end of its tables."""

    @property
    def parts(self) -> tuple[NDArray[Any], ...]:
        """All of it, one array after the other: what decides the way of a ray, for a digest."""
        return self.numbers, self.flags, self.surfaces.layout, self.surfaces.tables


class EmissionArrays(NamedTuple):
    """Where and whereto light is born."""

    wave_cumulative: Real
    """(wave,), cumulative weights of the wavelengths."""
    cosine_quantiles: Real
    """(q,), cos theta of the emission at equal steps of probability."""
    intensity: Real
    """(q,), share of the emission per solid angle at equal steps of cos theta, -1 to 1."""
    height_quantiles: Real
    """(q,), z / T of the emission at equal steps of probability."""
    row_cumulative: Real
    """(ny + 1,), emission by rows of the chip, cumulative."""
    column_cumulative: Real
    """(ny, nx + 1), and along each row."""
    chip_cumulative: Real
    """(chip,), cumulative powers."""
    centres_um: Real
    """(chip, 2), (x, y) of each chip."""


class Sinks(NamedTuple):
    """What the histories of one group leave behind."""

    bins: Real
    """(2, y, x): weights that arrived at the receiver, for the first time and later."""
    box: Real
    """(x0, y0, bins per um, folded, cell): where bins lie; folded: |x|, |y| are binned; cell: no light is beside."""
    ledger: Real
    """(end,), see `ENDS`."""
    arrivals: Real
    """(4,), weights by the paper's four optical events."""
    directions: Real
    """(2, cosine, azimuth): light that leaves chips, and light at its first arrival; 0 bins: not wanted."""


ENDS = ("chip", "substrate", "dbr", "receiver", "edge", "trapped", "roulette", "emitted")
CHIP_END, SUBSTRATE_END, DBR_END, RECEIVER_END, EDGE_END, TRAPPED_END, ROULETTE_END, EMITTED = range(8)
"""Entries of the ledger: emitted + roulette = the sum of all other ends."""

X, Y, Z, DX, DY, DZ, WEIGHT, EVENT, CHIP_X, CHIP_Y, RAY = range(11)
"""Entries of a ray: position (um), direction, weight, optical event so far, centre of the chip it is in or left."""

THROUGH_TOP, FROM_SIDES, AFTER_TOP, AFTER_RECEIVER = range(4)
"""The paper's optical events: through the DBR, directly from the sides, after the top, after the receiver."""

BOTTOM_HITS, PATH, LIFT, TOP_HITS, BORN_X, BORN_Y, TOP_COSINES, BEYOND, TRACE = 0, 1, 2, 3, 4, 5, 6, 10, 18
"""Entries of what a walk in a chip notes: bottom hits, path (um), the integral of 2 z / T - 1 along it (um),
reflections at the top inside the escape cone, where its light was born (um from the chip's centre), the cosines of
those reflections (the first four), and counts of reflections at the top beyond the critical angle, by cosine in equal
steps from 0 to that of this angle."""
