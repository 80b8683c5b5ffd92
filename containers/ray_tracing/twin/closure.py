"""Light that goes back and forth between receiver and substrate, reckoned instead of traced.

What a Lambertian receiver sends back from a place comes up again spread by a kernel that depends on the distance
only, so the endless module is solved wave by wave, and the finite one by iteration:

    E(k) = E0(k) / (1 - rho_r T(k))              E <- E0 + rho_r w F^-1[T F(w E)],  w = 1 inside the module

T(k) is the transform of one round trip receiver - substrate - receiver, the substrate's reflectance included:

    mirror       2x K1(2x)                       x = k D: a mirror image of the place, 2 D away, seen by Lambert's law
    Lambertian   (x K1(x))^2                     down and up again, each by Lambert's law
    lobe         mean of J0(x |t + t'|)          t, t' = tan theta of the ways down and up
    inside       (x K1(x))^2 / (1 + (k L)^2)^(3/2)   of what leaks (`Leak`), displaced with exp(-r / L) / (2 pi L^2)

Source of the first two: the transform of h^2 / (pi (r^2 + h^2)^2) is kh K1(kh). Neglected: chips (see `shadow`).
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from containers.bsdf import Bsdf, GaussianLobe, Lambertian, Mirror, Mixture
from containers.ray_tracing.field import lambert_transform
from containers.ray_tracing.twin.direct import dimmed, lambertian_part
from containers.scene import Receiver, Scene
from luxloop.errors import InputError

Real = NDArray[np.float64]

LAST_X, NODES_X = 8.0, 65
"""Of the table of what a lobe's transform has beyond a mirror's; both are below 1e-4 at its end."""
SEEN_NODES = 513
_ALL = np.ones(2)
"""The response to light of which all counts alike."""
_SLOPES, _U = np.polynomial.legendre.leggauss(200), np.polynomial.legendre.leggauss(14)
AZIMUTHS = 16
_LAMBERT_NODES, _LAMBERT_END = 12_001, 40.0
_J0_NEAR = (1.0, -2.2499997, 1.2656208, -0.3163866, 0.0444479, -0.0039444, 0.0002100)
_J0_AMPLITUDE = (0.79788456, -0.00000077, -0.00552740, -0.00009512, 0.00137237, -0.00072805, 0.00014476)
_J0_PHASE = (-0.78539816, -0.04166397, -0.00003954, 0.00262573, -0.00054125, -0.00029333, 0.00013558)


class Leak(NamedTuple):
    """What goes on inside the substrate (`Scene.leak_share`), lengths over the distance D."""

    share: float = 0.0
    length: float = 0.0

    @classmethod
    def of(cls, scene: Scene) -> Leak:
        """That of a scene."""
        return cls(scene.leak_share, scene.leak_um / scene.distance_um)

    def displaced(self, x: Real) -> Real:
        """Transform of exp(-r / L) / (2 pi L^2) at x = k D."""
        return np.asarray((1.0 + (x * self.length) ** 2) ** -1.5)

    def comes_up(self, x: Real, substrate: Bsdf, receiver: Receiver) -> Real:
        """(2, *x.shape): transforms at x = k D of what arrives, and is recorded, of light inside the substrate.

        A second arrival is included, of what the receiver's mirror or lobes send down, as in `round_trip`.
        """
        return np.asarray(
            self.displaced(x)
            * np.stack(
                [
                    _rising(x, response) + _specular_part(receiver) * _thrice(substrate, self, x, response)
                    for response in (_ALL, receiver.response)
                ]
            )
        )


NO_LEAK = Leak()


def round_trip(
    substrate: Bsdf, receiver: Receiver, x: ArrayLike, leak: Leak = NO_LEAK, *, recorded: bool = False
) -> Real:
    """T at x = k D, in the shape of x; at x = 0 the share of the receiver's Lambert light that comes up again.

    Parameters
    ----------
    leak : of the substrate. recorded : weigh what comes up by the receiver's response to its angle.

    Notes
    -----
    A mirror's share s of the receiver sends a part of what comes up down once more; that second arrival is included,
    s T_2(k), a third (s^2) is not.
    """
    at = np.asarray(x, float)
    response, ways = receiver.response if recorded else _ALL, _ways(substrate, leak, at)
    first = sum(share * _transform(kind, sigma, at, response) for kind, sigma, share in ways)
    specular = _specular_part(receiver)
    if specular == 0.0:
        return np.asarray(first)
    pairs = ((a * b, (one is Lambertian, two is Lambertian)) for one, _, a in ways for two, _, b in ways)
    second = sum(share * _twice(kinds, at, response) for share, kinds in pairs)
    return np.asarray(first + specular * second)


def reaching(substrate: Bsdf, receiver: Receiver, x: Real) -> Real:
    """Of Lambert light from the receiver what its mirror or lobes send down to the substrate a second time."""
    return np.asarray(_specular_part(receiver) * _thrice(substrate, NO_LEAK, x, _ALL))


def lambert(x: Real) -> Real:
    """x K1(x) to 1e-7, between nodes at equal steps of sqrt(x); 0 beyond 40."""
    return np.interp(np.sqrt(x), *_lambert_table(), right=0.0)


@lru_cache(maxsize=1)
def _lambert_table() -> tuple[Real, Real]:
    root = np.linspace(0.0, _LAMBERT_END**0.5, _LAMBERT_NODES)
    x = np.maximum(root**2, 1e-12)
    near_zero = 1.0 + x * x / 2.0 * (np.log(x / 2.0) + np.euler_gamma - 0.5)
    return root, np.where(x < 1e-3, near_zero, lambert_transform(x))


def ways_of(bsdf: Bsdf) -> list[tuple[type[Bsdf], float, float]]:
    """The parts of a surface as (kind, sigma, reflectance); InputError for one whose transform is not known."""
    if isinstance(bsdf, Lambertian | Mirror):
        return [(type(bsdf), 0.0, bsdf.reflectance)]
    if isinstance(bsdf, GaussianLobe):
        return [(GaussianLobe, bsdf.sigma_rad, bsdf.reflectance)]
    if isinstance(bsdf, Mixture):
        pairs = zip(bsdf.parts, bsdf.shares, strict=True)
        return [(kind, sigma, share * part) for inner, share in pairs for kind, sigma, part in ways_of(inner)]
    raise InputError(
        "substrate", type(bsdf).__name__, "Lambertian, Mirror, GaussianLobe or a Mixture", "use Monte Carlo"
    )


def _specular_part(receiver: Receiver) -> float:
    """What of the light a receiver's mirror and lobes send back."""
    _, followed = lambertian_part(receiver.bsdf)
    return float(sum(share for kind, _, share in ways_of(followed) if kind is not Lambertian))


def _ways(substrate: Bsdf, leak: Leak, x: Real) -> list[tuple[type[Bsdf], float, Real | float]]:
    """Those of a substrate that leaks; what leaks comes up by Lambert's law, displaced."""
    ways: list[tuple[type[Bsdf], float, Real | float]] = [*ways_of(dimmed(substrate, 1.0 - leak.share))]
    return [*ways, (Lambertian, 0.0, leak.share * leak.displaced(x))] if leak.share else ways


def _thrice(substrate: Bsdf, leak: Leak, x: Real, response: Real) -> Real:
    """From plane to plane three times, by Lambert's law to begin with: a mirror, and the substrate, on the way."""
    return np.asarray(
        sum(
            share * (lambert(2.0 * x) * _rising(x, response) if kind is Lambertian else _rising(3.0 * x, response))
            for kind, _, share in _ways(substrate, leak, x)
        )
    )


def _twice(lambertian: tuple[bool, bool], x: Real, response: Real) -> Real:
    """Two round trips with a mirror for a receiver: stretches of straight way between Lambert's scatterings."""
    first, second = lambertian
    stretches = [1 if first else 2] + ([2] if first and second else []) + [1 if second else 2]
    if first != second:
        stretches = [1, 3] if first else [3, 1]
    if not first and not second:
        stretches = [4]
    product = _rising(stretches[-1] * x, response)
    for steps in stretches[:-1]:
        product = product * lambert(steps * x)
    return product


def _transform(kind: type[Bsdf], sigma: float, x: Real, response: Real) -> Real:
    """Of one kind of surface without loss."""
    flat = bool(np.ptp(response) == 0.0)
    if kind is Lambertian:
        return np.asarray(lambert(x) * _rising(x, response))
    mirror = _rising(2.0 * x, response)
    if kind is Mirror:
        return np.asarray(mirror)
    table = lobe_table(sigma)
    weight = float(response.mean()) if not flat else response[0]
    return np.asarray(mirror + weight * _interpolated(x, table))


def _rising(x: Real, response: Real) -> Real:
    """Lambert's transform where arrivals count by their angle: x K1(x) where all count alike."""
    return response[0] * lambert(x) if np.ptp(response) == 0.0 else _seen(x, response)


def _seen(x: Real, response: Real) -> Real:
    """That of a response that changes with the angle.

    Notes
    -----
    Many are read between nodes at equal steps of sqrt(x); up to x = 30 that errs by less than 1e-4.
    """
    if x.size > SEEN_NODES:
        root = np.linspace(0.0, float(np.sqrt(x.max())), SEEN_NODES)
        return np.asarray(np.interp(np.sqrt(x), root, _seen(root**2, response)))
    share, weight = (1.0 + _SLOPES[0]) / 2.0, _SLOPES[1] / 2.0
    cosine = np.sqrt(1.0 - share)
    r = np.interp(cosine, np.linspace(0.0, 1.0, response.size), response)
    waves = bessel_j0(np.multiply.outer(x, np.sqrt(share) / cosine))
    return np.asarray(waves @ (weight * (r - r.mean())) + r.mean() * lambert(x))


@lru_cache(maxsize=32)
def lobe_table(sigma_rad: float) -> Real:
    """What the round trip over a lobe without loss has beyond a mirror's; (NODES_X,), equal steps of sqrt(x).

    Notes
    -----
    Means of J0(x |t + t'|) - J0(2 x t) over sin^2 theta (uniform by Lambert's law), the lobe's own angle, and its
    azimuth; the directions are `GaussianLobe`'s own, at nodes instead of random numbers. Towards grazing angles the
    waves are finer than the nodes: each is averaged over its node's width, a factor sinc. Against 3 M random rays
    the error is below 1e-4 at sigma 5 deg, 1e-3 at 15 deg and 2.5e-3 at 30 deg.
    """
    share, weight = (1.0 + _SLOPES[0]) / 2.0, _SLOPES[1] / 2.0
    theta = np.arcsin(np.sqrt(share))
    u, v = np.meshgrid((1.0 + _U[0]) / 2.0, (np.arange(AZIMUTHS) + 0.5) / (2.0 * AZIMUTHS), indexing="ij")
    of_u = np.broadcast_to(_U[1][:, None] / (2.0 * AZIMUTHS), u.shape).ravel()
    nodes = np.column_stack([u.ravel(), v.ravel(), np.zeros(u.size)])
    lobe = GaussianLobe(1.0, sigma_rad)
    out = lobe.sample(np.tile(nodes, (theta.size, 1)), np.repeat(theta, len(nodes))).direction
    out = out.reshape(theta.size, len(nodes), 3)
    up = out[..., :2] / np.maximum(out[..., 2:], 1e-9)
    shift = np.hypot(np.tan(theta)[:, None] + up[..., 0], up[..., 1])
    slope = np.tan(theta)
    width = weight * (1.0 + slope**2) ** 2 / slope  # of a node in 2 tan theta
    table = np.zeros(NODES_X)
    for node, x in enumerate(LAST_X * np.linspace(0.0, 1.0, NODES_X)[1:] ** 2, 1):
        waves = bessel_j0(x * shift) @ of_u - bessel_j0(2.0 * x * slope)
        table[node] = (weight * np.sinc(x * width / (2.0 * np.pi))) @ waves
    table.setflags(write=False)
    return table


def _interpolated(x: Real, table: Real) -> Real:
    """Of a table at equal steps of sqrt(x), about which it is even, by cubics through four nodes; 0 beyond it."""
    padded = np.concatenate([table[1:2], table, np.zeros(3)])
    place = np.minimum(np.sqrt(x / LAST_X) * (NODES_X - 1), NODES_X + 0.0)
    node = np.minimum(place.astype(int), NODES_X - 1)
    t = place - node
    a, b, c, d = (padded[node + i] for i in range(4))
    value = b + t * ((c - a) / 2.0 + t * (a - 2.5 * b + 2.0 * c - d / 2.0 + t * (1.5 * (b - c) + (d - a) / 2.0)))
    return np.where(x >= LAST_X, 0.0, value)


def bessel_j0(x: ArrayLike) -> Real:
    """J0(x) for x >= 0, to 6e-8: the polynomials 9.4.1 and 9.4.3 of Abramowitz and Stegun."""
    at = np.asarray(x, float)
    near = np.polynomial.polynomial.polyval((np.minimum(at, 3.0) / 3.0) ** 2, _J0_NEAR)
    far = np.maximum(at, 3.0)
    z = 3.0 / far
    amplitude, phase = (np.polynomial.polynomial.polyval(z, c) for c in (_J0_AMPLITUDE, _J0_PHASE))
    return np.asarray(np.where(at < 3.0, near, amplitude / np.sqrt(far) * np.cos(far + phase)))
