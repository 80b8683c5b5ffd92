"""What Monte Carlo has over the twin at an anchor, and what of that there is at other parameters.

The same share of the light, wherever the light goes after the module: what a plate displaces and a lens blurs,
stretches or darkens is all of it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from containers.ray_tracing.field import Field, beyond_noise
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
        """(place, sample): of a Gaussian, what falls to the part of each sample's step that lies inside."""
        steps = (np.arange(2 * count) - count + 0.5) * (step_um / (np.sqrt(2.0) * self.sd_um))
        of_steps = np.diff([0.5 * math.erf(one) for one in steps])
        at = (np.arange(count) + 0.5 - count / 2.0) * step_um
        inside = np.clip((half_um - np.abs(at)) / step_um + 0.5, 0.0, 1.0)
        number = np.arange(count)
        return np.asarray(of_steps[number - number[:, None] + count - 1] * inside)


@dataclass(frozen=True)
class Difference:
    """What Monte Carlo has over the twin at an anchor, over the whole map of a module; both (y, x) in 1/mm^2."""

    missing: Real
    twin: Real
    step_um: float
    """Of both maps, about the module's centre."""
    plate: Plate
    """Of the anchor's receiver."""

    def laid(self, light: LightMap, plate: Plate) -> tuple[Real, LightMap]:
        """What is missing (y, x) behind a plate, and the anchor's twin, at the samples of another map of the module.

        It stays where it is about the module's centre: chips do, where the receiver is further away.
        """
        maps, shape = [self.missing, self.twin], light.irradiance_per_mm2.shape
        if plate != self.plate:
            maps = [one + (plate.more(one, self.step_um) - self.plate.more(one, self.step_um)) for one in maps]
        missing, twin = (_resampled(one, self.step_um, shape, light.step_um) for one in maps)
        return missing, replace(light, irradiance_per_mm2=twin)

    @property
    def nbytes(self) -> int:
        """In memory."""
        return int(self.missing.nbytes + self.twin.nbytes)


def without_noise(missing: Real, step_um: float, field: Field) -> Real:
    """A map (y, x) with the noise of a field's mean in it, without what may be noise.

    Waves of nearly equal length share a factor, as those of `Field.denoised` do. A blur takes noise out of a map: its
    change of one that has the noise in it would agree with any residual that has it, too.
    """
    rows, columns = missing.shape
    longest_um = 2.0 * step_um * max(rows, columns)
    waves = np.fft.rfft2(np.pad(missing, [(0, count) for count in missing.shape], mode="symmetric"))
    per_um = np.fft.fftfreq(2 * rows, step_um), np.fft.rfftfreq(2 * columns, step_um)
    ring = np.rint(longest_um * np.hypot.outer(*per_um)).astype(int)
    of_both_signs = np.where(np.arange(columns + 1) % columns == 0, 1.0, 2.0) / (4.0 * rows * columns) ** 2
    power = np.bincount(ring.ravel(), (of_both_signs * (waves.real**2 + waves.imag**2)).ravel())
    modes = np.hypot.outer(field.y.wavenumber_per_um, field.x.wavenumber_per_um) / (2.0 * np.pi)
    number = np.minimum(np.rint(longest_um * modes).astype(int), len(power) - 1)
    noise = np.bincount(number.ravel(), field.variance.ravel(), len(power))
    whole = np.fft.irfft2(waves * beyond_noise(power, noise)[ring], (2 * rows, 2 * columns))
    return np.asarray(whole[:rows, :columns])


def _resampled(values: Real, step_um: float, shape: tuple[int, ...], to_um: float) -> Real:
    """A map (y, x) about a centre at the samples of another one about the same; beyond its own there is nothing.

    Cubic convolution (Keys, IEEE Trans. Acoust. Speech Signal Process. 29, 1153, 1981); at a sample its own value.
    """
    for axis, count in enumerate(shape):
        have = values.shape[axis]
        at = (np.arange(count) + 0.5 - count / 2.0) * (to_um / step_um) + have / 2.0 - 0.5
        low = np.floor(at + 1e-9).astype(int)
        u = at - low
        weights = (
            ((2.0 - u) * u - 1.0) * u / 2.0, ((3.0 * u - 5.0) * u * u + 2.0) / 2.0,
            ((4.0 - 3.0 * u) * u + 1.0) * u / 2.0, (u - 1.0) * u * u / 2.0,
        )  # fmt: skip
        parts = []
        for beside, weight in enumerate(weights, -1):
            number = low + beside
            there = np.where((number >= 0) & (number < have), weight, 0.0)
            parts.append(np.take(values, np.clip(number, 0, have - 1), axis) * np.expand_dims(there, 1 - axis))
        values = np.asarray(sum(parts))
    return values
