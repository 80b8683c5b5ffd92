"""Several ways to scatter on one surface: a fixed mixture, and a specular coat over a base."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from containers.bsdf.specular import Mirror, Specular
from containers.bsdf.surface import Bsdf, Deltas, Real, checked_angle, checked_share, pick
from luxloop.errors import InputError

_PERFECT = Mirror(1.0)


@dataclass(frozen=True)
class Mixture(Bsdf):
    """bsdf = sum of shares x parts; the shares are of area, so their sum is at most 1 (less: the rest is black)."""

    parts: tuple[Bsdf, ...]
    shares: tuple[float, ...]

    def __post_init__(self) -> None:
        if not self.parts or len(self.parts) != len(self.shares):
            raise InputError("shares", len(self.shares), f"one for each of the {len(self.parts)} parts, at least one")
        for share in self.shares:
            checked_share("shares", share)
        checked_share("sum of shares", round(sum(self.shares), 12))
        ratios = {part.index_ratio for part in self.parts if _refracts(part)}
        if len(ratios) > 1:
            raise InputError("parts", sorted(ratios), "one index ratio for all parts that refract")

    @property
    def index_ratio(self) -> float:
        """That of the parts which refract."""
        return next((part.index_ratio for part in self.parts if _refracts(part)), 1.0)

    def deltas(self, theta_in_rad: ArrayLike) -> Deltas:
        """Shares of the incident power in the exact mirror and in the exact refracted direction."""
        theta = checked_angle(theta_in_rad)
        found = [part.deltas(theta) for part in self.parts]
        mirror = sum((s * d.mirror for s, d in zip(self.shares, found, strict=True)), np.zeros(theta.shape))
        refracted = sum((s * d.refracted for s, d in zip(self.shares, found, strict=True)), np.zeros(theta.shape))
        return Deltas(mirror, refracted)

    def _powers(self, theta_in: Real) -> Real:
        """(..., part): what each part keeps of the incident power."""
        return np.stack([s * p.albedo(theta_in) for s, p in zip(self.shares, self.parts, strict=True)], axis=-1)

    def _draw(self, u: Real, theta_in: Real) -> Real:
        return _draw_parts(self.parts, self._powers(theta_in), u, theta_in)

    def _intensity(self, theta_in: Real, direction: Real) -> Real:
        terms = (s * p.intensity(theta_in, direction) for s, p in zip(self.shares, self.parts, strict=True))
        return sum(terms, np.zeros(direction.shape[:-1]))

    def _albedo(self, theta_in: Real) -> Real:
        return np.asarray(self._powers(theta_in).sum(axis=-1))


@dataclass(frozen=True)
class Coated(Bsdf):
    """A specular coat over a base: the coat reflects R(theta_in), what it lets through (T) meets the base.

    Neglected: refraction in the coat, its reflection of what comes back from the base. The base is therefore seen as
    if uncoated on the way out, which conserves energy but is not reciprocal unless R is constant.
    """

    coat: Specular
    base: Bsdf

    @property
    def index_ratio(self) -> float:
        """That of the base: the coat itself is thin."""
        return self.base.index_ratio

    def deltas(self, theta_in_rad: ArrayLike) -> Deltas:
        """Shares of the incident power in the exact mirror and in the exact refracted direction."""
        theta = checked_angle(theta_in_rad)
        R, T = self.coat.deltas(theta)
        mirror, refracted = self.base.deltas(theta)
        return Deltas(R + T * mirror, T * refracted)

    def _draw(self, u: Real, theta_in: Real) -> Real:
        R, T = self.coat.deltas(theta_in)
        powers = np.stack([R, T * self.base.albedo(theta_in)], axis=-1)
        return _draw_parts((_PERFECT, self.base), powers, u, theta_in)

    def _intensity(self, theta_in: Real, direction: Real) -> Real:
        return self.coat.deltas(theta_in).refracted * self.base.intensity(theta_in, direction)

    def _albedo(self, theta_in: Real) -> Real:
        R, T = self.coat.deltas(theta_in)
        return np.asarray(R + T * self.base.albedo(theta_in))


def _draw_parts(parts: tuple[Bsdf, ...], powers: Real, u: Real, theta_in: Real) -> Real:
    """Each ray by one part, chosen in proportion to what the parts keep; the rest of the first uniform is used on."""
    chosen, left = pick(u[:, 0], powers)
    direction = np.zeros((theta_in.size, 3))
    for k, part in enumerate(parts):
        rays = np.flatnonzero(chosen == k)
        rest = np.column_stack([left[rays], u[rays, 1], u[rays, 2]])
        direction[rays] = part._draw(rest, theta_in[rays])
    return direction


def _refracts(part: Bsdf) -> bool:
    return bool(np.any(part.deltas(np.linspace(0.0, np.pi / 2, 19)).refracted > 0.0))
