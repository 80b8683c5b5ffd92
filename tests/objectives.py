"""Three fast analytic objectives for designers, and a controller in process that answers with their steps.

The module as a periodic array of pitch P = S + W between two Lambertian planes, solved in the reciprocal lattice:

    E(G) = {P_top H_top(G (D - T)) sinc sinc + P_side/2 [H_side(G (D - T/2)) + rho_s H_side(G T/2) F(G D)]}
           / (1 - rho_r rho_s F(G D)^2),     F(x) = x K1(x)

H_top is the Hankel transform of cos^4(theta) T_N(theta), H_side that of sin(theta) cos^3(theta), both 1 at 0; the
chip's light divides into top : sides : absorbed as tau_N : 0.3 * 4T/W : 0.25. It ranks optimisers; it is no model of
a module: the substrate is Lambertian, and what the chip does inside is two numbers.

* A: the uniformity, 100 min/max along the line y = 0 over one pitch. The best designs lie in a corner of the box.
* B: A less a steep penalty on pitches under 500 um (a budget of chips): the best designs lie in a slanted valley.
* C: A less what a thick module, many chips and chips of unusual width or height cost: the best designs lie inside.

The weights of B and C are this file's own.
"""

from __future__ import annotations

import functools
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.special import j0, k1

from env_controller.rewards import reward_of
from luxloop.campaign import Action, Reward, Step
from luxloop.design import LENGTH_DECIMALS, Bounds, Design
from luxloop.failure import Failure
from luxloop.model import Environment

Objective = Literal["A", "B", "C"]
Point = tuple[float, ...]
ENVIRONMENT = Environment(spacing_is="gap")
BOUNDS = Bounds(
    low=Design.from_vector((10.0, 10.0, 300.0, 5.0, 4.5)),
    high=Design.from_vector((180.0, 100.0, 700.0, 55.0, 9.5)),
    step=Design.from_vector((10.0, 2.0, 10.0, 5.0, 0.5)),
)
"""The paper's box with D from 10 um: 4.1 million designs, of which some hold no chip under the receiver."""
RHO_RECEIVER, RHO_SUBSTRATE = 0.35, 0.97
SIDE_SHARE, ABSORBED_SHARE = 0.3, 0.25
GAN, ALN = (2.4869, 45.2), (2.1793, 51.6)  # index and thickness in nm
MODES = 6  # the cusp that the sides make is cut here, not converged: a ranking needs no more
CUT = np.cos(2.0 * np.pi * np.outer(np.linspace(0.0, 0.5, 101), np.arange(MODES + 1)))
Q = np.concatenate([np.linspace(0.0, 6.0, 241), np.linspace(6.1, 60.0, 250)])
COS = np.polynomial.legendre.leggauss(300)[0] / 2.0 + 0.5
WEIGHT = np.polynomial.legendre.leggauss(300)[1] / 2.0


def transmittance(pairs: float, cos_air: NDArray[np.float64]) -> NDArray[np.float64]:
    """Power that a DBR passes from GaN to air, mean of s and p over 445 +- 9 nm; against cos(theta) in air."""
    # from the bulk: AlN, GaN, ...: whole pairs end with GaN, a half pair more with AlN
    films = [(ALN, GAN)[kind % 2] for kind in range(round(2.0 * pairs))]
    passed = np.zeros_like(cos_air)
    for wavelength in np.linspace(436.0, 454.0, 7):
        u2 = 1.0 - cos_air**2
        for polarised in (0, 1):
            # admittance of a medium: n cos(theta), or n / cos(theta) for p; the matrix of each film, air outwards
            cosine = [np.sqrt(1.0 - u2 / n**2) for n in (GAN[0], *(n for n, _ in films), 1.0)]
            index = np.array([GAN[0], *(n for n, _ in films), 1.0])
            eta = [n / c if polarised else n * c for n, c in zip(index, cosine, strict=True)]
            b, c = np.ones_like(cos_air, dtype=complex), eta[-1].astype(complex)
            for (n, d), cos_film, eta_film in reversed(list(zip(films, cosine[1:-1], eta[1:-1], strict=True))):
                phase = 2.0 * np.pi * n * d * cos_film / wavelength
                b, c = (
                    np.cos(phase) * b + 1j * np.sin(phase) / eta_film * c,
                    1j * eta_film * np.sin(phase) * b + np.cos(phase) * c,
                )
            passed += 4.0 * eta[0] * eta[-1] / np.abs(eta[0] * b + c) ** 2 / 14.0
    return passed


@functools.cache
def tau(pairs: float) -> float:
    """Flux through the top relative to a chip without DBR."""
    flux, bare = (float(np.sum(WEIGHT * COS * transmittance(n, COS))) for n in (pairs, 0.0))
    return flux / bare


@functools.cache
def hankel(pairs: float | None) -> NDArray[np.float64]:
    """Spectrum over `Q` of the spot on a plane at height 1 of light from the top, or (None) from the sides."""
    tan = np.sqrt(1.0 - COS**2) / COS
    seen = np.sqrt(1.0 - COS**2) if pairs is None else COS * transmittance(pairs, COS)
    spot = WEIGHT * seen  # intensity over solid angle; the irradiance is this times cos^3
    return np.asarray([float(np.sum(spot * j0(q * tan))) for q in Q]) / float(np.sum(spot))


def plane_to_plane(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """F(x) = x K1(x), 1 at 0: what a Lambertian plane keeps of a wave on its way to a parallel one."""
    return np.where(x > 0.0, x * k1(np.maximum(x, 1e-9)), 1.0)


@functools.lru_cache(maxsize=200_000)
def uniformity_percent(point: Point) -> float:
    """100 min/max of the line y = 0 for the five variables of a design that can be built."""
    distance, width, gap, thickness, pairs = point
    pitch = gap + width
    modes = np.arange(MODES + 1)
    g = 2.0 * np.pi / pitch * np.hypot(modes[:, None], modes)
    top, sides = tau(pairs), SIDE_SHARE * 4.0 * thickness / width
    both = top + sides + ABSORBED_SHARE
    sinc = np.sinc(modes * width / pitch)
    twice = np.where(modes > 0, 2.0, 1.0)  # a mode stands for its mirror image too
    between = plane_to_plane(g * distance)
    first = top / both * np.interp(g * (distance - thickness), Q, hankel(pairs), right=0.0) * np.outer(sinc, sinc)
    up, down = (np.interp(g * z, Q, hankel(None), right=0.0) for z in (distance - thickness / 2.0, thickness / 2.0))
    first = first + sides / both / 2.0 * (up + RHO_SUBSTRATE * down * between)
    series = first / (1.0 - RHO_RECEIVER * RHO_SUBSTRATE * between**2) * np.outer(twice, twice)
    line = CUT @ series.sum(axis=1)
    return float(max(0.0, 100.0 * line.min() / line.max()))


def value_percent(objective: Objective, point: Point) -> float:
    """The objective of a design, free of noise, in percent; 0 where it cannot be built."""
    distance, width, gap, thickness, _ = point
    if Design.from_vector(point).feasibility(ENVIRONMENT.distance_from, ENVIRONMENT.spacing_is) is not None:
        return 0.0
    u = uniformity_percent(point)
    if objective == "B":
        return u - 2.0 * max(0.0, 500.0 - gap - width)
    if objective == "C":
        chips_per_mm2 = 1e6 / (gap + width) ** 2
        return u - 0.1 * distance - 4.0 * chips_per_mm2 - 0.01 * (width - 20.0) ** 2 - 0.02 * (thickness - 20.0) ** 2
    return u


def ascended(objective: Objective, start: Point, bounds: Bounds = BOUNDS) -> tuple[float, Point]:
    """The local optimum of the lattice above `start` in moves of 16, 8, 4, 2, 1 steps of one or two variables."""
    low, high, step = (end.as_vector() for end in (bounds.low, bounds.high, bounds.step))
    unit = np.concatenate(
        [np.eye(5), [np.eye(5)[i] + s * np.eye(5)[j] for i in range(5) for j in range(i) for s in (1, -1)]]
    )
    best, at = value_percent(objective, start), start
    for scale in (16, 8, 4, 2, 1):
        better = True
        while better:
            better = False
            for move in (*unit, *-unit):
                x = np.round(np.array(at) + scale * move * step, LENGTH_DECIMALS)
                if np.all((x >= low) & (x <= high)) and (found := value_percent(objective, tuple(x.tolist()))) > best:
                    best, at, better = found, tuple(x.tolist()), True
    return best, at


class Controller:
    """The environment-control agent of a plan in process: keeps the lanes, answers an action with its step."""

    def __init__(
        self,
        objective: Objective = "A",
        bounds: Bounds = BOUNDS,
        reward: Reward = "gain",
        noise: float = 0.0,
        seed: int = 0,
    ) -> None:
        self.objective: Objective = objective
        self.bounds, self.reward, self.noise, self.seed = bounds, reward, noise, seed
        self.lanes: dict[int, tuple[Design, float]] = {}
        self.known: dict[Point, float] = {}
        self.failing: set[tuple[int, int]] = set()
        """Actions (lane, number) that fail."""

    def true_percent(self, design: Design) -> float:
        """The objective free of noise."""
        return value_percent(self.objective, tuple(design.as_vector().tolist()))

    def act(self, action: Action) -> Step:
        """The step of an action: state, uniformity in [0, 1], reward; a move outside leads nowhere."""
        design, reason = self._design_of(action)
        point = tuple(design.as_vector().tolist())
        words = {"run": action.run, "lane": action.lane, "number": action.number, "design": design}
        words["state"] = tuple(np.clip(self.bounds.normalise(design), -1.0, 1.0).tolist())
        if (action.lane, action.number) in self.failing:
            failure = Failure(code="crashed", message="told to fail")
            return Step(**words, uniformity=0.0, reward=0.0, failure=failure)
        infeasible = design.feasibility(ENVIRONMENT.distance_from, ENVIRONMENT.spacing_is)
        cached = point in self.known
        u = self.known.setdefault(point, self._seen(point))
        before = self.lanes[action.lane][1] if action.lane in self.lanes else u
        self.lanes[action.lane] = design, u
        return Step(
            **words,
            uniformity=u / 100.0,
            uniformity_error=self.noise * abs(u) / 100.0,
            reward=reward_of(self.reward, u / 100.0, before / 100.0),
            feasible=infeasible is None,
            reason=infeasible or reason,
            cached=cached,
        )

    def _design_of(self, action: Action) -> tuple[Design, str]:
        if action.design is not None:
            return action.design, ""
        assert action.move is not None
        at, _ = self.lanes[action.lane]
        moved = self.bounds.moved(at, action.move.variable, action.move.steps)
        return (moved, "") if moved is not None else (at, "outside the bounds")

    def _seen(self, point: Point) -> float:
        """The objective with the noise that belongs to this design and seed."""
        u = value_percent(self.objective, point)
        if not self.noise:
            return u
        key = [self.seed, *(round(1e3 * x) for x in point)]
        return u * (1.0 + self.noise * float(np.random.default_rng(key).standard_normal()))
