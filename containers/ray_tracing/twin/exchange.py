"""What a finite module's receiver sends back and gets again: the iteration of `closure` on a coarse grid.

    I <- rho_r w F^-1[T F(w (E0 + I))],  w = 1 inside the module

What comes up is as wide as twice the distance, so a grid of a third of the distance is enough; its waves are summed
where they are wanted. The kernels of mirror and Lambert's law are laid out in space, so that nothing comes round from
the other end of the grid; by what a lobe differs from a mirror is short, and is taken in waves. Light inside the
substrate (`Leak`) goes further, and has a wider grid of its own.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from containers.bsdf import Bsdf, Lambertian
from containers.ray_tracing.twin.closure import NO_LEAK, Leak, lambert, reaching, round_trip, ways_of
from containers.ray_tracing.twin.direct import dimmed, lambertian_part
from containers.ray_tracing.twin.grid import Complex, Grid
from containers.scene import Array, Receiver
from luxloop.errors import InputError

Real = NDArray[np.float64]

STEPS_PER_DISTANCE = 3.0
TOLERANCE = 1e-6
MOST_ITERATIONS = 200
BEYOND = 10.0
"""In distances: the empty part of a grid, at least; kernels of light that is recorded by its angle are in waves."""
LENGTHS = 7.0
"""Of a leak, the same; 0.7 % of what leaks comes out further away."""
MOST_CELLS = 4e6
"""Of a leak's grid: 32 MB for each of its arrays of waves."""

Waves = list[tuple[Grid, Complex]]
"""Of several grids, to be summed up together."""


def sum_up(waves: Waves, x_um: Real, y_um: Real) -> Real:
    """Waves summed at every crossing (y, x) of the places."""
    return np.asarray(sum(grid.sum_up(each, x_um, y_um) for grid, each in waves))


class Exchange:
    """Receiver and substrate of a finite module with open edges, facing each other.

    Parameters
    ----------
    lost : share of what a cell's chip keeps from coming up again, of all light sent back in a cell that repeats.
    leak : of the substrate, which goes on beyond the module's edge.

    Raises
    ------
    InputError : a leak so long beside the distance that its grid were too large.

    Notes
    -----
    A chip takes from the places that see it, by Lambert's law from the distance; all of an endless array take `lost`.
    """

    def __init__(
        self,
        layout: Array,
        substrate: Bsdf,
        receiver: Receiver,
        distance_um: float,
        lost: float = 0.0,
        leak: Leak = NO_LEAK,
    ) -> None:
        step = distance_um / STEPS_PER_DISTANCE
        self.layout, self.grid, self._leak = layout, Grid.of(layout, step, BEYOND * distance_um), leak
        self._kept = lambertian_part(receiver.bsdf)[0]
        self._returned = self._past_chips(distance_um, lost)
        stays, x = dimmed(substrate, 1.0 - leak.share), self.grid.k_per_um * distance_um
        ways = ways_of(stays)
        self._diffuse = sum(share for kind, _, share in ways if kind is Lambertian)
        direct = sum(share for kind, _, share in ways if kind is not Lambertian)
        all_of_it = round_trip(stays, receiver, x)
        in_waves = all_of_it - direct * lambert(2.0 * x) - self._diffuse * lambert(x) ** 2
        self._straight = direct * self._by_lambert(2.0 * distance_um) + in_waves
        self._down = self._by_lambert(distance_um)
        plain = bool(np.all(receiver.response == 1.0))
        self._more_recorded = 0.0 if plain else round_trip(stays, receiver, x, recorded=True) - all_of_it
        if leak.share:
            self.wide = Grid.of(layout, step, (BEYOND + LENGTHS * leak.length) * distance_um)
            if (cells := int(np.prod(self.wide.padded))) > MOST_CELLS:
                longest = f"a length whose grid has up to {MOST_CELLS:g} cells, here {cells:g}"
                raise InputError("leak_um", round(leak.length * distance_um), longest, "use Monte Carlo")
            wide = self.wide.k_per_um * distance_um
            self._comes_up, self._is_recorded = leak.comes_up(wide, substrate, receiver)
            self._reaches = self._down + reaching(stays, receiver, x)

    def solve(self, direct: Real, leaked: Complex | None = None) -> Waves:
        """Waves of all light beside direct light, which is given (y, x) at the grid's centres.

        leaked : waves of the `wide` grid, of the direct light that goes on inside the substrate (`Grid.laid`).

        Raises
        ------
        InputError where the iteration does not settle to 1e-6 of the largest value within 200 steps.
        """
        if leaked is not None:
            direct = direct + self.wide.on_module(leaked * self._comes_up)
        again, largest = np.zeros_like(direct), float(np.abs(direct).max())
        for _ in range(MOST_ITERATIONS):
            sent = self.grid.waves(self._returned * (direct + again)) * self._kept
            waves = sent * self._straight
            if self._diffuse:
                on_substrate = self.grid.on_module(sent * self._down)
                waves = waves + self._diffuse * self.grid.waves(on_substrate) * self._down
            before, again = again, self.grid.on_module(waves)
            if self._leak.share:
                leaks = self._leak.share * self.wide.waves(self.grid.on_module(sent * self._reaches))
                again = again + self.wide.on_module(leaks * self._comes_up)
            if float(np.abs(again - before).max()) <= TOLERANCE * largest:
                found = [(self.grid, waves + self._more_recorded * sent)]
                if self._leak.share:
                    found += [(self.wide, (leaks if leaked is None else leaked + leaks) * self._is_recorded)]
                return found
        raise InputError("receiver", self._kept, "less light sent back and forth", "the iteration does not settle")

    @property
    def least_returned(self) -> float:
        """The least of what comes up again of the light sent back anywhere, beside all without chips.

        Below 0 the chips, to which each is a point, take more than there is.
        """
        return float(self._returned.min())

    def _past_chips(self, height_um: float, lost: float) -> Real:
        """What of the light sent back at each cell of the grid comes up again as if there were no chips."""
        returned = np.ones(self.grid.shape)
        if lost:
            x, y = self.grid.centres_um
            for cx, cy in self.layout.centres_um.reshape(-1, 2):
                r2 = np.add.outer((y - cy) ** 2, (x - cx) ** 2)
                returned -= lost * self.layout.spacing_um**2 * height_um**2 / (np.pi * (r2 + height_um**2) ** 2)
        return returned

    def _by_lambert(self, height_um: float) -> Real:
        """Transform of h^2 / (pi (r^2 + h^2)^2) as it lies on the grid."""
        return self.grid.kernel(height_um**2 / (np.pi * (self.grid.r2_um2 + height_um**2) ** 2))
