"""What a finite module's receiver sends back and gets again: the iteration of `closure` on a coarse grid.

    I <- rho_r w F^-1[T F(w (E0 + I))],  w = 1 inside the module

What comes up is as wide as twice the distance, so a grid of a fifth of the distance is enough; its waves are summed
where they are wanted. The kernels of mirror and Lambert's law are laid out in space, so that nothing comes round from
the other end of the grid; by what a lobe differs from a mirror is short, and is taken in waves.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from containers.bsdf import Bsdf, Lambertian
from containers.ray_tracing.twin.closure import Leak, lambert, leaking, round_trip, ways_of
from containers.ray_tracing.twin.direct import lambertian_part
from containers.scene import Array, Receiver
from luxloop.errors import InputError

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]

STEPS_PER_DISTANCE = 3.0
TOLERANCE = 1e-6
MOST_ITERATIONS = 200
NO_LEAK = Leak()


class Exchange:
    """Receiver and substrate of a finite module with open edges, facing each other.

    Parameters
    ----------
    lost : share of what a cell's chip keeps from coming up again, of all light sent back in a cell that repeats.
    leak : of the substrate, which goes on beyond the module's edge.

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
        halves = layout.half_y_um, layout.half_x_um
        self._shape = tuple(int(np.ceil(2.0 * half * STEPS_PER_DISTANCE / distance_um)) for half in halves)
        self._step = tuple(2.0 * half / count for half, count in zip(halves, self._shape, strict=True))
        self._padded = tuple(2 * count for count in self._shape)
        ky, kx = (2.0 * np.pi * np.fft.fftfreq(n, step) for n, step in zip(self._padded, self._step, strict=True))
        self._k = np.hypot(ky[:, None], kx[: self._padded[1] // 2 + 1])
        self._kept = lambertian_part(receiver.bsdf)[0]
        self._returned = self._past_chips(layout, distance_um, lost)
        ways, x = ways_of(substrate), self._k * distance_um
        self._leak, self._displaced = leak.share, leak.displaced(x)
        diffuse = sum(share for kind, _, share in ways if kind is Lambertian)
        direct = sum(share for kind, _, share in ways if kind is not Lambertian)
        all_of_it = round_trip(substrate, receiver, x)
        in_waves = all_of_it - direct * lambert(2.0 * x) - diffuse * lambert(x) ** 2
        self._straight = (1.0 - leak.share) * (direct * self._by_lambert(2.0 * distance_um) + in_waves)
        self._diffuse, self._down = (1.0 - leak.share) * diffuse, self._by_lambert(distance_um)
        plain = bool(np.all(receiver.response == 1.0))
        seen = all_of_it if plain else round_trip(substrate, receiver, x, recorded=True)
        trips = (leaking(T, leak, receiver, x, recorded=T is seen) for T in (seen, all_of_it))
        self._more_recorded = 0.0 if plain else np.subtract(*trips)

    @property
    def centres_um(self) -> tuple[Real, Real]:
        """x and y of the grid's cells, from edge to edge of the module."""
        y, x = (np.asarray((np.arange(n) - (n - 1) / 2.0) * d) for n, d in zip(self._shape, self._step, strict=True))
        return x, y

    def solve(self, direct: Real) -> Complex:
        """Waves of the light that comes again, for direct light (y, x) at the grid's centres.

        Raises
        ------
        InputError where the iteration does not settle to 1e-6 of the largest value within 200 steps.
        """
        again, largest = np.zeros_like(direct), float(np.abs(direct).max())
        for _ in range(MOST_ITERATIONS):
            waves = self._once(direct + again)
            before, again = again, self._inside(waves)
            if float(np.abs(again - before).max()) <= TOLERANCE * largest:
                sent = np.fft.rfft2(self._returned * (direct + again), self._padded)
                return np.asarray(waves + self._kept * self._more_recorded * sent)
        raise InputError("receiver", self._kept, "less light sent back and forth", "the iteration does not settle")

    def sum_up(self, waves: Complex, x_um: Real, y_um: Real) -> Real:
        """Waves summed at every crossing (y, x) of the places."""
        rows, columns = self._padded
        x0, y0 = (centres[0] for centres in self.centres_um)
        ky = 2.0 * np.pi * np.fft.fftfreq(rows, self._step[0])
        kx = 2.0 * np.pi * np.arange(columns // 2 + 1) / (columns * self._step[1])
        twice = np.where((np.arange(kx.size) == 0) | (np.arange(kx.size) == columns // 2), 1.0, 2.0)
        along_x = np.exp(1j * np.outer(x_um - x0, kx)) * twice
        along_y = np.exp(1j * np.outer(y_um - y0, ky))
        return np.asarray((along_y @ waves @ along_x.T).real / (rows * columns))

    def _once(self, light: Real) -> Complex:
        """Waves of what comes up again of the light on the grid."""
        sent = np.fft.rfft2(self._returned * light, self._padded)
        waves = sent * self._straight
        if self._diffuse or self._leak:
            on_substrate = np.fft.rfft2(self._inside(sent * self._down), self._padded)
            waves = waves + (self._diffuse + self._leak * self._displaced) * on_substrate * self._down
        return np.asarray(self._kept * waves)

    def _inside(self, waves: Complex) -> Real:
        rows, columns = self._shape
        return np.asarray(np.fft.irfft2(waves, self._padded)[:rows, :columns])

    def _past_chips(self, layout: Array, height_um: float, lost: float) -> Real:
        """What of the light sent back at each cell of the grid comes up again as if there were no chips."""
        returned = np.ones(self._shape)
        if lost:
            x, y = self.centres_um
            for cx, cy in layout.centres_um.reshape(-1, 2):
                r2 = np.add.outer((y - cy) ** 2, (x - cx) ** 2)
                returned -= lost * layout.spacing_um**2 * height_um**2 / (np.pi * (r2 + height_um**2) ** 2)
        return returned

    def _by_lambert(self, height_um: float) -> Real:
        """Transform of h^2 / (pi (r^2 + h^2)^2) as it lies on the grid."""
        dy, dx = (np.fft.fftfreq(n, 1.0 / (n * step)) for n, step in zip(self._padded, self._step, strict=True))
        r2 = np.add.outer(dy**2, dx**2)
        kernel = height_um**2 / (np.pi * (r2 + height_um**2) ** 2) * self._step[0] * self._step[1]
        return np.asarray(np.fft.rfft2(kernel).real)
