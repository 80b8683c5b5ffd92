r"""What every Bsdf is, and the frame it lives in.

    Surface space: the normal is +z on the side the light comes from, and BOTH directions point away from the surface.

                 z
        incident |  mirror
              \  |  /            incident  (-sin theta_in, 0,  cos theta_in)
               \ | /             mirror    ( sin theta_in, 0,  cos theta_in),  theta_out = theta_in,  phi_out = 0
       _________\|/_________ x   refracted ( sin theta_t,  0, -cos theta_t),   theta_out = pi - theta_t
                  \
                   \ refracted   sin theta_t = index_ratio sin theta_in,  index_ratio = n_in / n_out

`bsdf` is brdf + btdf: theta_out below pi/2 is reflection, above it transmission. All surfaces here are isotropic, so
a surface knows the incident light by its polar angle `theta_in_rad` alone, and phi_out is counted from the mirror's.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from containers.checked import reals, within
from luxloop.errors import InputError

Real = NDArray[np.float64]
HALF_PI = np.pi / 2
UNIT_TOLERANCE = 1e-5
"""Of the square of a direction's length: single precision is unit enough."""
GRAZING = 1e-12
"""cos theta_out that is 0 but for rounding. A lobe's bsdf grows without bound towards it; there it is called 0."""


class Sample(NamedTuple):
    """Where the light goes, and with which weight."""

    direction: Real
    """(n, 3), unit vectors in surface space, away from the surface."""
    weight: Real
    """(n,), power kept; its mean is the albedo."""


class Deltas(NamedTuple):
    """Shares of the incident power that go in one exact direction; no bsdf in 1/sr can describe them."""

    mirror: Real
    refracted: Real


class Bsdf(ABC):
    """A scattering surface; the verbs are here, the physics in `_draw`, `_intensity`, `_albedo`, `deltas`."""

    @property
    def index_ratio(self) -> float:
        """n_in / n_out, which refracts the transmitted delta part."""
        return 1.0

    def sample(self, uniforms: ArrayLike, theta_in_rad: ArrayLike) -> Sample:
        """Directions drawn in proportion to bsdf x |cos theta_out|, each with weight albedo(theta_in).

        Parameters
        ----------
        uniforms : (n, 3), random numbers in [0, 1); the first also chooses between parts, what is left of it is used.
        theta_in_rad : scalar or (n,), angle between the incident direction and the normal, 0 to pi/2.
        """
        u = within("uniforms", uniforms, 0.0, 1.0, "random numbers as numpy's Generator.random gives", below=True)
        if u.ndim != 2 or u.shape[1] != 3:
            raise InputError("uniforms", u.shape, "an array of shape (n, 3)", "three random numbers for each ray")
        theta = np.broadcast_to(checked_angle(theta_in_rad), u.shape[:1])
        return Sample(self._draw(u, theta), self._albedo(theta))

    def evaluate(self, theta_in_rad: ArrayLike, direction: ArrayLike) -> Real:
        """The bsdf (1/sr) without its delta parts, for directions (..., 3) away from the surface."""
        w = _checked_directions(direction)
        cosine = np.abs(w[..., 2])
        intensity = self._intensity(np.broadcast_to(checked_angle(theta_in_rad), w.shape[:-1]), w)
        return np.asarray(np.divide(intensity, cosine, out=np.zeros_like(intensity), where=cosine > GRAZING))

    def intensity(self, theta_in_rad: ArrayLike, direction: ArrayLike) -> Real:
        """Share of the incident power per solid angle (1/sr), bsdf x |cos theta_out|, without the delta parts."""
        w = _checked_directions(direction)
        return self._intensity(np.broadcast_to(checked_angle(theta_in_rad), w.shape[:-1]), w)

    def albedo(self, theta_in_rad: ArrayLike) -> Real:
        """Share of the incident power that is not absorbed: reflected and transmitted, delta parts included."""
        return self._albedo(checked_angle(theta_in_rad))

    def deltas(self, theta_in_rad: ArrayLike) -> Deltas:
        """Shares of the incident power in the exact mirror and in the exact refracted direction."""
        theta = checked_angle(theta_in_rad)
        return Deltas(np.zeros(theta.shape), np.zeros(theta.shape))

    @abstractmethod
    def _draw(self, u: Real, theta_in: Real) -> Real: ...

    @abstractmethod
    def _intensity(self, theta_in: Real, direction: Real) -> Real: ...

    @abstractmethod
    def _albedo(self, theta_in: Real) -> Real: ...


def direction_of(theta_rad: ArrayLike, phi_rad: ArrayLike) -> Real:
    """Unit vectors (..., 3) at polar angle theta from the normal and azimuth phi from the mirror direction's."""
    theta, phi = np.broadcast_arrays(np.asarray(theta_rad, float), np.asarray(phi_rad, float))
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)


def checked_angle(theta_in_rad: ArrayLike) -> Real:
    """The angles as floats; InputError outside 0 to pi/2."""
    return within("theta_in_rad", theta_in_rad, 0.0, HALF_PI, "the incident direction points away too")


def _checked_directions(direction: ArrayLike) -> Real:
    """The directions as floats; InputError unless they are unit vectors (..., 3)."""
    w = reals("direction", direction)
    if w.ndim < 1 or w.shape[-1] != 3:
        raise InputError("direction", w.shape, "an array of shape (..., 3)", "unit vectors, as direction_of gives")
    length = np.einsum("...i,...i->...", w, w)
    good = np.abs(length - 1.0) <= UNIT_TOLERANCE
    if not good.all():
        raise InputError("direction", float(np.sqrt(length[~good][0])), "vectors of length 1", "divide by the length")
    return w


def checked_share(field: str, value: float) -> None:
    """InputError unless `value` is a share of power, 0 to 1."""
    within(field, value, 0.0, 1.0, "a share of power: more would create energy")


def pick(u: Real, shares: Real) -> tuple[NDArray[np.intp], Real]:
    """Which part each u (n,) in [0, 1) falls on, parts in proportion to `shares` (n, k), and where in it, 0 to 1."""
    ends = np.cumsum(shares, axis=1)
    at = u * ends[:, -1]
    part = np.minimum((at[:, None] >= ends).sum(axis=1), shares.shape[1] - 1)
    rows = np.arange(u.size)
    share = shares[rows, part]
    left = np.divide(at - (ends[rows, part] - share), share, out=u.copy(), where=share > 0.0)
    return part, np.clip(left, 0.0, np.nextafter(1.0, 0.0))
