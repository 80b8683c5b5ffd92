"""Spread light: Lambert's law and the Gaussian lobe about the mirror direction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from containers.bsdf.surface import HALF_PI, Bsdf, Real, checked_share, direction_of, pick
from containers.checked import within

_RULE = np.polynomial.legendre.leggauss(48)
_SHORT_RULE = np.polynomial.legendre.leggauss(16)
_REACH = 9.0
"""In sigma; beyond it lies exp(-40) of a Rayleigh distribution."""
_NEWTON_STEPS = 60
_NEAR_RAD = 1e-9


@dataclass(frozen=True)
class Lambertian(Bsdf):
    """Equal radiance in all directions: bsdf = reflectance / pi above the surface, transmittance / pi below."""

    reflectance: float
    transmittance: float = 0.0

    def __post_init__(self) -> None:
        checked_share("reflectance", self.reflectance)
        checked_share("transmittance", self.transmittance)
        checked_share("reflectance + transmittance", self.reflectance + self.transmittance)

    def _draw(self, u: Real, theta_in: Real) -> Real:
        side, _ = pick(u[:, 0], np.broadcast_to([self.reflectance, self.transmittance], (theta_in.size, 2)))
        w = direction_of(np.arcsin(np.sqrt(u[:, 1])), 2.0 * np.pi * u[:, 2])
        w[side == 1, 2] *= -1.0
        return w

    def _intensity(self, theta_in: Real, direction: Real) -> Real:  # noqa: ARG002  # Lambert forgets the incidence
        z = direction[..., 2]
        return np.asarray(np.where(z > 0.0, self.reflectance, self.transmittance) * np.abs(z) / np.pi)

    def _albedo(self, theta_in: Real) -> Real:
        return np.full(theta_in.shape, self.reflectance + self.transmittance)


@dataclass(frozen=True)
class GaussianLobe(Bsdf):
    """Reflection spread about the mirror direction, as the substrate does it.

    Parameters
    ----------
    reflectance : power ratio, the same at every angle of incidence.
    sigma_rad : scale of the Rayleigh distribution of the polar angle theta about the mirror direction, up to pi/2.

    Notes
    -----
    Density per d theta: theta / sigma^2 exp(-theta^2 / 2 sigma^2); azimuth phi uniform; a direction below the surface
    is drawn again (not mirrored up), and so is a theta above pi, which is no polar angle (Rayleigh's law gives one
    with exp(-pi^2 / 2 sigma^2): 1e-281 at 5 deg, 0.135 at 90 deg). Drawing again is the same as dividing by

        Z(theta_in) = integral of Rayleigh(theta) g(theta),   g = share of azimuths above the surface
        g = arccos(-cot theta cot theta_in) / pi between pi/2 - theta_in and pi/2 + theta_in, 1 below, 0 above,

    so the bsdf is reflectance Rayleigh(theta) / (2 pi sin theta Z cos theta_out). Up to pi/2 - theta_in the integral
    is closed; the rest is one Gauss-Legendre rule in s, theta = pi/2 + theta_in sin s, which takes away the square
    roots of g at both ends, cut at 9 sigma: the error found is below 3e-11. Samples invert the same integral, so
    they are distributed as if both were drawn again, with a fixed number of uniforms.

    Energy is conserved at every angle; the lobe is not reciprocal (`reciprocity_defect`).
    """

    reflectance: float
    sigma_rad: float

    def __post_init__(self) -> None:
        checked_share("reflectance", self.reflectance)
        within("sigma_rad", self.sigma_rad, 0.0, HALF_PI, "use Mirror for sigma 0", above=True)

    def share_above(self, theta_in_rad: Real) -> Real:
        """Z: the share of first draws that is not below the surface, for angles of any shape."""
        return self._body(theta_in_rad) + self._tail(theta_in_rad, self._end(theta_in_rad))

    def _draw(self, u: Real, theta_in: Real) -> Real:
        body = self._body(theta_in)
        target = u[:, 0] * (body + self._tail(theta_in, self._end(theta_in)))
        theta = self.sigma_rad * np.sqrt(-2.0 * np.log1p(-np.minimum(target, body)))
        tail = np.flatnonzero(target > body)
        theta[tail] = self._inverse_tail(theta_in[tail], target[tail] - body[tail])
        phi = np.pi * _share_above(theta, theta_in) * (2.0 * u[:, 1] - 1.0)
        # about the mirror direction, phi = 0 towards the normal
        along, across, aside = np.cos(theta), np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi)
        s, c = np.sin(theta_in), np.cos(theta_in)
        # the last digits of a grazing direction may dip below the surface
        return np.stack([along * s - across * c, aside, np.maximum(along * c + across * s, 0.0)], axis=-1)

    def _intensity(self, theta_in: Real, direction: Real) -> Real:
        s, c = np.sin(theta_in), np.cos(theta_in)
        x, y, z = np.moveaxis(direction, -1, 0)
        sine = np.hypot(y, x * c - z * s)
        theta = np.arctan2(sine, x * s + z * c)
        spread = np.divide(theta, sine, out=np.ones_like(sine), where=sine > 0.0)
        density = np.exp(-0.5 * (theta / self.sigma_rad) ** 2) * spread / (2.0 * np.pi * self.sigma_rad**2)
        unique, back = np.unique(theta_in, return_inverse=True)
        Z = self.share_above(unique)[back].reshape(theta_in.shape)
        return np.asarray(np.where(z > 0.0, self.reflectance * density / Z, 0.0))

    def _albedo(self, theta_in: Real) -> Real:
        return np.full(theta_in.shape, self.reflectance)

    def _body(self, theta_in: Real) -> Real:
        """Rayleigh's probability of angles so small that all azimuths are above the surface."""
        return np.asarray(-np.expm1(-0.5 * ((HALF_PI - theta_in) / self.sigma_rad) ** 2))

    def _end(self, theta_in: Real) -> Real:
        reach = (_REACH * self.sigma_rad - HALF_PI) / np.maximum(theta_in, 1e-300)
        return np.asarray(np.arcsin(np.clip(reach, -1.0, 1.0)))

    def _rate(self, theta_in: Real, s: Real) -> Real:
        """Density of accepted draws per ds, theta = pi/2 + theta_in sin s."""
        theta = HALF_PI + theta_in * np.sin(s)
        rayleigh = theta / self.sigma_rad**2 * np.exp(-0.5 * (theta / self.sigma_rad) ** 2)
        return np.asarray(rayleigh * _share_above(theta, theta_in) * theta_in * np.cos(s))

    def _tail(self, theta_in: Real, end: Real) -> Real:
        return self._between(theta_in, np.full_like(end, -HALF_PI), end, _RULE)

    def _between(self, theta_in: Real, start: Real, end: Real, rule: tuple[Real, Real]) -> Real:
        """Accepted draws with s from `start` to `end`."""
        half = (end - start) / 2.0
        s = (start + half)[..., None] + half[..., None] * rule[0]
        return np.asarray(half * (self._rate(theta_in[..., None], s) @ rule[1]))

    def _inverse_tail(self, theta_in: Real, target: Real) -> Real:
        """The theta up to which the tail holds `target`, by Newton's steps inside a shrinking bracket."""
        low, high = np.full(target.shape, -HALF_PI), self._end(theta_in)
        s = (low + high) / 2.0
        excess = self._tail(theta_in, s) - target
        for _ in range(_NEWTON_STEPS):
            low, high = np.where(excess < 0.0, s, low), np.where(excess < 0.0, high, s)
            slope = self._rate(theta_in, s)
            newton = s - np.divide(excess, slope, out=np.full_like(s, np.inf), where=slope > 0.0)
            following = np.where((newton > low) & (newton < high), newton, (low + high) / 2.0)
            excess += self._between(theta_in, s, following, _SHORT_RULE)
            step, s = np.abs(following - s), following
            if np.all(step < _NEAR_RAD):
                break
        return np.asarray(HALF_PI + theta_in * np.sin(s))


def _share_above(theta: Real, theta_in: Real) -> Real:
    """Share of the azimuths about the mirror direction, at polar angle theta from it, that are above the surface."""
    lowest = np.maximum(np.sin(theta) * np.sin(theta_in), 1e-300)
    return np.asarray(np.arccos(np.clip(-np.cos(theta) * np.cos(theta_in) / lowest, -1.0, 1.0)) / np.pi)
