"""Where a designer may look, and by which moves: the box, what can be built in it, the actions a1 to a10 and more.

    distance_um  ──(-8)──(-4)──(-2)(-1) here (+1)(+2)──(+4)──(+8)──     steps of the bounds; profile `paper`: ±1 only

Pairs move in the bounds' step as the rest does; a half pair swaps mirror and anti-reflection, so
the whole pair that `fast` reaches with 2 steps of 0.5 is often the better move.
"""

from __future__ import annotations

import functools
from collections.abc import Container
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from luxloop.campaign import Move, Plan
from luxloop.design import LENGTH_DECIMALS, Bounds, Design, DistanceFrom, SpacingIs
from luxloop.errors import InputError

Profile = Literal["paper", "fast"]
Key = tuple[float, ...]
MULTIPLES: dict[Profile, tuple[int, ...]] = {"paper": (1,), "fast": (1, 2, 4, 8)}
TRIES = 1000


def key_of(design: Design) -> Key:
    """The five variables of a design in the order of `Design.FIELDS`: what designers know it by."""
    return (design.distance_um, design.width_um, design.spacing_um, design.thickness_um, design.dbr_pairs)


def moves_of(profile: Profile) -> tuple[Move, ...]:
    """The actions of a profile: + and - of each variable, by each multiple of its step; `paper` 10, `fast` 40."""
    return tuple(
        Move.model_validate({"variable": variable, "steps": sign * multiple})
        for multiple in MULTIPLES[profile]
        for variable in Design.FIELDS
        for sign in (1, -1)
    )


@functools.lru_cache(maxsize=1 << 16)
def _can_be_built(lengths_um: Key, distance_from: DistanceFrom, spacing_is: SpacingIs) -> bool:
    return Design.from_vector((*lengths_um, 0.0)).feasibility(distance_from, spacing_is) is None


@dataclass(frozen=True)
class Space:
    """The designs there are: the bounds, and how distance and spacing are read (which decides what can be built)."""

    bounds: Bounds
    distance_from: DistanceFrom = "substrate"
    spacing_is: SpacingIs = "pitch"

    @classmethod
    def of(cls, plan: Plan) -> Space:
        """The space of a run's plan."""
        return cls(plan.bounds, plan.environment.distance_from, plan.environment.spacing_is)

    def plain(self) -> dict[str, Any]:
        """The space as JSON values."""
        readings = {"distance_from": self.distance_from, "spacing_is": self.spacing_is}
        return {"bounds": self.bounds.model_dump(mode="json"), **readings}

    def holds(self, key: Key) -> bool:
        """Whether the design lies in the bounds, its faces included, and can be built."""
        low, high = self._limits
        inside = all(a <= x <= b for a, x, b in zip(low, key, high, strict=True))
        return inside and self.builds(key)

    def builds(self, key: Key) -> bool:
        """Whether the design can be built, in the bounds or not."""
        return _can_be_built(key[:4], self.distance_from, self.spacing_is)

    def moved(self, key: Key, move: Move) -> Key:
        """Where a move leads, in the bounds or not: a variable plus so many steps, to 1e-6 um."""
        i = Design.FIELDS.index(move.variable)
        value = round(key[i] + move.steps * self._step[i], LENGTH_DECIMALS)
        return (*key[:i], value, *key[i + 1 :])

    def draw(self, random: np.random.Generator, asked: Container[Key] = ()) -> Key | None:
        """A design of the grid that can be built, each as likely, none of `asked`; None where no other is left."""
        axes = self._axes
        for _ in range(TRIES):
            key = tuple(axis[random.integers(len(axis))] for axis in axes)
            if key not in asked and self.holds(key):
                return key
        return next((key for key in map(key_of, self.bounds.grid()) if key not in asked and self.holds(key)), None)

    @functools.cached_property
    def _axes(self) -> tuple[tuple[float, ...], ...]:
        return tuple(self.bounds.values(name) for name in Design.FIELDS)

    @functools.cached_property
    def _limits(self) -> tuple[Key, Key]:
        return key_of(self.bounds.low), key_of(self.bounds.high)

    @functools.cached_property
    def _step(self) -> Key:
        return key_of(self.bounds.step)


class Moves:
    """The actions of a profile in a space: their numbers, and which of them may be taken where."""

    def __init__(self, space: Space, profile: Profile) -> None:
        self.space = space
        self.all = moves_of(profile)
        self.number = {move: i for i, move in enumerate(self.all)}
        self._change = np.zeros((len(self.all), len(Design.FIELDS)))
        for i, move in enumerate(self.all):
            column = Design.FIELDS.index(move.variable)
            self._change[i, column] = move.steps * getattr(space.bounds.step, move.variable)
        self._low, self._high = space.bounds.low.as_vector(), space.bounds.high.as_vector()

    def __len__(self) -> int:
        return len(self.all)

    def mask(self, key: Key, known: Container[Key] = (), build: bool = True) -> NDArray[np.bool_]:
        """Which moves may be taken from a design, shape (moves,): those that stay in the bounds.

        `build` leaves out those to what cannot be built, `known` those to a design that it holds.
        """
        reached = np.round(np.array(key) + self._change, LENGTH_DECIMALS)
        allowed: NDArray[np.bool_] = np.all((reached >= self._low) & (reached <= self._high), axis=1)
        for i in np.flatnonzero(allowed):
            target = tuple(reached[i].tolist())
            allowed[i] = target not in known and (not build or self.space.builds(target))
        return allowed


def start_of(space: Space, start: Design | None) -> Key | None:
    """The key of a start design; raises InputError where it lies outside or cannot be built."""
    if start is None:
        return None
    if not space.holds(key_of(start)):
        reason = start.feasibility(space.distance_from, space.spacing_is) or "it lies outside the bounds"
        raise InputError("start", str(start), "a design in the bounds that can be built", reason)
    return key_of(start)
