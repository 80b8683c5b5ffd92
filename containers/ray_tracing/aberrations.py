"""Blur that changes over the image: each pixel sees the mean of what its rays meet, spread as wide as its place says.

    image(p) = sum of w light(x(p) + S(p) u) over a rule's (w, u),   S S = V(p), the sum of the blurs' covariances

    round       V = w^2 r^4                     out of focus like r^2: a curved focal surface (Petzval)
    radial      V = w^2 r^4 along the radius    astigmatism, in focus for lines along the radius ...
    tangential  V = w^2 r^4 across it           ... and for lines across it
    tilted      V = w^2 (r.n)^2                 a focal plane that stands aslant to the receiver

r from the image's centre, 1 at its corner and beyond; w in um on the receiver. A pixel gathers: followed back through
the pupil its rays bring the mean of the radiance where they begin, and an even receiver looks even however the blur
changes. (Light that each point spreads by a PSF of its own would pile up where the blur ends.)

Neglected: that a curved and a tilted focal surface are one surface, out of focus by the sum of both, with its sign:
variances add as of causes that know nothing of each other.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from containers.compiled import kernel
from containers.lens import Uneven, corner_px, uneven_blurs
from containers.ray_tracing.light_map import LightMap, mirrored, spline_of, square_means
from luxloop.camera import Camera
from luxloop.errors import InputError

Real = NDArray[np.float64]

RULE_REACH, PLANE_STEPS = 4.5, (0.9, 0.6, 0.4, 0.27, 0.18)
"""Of the rules, in standard deviations: a plane's hexagonal lattices of 91 to 2,263 points."""
LINE_SHARE = 0.8
"""Of a plane's step: that of a line, 13 to 63 points."""
MOST_READ = 1 << 32
"""Values of a map that the rays of one image may read, two minutes."""


@dataclass(frozen=True, eq=False)
class Rays:
    """Where the rays of pixels begin on the receiver, relative to what a sharp pixel sees.

    rule (3, ray): weight, u and v of each, the same for all pixels. by_u_um, by_v_um (2, row, column): x and y by
    which a ray is displaced for u = 1 and for v = 1.
    """

    rule: Real
    by_u_um: Real
    by_v_um: Real


def rays_of(camera: Camera, row: Real, column: Real, finest_um: float = np.inf) -> Rays:
    """The rays of the pixels at all combinations of `row` (row,) and `column` (column,), in px.

    finest_um : 1/k of the shortest waves of light, of which rays lie so close that they miss none: the step of its
        map, which of the twin's are an eighth of the height.

    Notes
    -----
    Trapezoidal rules on a Gaussian, of unit second moment. Of a wave of k per standard deviation, exp(-k^2 / 2) is
    left: to 2e-4 up to k = 3.5 by the widest steps. Waves of k near 2 pi / step are taken for long ones, 1 % of them
    at 2 pi / step - 2 (k = 5), from where on the next finer step is taken. Neglected: what a distortion makes of a
    displacement.
    """
    x, y = _field_of(camera, row, column)
    covariance = _covariance_um2(camera, x, y)
    step = _step(np.sqrt(_largest(*covariance)) / finest_um)
    angle = np.radians(camera.rotation_deg)
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    (law, sd_um, _), *more = uneven_blurs(camera)
    if not more and law in ("radial", "tangential"):
        by_u = sd_um * np.hypot(x, y) * np.stack((x, y) if law == "radial" else (-y, x))
        return Rays(_line(LINE_SHARE * step), np.tensordot(turn, by_u, axes=1), np.zeros_like(by_u))
    xx, xy, yy = covariance
    root = np.sqrt(np.maximum(xx * yy - xy**2, 0.0))
    trace = np.sqrt(xx + yy + 2.0 * root)  # of the symmetric root of V, (V + root) / trace
    trace = np.where(trace > 0.0, trace, 1.0)
    by_u, by_v = np.stack([xx + root, xy]) / trace, np.stack([xy, yy + root]) / trace
    return Rays(_plane(step), np.tensordot(turn, by_u, axes=1), np.tensordot(turn, by_v, axes=1))


def rays_reach_um(camera: Camera, row: Real, column: Real) -> float:
    """How far from its pixel's place on the receiver the farthest ray of the pixels begins, at most."""
    if not uneven_blurs(camera):
        return 0.0
    largest = _largest(*_covariance_um2(camera, *_field_of(camera, row, column)))
    return 1.01 * RULE_REACH * float(np.sqrt(largest))


def blur_of(light: LightMap, rays: Rays, x_um: Real, y_um: Real, side_um: float) -> Real:
    """What the rays change of the sharp image (..., row, column): the mean of what they meet less what stands there.

    Notes
    -----
    Rays read a map of means over squares as large as a pixel, of `side_um` everywhere, from a spline of its own: the
    change alone feels that pixels of a distorted image are not all of one size.
    """
    each, maps = rays.rule.shape[1], light.irradiance_per_mm2[..., 0, 0].size
    if x_um.size * each * maps > MOST_READ:
        value, allowed = f"{x_um.size} pixels of {each} rays", f"{MOST_READ} rays in all images at once"
        raise InputError("rows x columns", value, allowed, "fewer pixels, or less blur")
    means = square_means(light, side_um)
    spline, per_um = spline_of(means), 1.0 / means.step_um
    x, y = ((at - start) * per_um for at, start in zip((x_um, y_um), means.origin_um, strict=True))
    change = np.empty((spline.shape[0], *x_um.shape))
    mirror = means.beyond == "mirror"
    _gather(spline, x, y, rays.rule, rays.by_u_um * per_um, rays.by_v_um * per_um, mirror, change)
    return change.reshape(*light.irradiance_per_mm2.shape[:-2], *x_um.shape)


@kernel
def _gather(c: Real, x: Real, y: Real, rule: Real, by_u: Real, by_v: Real, mirror: bool, change: Real) -> None:
    """Fill `change` (map, row, column); places and displacements in steps of the map."""
    for m in range(c.shape[0]):
        one = c[m]
        for row in range(x.shape[0]):
            for column in range(x.shape[1]):
                at_x, at_y = x[row, column], y[row, column]
                xu, yu = by_u[0, row, column], by_u[1, row, column]
                xv, yv = by_v[0, row, column], by_v[1, row, column]
                total = 0.0
                for ray in range(rule.shape[1]):
                    u, v = rule[1, ray], rule[2, ray]
                    total += rule[0, ray] * _value(one, at_x + u * xu + v * xv, at_y + u * yu + v * yv, mirror)
                change[m, row, column] = total - _value(one, at_x, at_y, mirror)


@kernel
def _value(c: Real, x: float, y: float, mirror: bool) -> float:
    """The cubic B-spline with coefficients c (y, x) at a point, in steps."""
    left, below = np.floor(x), np.floor(y)
    i, j = int(left) - 1, int(below) - 1
    wx, wy = _taps(x - left), _taps(y - below)
    total = 0.0
    if i >= 0 and j >= 0 and i + 4 <= c.shape[1] and j + 4 <= c.shape[0]:
        for n in range(4):
            a = wx[0] * c[j + n, i] + wx[1] * c[j + n, i + 1] + wx[2] * c[j + n, i + 2] + wx[3] * c[j + n, i + 3]
            total += wy[n] * a
        return total
    for n in range(4):
        for k in range(4):
            if mirror or (0 <= j + n < c.shape[0] and 0 <= i + k < c.shape[1]):
                total += wy[n] * wx[k] * c[mirrored(j + n, c.shape[0]), mirrored(i + k, c.shape[1])]
    return total


@kernel
def _taps(t: float) -> tuple[float, float, float, float]:
    """The B-splines of the four nodes -1, 0, 1, 2 at t, 0 <= t <= 1."""
    s = 1.0 - t
    t2, s2 = t * t, s * s
    return s2 * s / 6.0, 2.0 / 3.0 + t2 * (0.5 * t - 1.0), 2.0 / 3.0 + s2 * (0.5 * s - 1.0), t2 * t / 6.0


def _field_of(camera: Camera, row: Real, column: Real) -> tuple[Real, Real]:
    """x, y (row, column) of pixels from the image's centre, 1 at the distance of its corner and at most that."""
    corner = corner_px(camera)
    x, y = (column - (camera.columns - 1) / 2) / corner, (row[:, None] - (camera.rows - 1) / 2) / corner
    r = np.maximum(np.hypot(x, y), 1.0)
    return x / r, y / r


def _covariance_um2(camera: Camera, x: Real, y: Real) -> tuple[Real, Real, Real]:
    """V of all blurs that change over the image, along its axes: xx, xy, yy (row, column)."""
    found = np.zeros((3, *x.shape))
    for law, sd_um, direction_deg in uneven_blurs(camera):
        found += sd_um**2 * np.stack(_covariance(law, np.radians(direction_deg), x, y))
    return found[0], found[1], found[2]


def _covariance(law: Uneven, direction: float, x: Real, y: Real) -> tuple[Real, Real, Real]:
    r2 = x**2 + y**2
    if law == "radial":
        return r2 * x**2, r2 * x * y, r2 * y**2
    if law == "tangential":
        return r2 * y**2, -r2 * x * y, r2 * x**2
    of_both = r2**2 if law == "round" else (x * np.cos(direction) + y * np.sin(direction)) ** 2
    return of_both, np.zeros_like(x), of_both


def _largest(xx: Real, xy: Real, yy: Real) -> float:
    """The largest of all pixels' variances along any direction."""
    return float((0.5 * (xx + yy) + np.hypot(0.5 * (xx - yy), xy)).max())


def _step(waves: float) -> float:
    """Of a plane's lattice, for light whose shortest waves are of so many per standard deviation: 2 pi / step - 2.

    The finest where even that is too wide.
    """
    return next((step for step in PLANE_STEPS if waves <= 2.0 * np.pi / step - 2.0), PLANE_STEPS[-1])


@cache
def _line(step: float) -> Real:
    most = int(RULE_REACH / step)
    points = step * np.arange(-most, most + 1.0)
    return _rule(points, np.zeros_like(points), axes=1)


@cache
def _plane(step: float) -> Real:
    most = int(2.0 * RULE_REACH / step)
    i, j = (one.ravel() for one in np.mgrid[-most : most + 1, -most : most + 1])
    u, v = step * (i + 0.5 * j), step * np.sqrt(0.75) * j
    inside = u**2 + v**2 <= RULE_REACH**2
    return _rule(u[inside], v[inside], axes=2)


def _rule(u: Real, v: Real, axes: int) -> Real:
    weight = np.exp(-0.5 * (u**2 + v**2))
    weight /= weight.sum()
    scale = np.sqrt(axes / (weight * (u**2 + v**2)).sum())
    found = np.stack([weight, scale * u, scale * v])
    found.setflags(write=False)
    return found
