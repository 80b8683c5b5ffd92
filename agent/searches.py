"""Designers that learn nothing: random, pattern and grid. What every learner is to be compared with.

random    designs of the grid, each equally likely, none twice
pattern   coordinate search about the best design of a lane: steps of 8, then 4, 2, 1; at its end a new random start
grid      every design of the bounds, film by film and chip by chip: the paper's "entire loop"
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from agent.ask_tell import Checkpoint, Known, Lanes, Proposal, refuse_another
from agent.moves import Key, Space, start_of
from luxloop.campaign import Step
from luxloop.design import LENGTH_DECIMALS, Design

SCALES = (8, 4, 2, 1)
STARTS = 3  # what this file's streams of random numbers are for


class Search:
    """What the three have in common: lanes, known designs, one stream of random numbers for each lane."""

    name = "search"

    def __init__(self, space: Space, *, seed: int = 0, lanes: int = 1) -> None:
        self.space, self.known, self.finished = space, Known(), False
        self._lanes = Lanes(lanes)
        self._random = [np.random.default_rng([seed, STARTS, lane]) for lane in range(lanes)]
        self._settings: dict[str, Any] = {"space": space.plain(), "seed": seed, "lanes": lanes}

    def ask(self, lane: int) -> Proposal | None:
        """The next design of this lane; None, for good, where there is none."""
        key = None if self.finished else self._next(lane)
        if key is None:
            self.finished = True
            return None
        self.known.ask(key)
        return self._lanes.ask(lane, design=key)

    def tell(self, lane: int, step: Step) -> None:
        """Takes a step; a failed one is forgotten."""
        self._lanes.told(lane, step)
        self._take(lane, None if step.failure is not None else self.known.tell(step))

    def learn(self) -> None:
        """Nothing: a search does not learn."""

    def awaited(self, lane: int) -> Proposal | None:
        """The proposal of this lane that was not told yet."""
        return self._lanes.awaited[lane]

    def state(self) -> Checkpoint:
        """All that the search is."""
        random = [stream.bit_generator.state for stream in self._random]
        words = {"name": self.name, "settings": self._settings, "finished": self.finished, "random": random}
        return Checkpoint({**words, "lanes": self._lanes.state(), "own": self._own()}, dict(self.known.state()))

    def restore(self, checkpoint: Checkpoint) -> None:
        """Becomes what `state` was taken from."""
        words = checkpoint.words
        refuse_another(checkpoint, self.name, self._settings)
        self.finished = words["finished"]
        for stream, state in zip(self._random, words["random"], strict=True):
            stream.bit_generator.state = state
        self._lanes.restore(words["lanes"])
        self.known.restore(checkpoint.arrays)
        self._become(words["own"])

    def _next(self, lane: int) -> Key | None:
        """The design to ask for."""
        raise NotImplementedError

    def _take(self, lane: int, key: Key | None) -> None:
        """The design of the lane is known now; None: it failed."""

    def _own(self) -> Any:
        """What only this kind of search keeps, as JSON values."""

    def _become(self, own: Any) -> None:
        """The same, back again."""


class RandomSearch(Search):
    """Designs of the grid that can be built, each equally likely, none twice."""

    name = "random"

    def _next(self, lane: int) -> Key | None:
        return self.space.draw(self._random[lane], self.known.asked)


@dataclass
class Climb:
    """A lane's place in the pattern: the centre, the scale, the direction tried, how many have failed in a row."""

    centre: Key | None = None
    scale: int = 0
    direction: int = 0
    failed: int = 0


class PatternSearch(Search):
    """Coordinate search in 8, 4, 2, 1 of the bounds' steps; each lane climbs for itself, all share what is known.

    The first design that is better becomes the centre and the search goes on in the same direction; when all ten
    directions fail the scale goes down, and after the last one the lane begins at a random design never asked for.
    """

    name = "pattern"

    def __init__(self, space: Space, *, seed: int = 0, lanes: int = 1, start: Design | None = None) -> None:
        super().__init__(space, seed=seed, lanes=lanes)
        self._start = start_of(space, start)
        self._settings["start"] = self._start and list(self._start)
        self._climbs = [Climb() for _ in range(lanes)]
        self._units = [i * sign for i in range(1, len(Design.FIELDS) + 1) for sign in (1, -1)]
        self._step = space.bounds.step.as_vector()

    def _next(self, lane: int) -> Key | None:
        climb = self._climbs[lane]
        while climb.centre is not None and climb.scale < len(SCALES):
            key = self._tried(climb, climb.centre)
            if key not in self.known.uniformity and self.space.holds(key):
                return key
            self._compare(climb, climb.centre, key)
        self._climbs[lane] = Climb()
        if self._start and self._start not in self.known:
            return self._start
        return self.space.draw(self._random[lane], self.known.asked)

    def _take(self, lane: int, key: Key | None) -> None:
        climb = self._climbs[lane]
        if key is None:
            self._climbs[lane] = Climb()
        elif climb.centre is None:
            climb.centre = key
        else:
            self._compare(climb, climb.centre, key)

    def _tried(self, climb: Climb, centre: Key) -> Key:
        """The design that the climb looks at now."""
        unit = self._units[climb.direction]
        i = abs(unit) - 1
        value = centre[i] + math.copysign(SCALES[climb.scale], unit) * self._step[i]
        return (*centre[:i], round(float(value), LENGTH_DECIMALS), *centre[i + 1 :])

    def _compare(self, climb: Climb, centre: Key, key: Key) -> None:
        """Goes to `key` where it is better than the centre; else to the next direction, or the next scale."""
        if self.known.uniformity.get(key, -math.inf) > self.known.uniformity[centre]:
            climb.centre, climb.failed = key, 0
            return
        climb.direction, climb.failed = (climb.direction + 1) % len(self._units), climb.failed + 1
        if climb.failed == len(self._units):
            climb.scale, climb.failed = climb.scale + 1, 0

    def _own(self) -> Any:
        return [asdict(climb) for climb in self._climbs]

    def _become(self, own: Any) -> None:
        self._climbs = [Climb(**{**climb, "centre": climb["centre"] and tuple(climb["centre"])}) for climb in own]


class GridSearch(Search):
    """Every design of the bounds that can be built, once; those that failed are in `failed`.

    Pairs change slowest (a film table each), then W and T (a chip's exits), then D (a direct map), S fastest.
    """

    name = "grid"
    SLOWEST_FIRST = ("dbr_pairs", "width_um", "thickness_um", "distance_um", "spacing_um")

    def __init__(self, space: Space, *, seed: int = 0, lanes: int = 1) -> None:
        super().__init__(space, seed=seed, lanes=lanes)
        self.index, self.failed = 0, 0
        self._axes = [space.bounds.values(name) for name in self.SLOWEST_FIRST]

    def design(self, index: int) -> Key:
        """The design of that number, whether it can be built or not."""
        values = {}
        for name, axis in zip(reversed(self.SLOWEST_FIRST), reversed(self._axes), strict=True):
            index, place = divmod(index, len(axis))
            values[name] = axis[place]
        return tuple(values[name] for name in Design.FIELDS)

    def _next(self, _lane: int) -> Key | None:
        while self.index < self.space.bounds.count:
            key, self.index = self.design(self.index), self.index + 1
            if self.space.holds(key):
                return key
        return None

    def _take(self, _lane: int, key: Key | None) -> None:
        self.failed += key is None

    def _own(self) -> Any:
        return [self.index, self.failed]

    def _become(self, own: Any) -> None:
        self.index, self.failed = own
