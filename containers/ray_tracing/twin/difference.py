"""What Monte Carlo has over the twin at an anchor, and what of that there is at other parameters.

The same share of the light, wherever the light goes after the module: what a plate displaces and a lens blurs,
stretches or darkens is all of it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from containers.ray_tracing.light_map import LightMap
from containers.ray_tracing.twin.module import open_array
from containers.scene import Scene

Real = NDArray[np.float64]


@dataclass(frozen=True)
class Plate:
    """What lies inside a receiver: a share of the light that arrives in a module is displaced by so much."""

    share: float
    sd_um: float
    half_um: tuple[float, float]
    """Of the module, along y and x."""

    @classmethod
    def of(cls, scene: Scene) -> Plate:
        """That of a module."""
        receiver, layout = scene.receiver, open_array(scene)
        halves = (layout.half_y_um, layout.half_x_um)
        return cls(receiver.spread_share, receiver.spread_um if receiver.spread_share else 0.0, halves)

    def more(self, values: Real, step_um: float) -> Real:
        """By how much it changes a map (y, x) about the module's centre."""
        if not self.share or not self.sd_um:
            return np.zeros_like(values)
        along_y, along_x = (
            self._weights(count, half, step_um) for count, half in zip(values.shape, self.half_um, strict=True)
        )
        return np.asarray(self.share * (along_y @ values @ along_x.T - values))

    def _weights(self, count: int, half_um: float, step_um: float) -> Real:
        """(place, sample) of a Gaussian over what lies inside."""
        at = (np.arange(count) + 0.5 - count / 2.0) * step_um
        inside = np.clip((half_um - np.abs(at)) / step_um + 0.5, 0.0, 1.0)
        weight = np.exp(-0.5 * ((at[:, None] - at) / self.sd_um) ** 2)
        return np.asarray(weight * inside * (step_um / (self.sd_um * np.sqrt(2.0 * np.pi))))


@dataclass(frozen=True)
class Difference:
    """What Monte Carlo has over the twin at an anchor, over the whole map of a module; both (y, x) in 1/mm^2."""

    missing: Real
    twin: Real
    plate: Plate
    """Of the anchor's receiver."""

    def added_to(self, light: LightMap, plate: Plate, image: Callable[[LightMap], Real]) -> LightMap:
        """The twin's map of the same module at other parameters, with what it misses: the same share of the light.

        Samples lie at as many shares of the module's height as the anchor's, so what is missing grows with that.

        Parameters
        ----------
        plate : of the receiver there. image : what the camera there sees of a map, whose sums are compared.
        """
        here = light.irradiance_per_mm2
        missing, there = (_middle_of(one, here.shape) for one in (self.missing, self.twin))
        before = image(replace(light, irradiance_per_mm2=there)).sum()
        share = image(light).sum() / before if before > 0.0 else 1.0
        if plate != self.plate:
            missing = missing + (plate.more(missing, light.step_um) - self.plate.more(missing, light.step_um))
        return replace(light, irradiance_per_mm2=here + share * missing)

    @property
    def nbytes(self) -> int:
        """In memory."""
        return int(self.missing.nbytes + self.twin.nbytes)


def _middle_of(values: Real, shape: tuple[int, ...]) -> Real:
    """The middle of a map (y, x) that has an even number of samples along each axis; nothing lies beyond it."""
    before = [(wanted - have) // 2 for wanted, have in zip(shape, values.shape, strict=True)]
    values = np.pad(values, [(max(0, some), max(0, some)) for some in before])
    (rows, columns) = (
        slice(max(0, -some), max(0, -some) + wanted) for some, wanted in zip(before, shape, strict=True)
    )
    return values[rows, columns]
