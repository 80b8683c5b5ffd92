"""The replay memory: transitions in preallocated arrays, the oldest overwritten, drawn from evenly."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Batch:
    """Transitions side by side, n of them.

    state, following: float32 (n, 5), designs in [-1, 1]; action: int64 (n, 1); reward: float32 (n, 1);
    allowed: bool (n, moves), the moves that may follow; done: float32 (n, 1), 1 where none may.
    """

    state: NDArray[np.float32]
    action: NDArray[np.int64]
    reward: NDArray[np.float32]
    following: NDArray[np.float32]
    allowed: NDArray[np.bool_]
    done: NDArray[np.float32]

    @classmethod
    def empty(cls, n: int, moves: int, variables: int = 5) -> Batch:
        """Room for n transitions."""
        return cls(
            state=np.zeros((n, variables), np.float32),
            action=np.zeros((n, 1), np.int64),
            reward=np.zeros((n, 1), np.float32),
            following=np.zeros((n, variables), np.float32),
            allowed=np.zeros((n, moves), np.bool_),
            done=np.zeros((n, 1), np.float32),
        )


FIELDS = tuple(Batch.__dataclass_fields__)


class Memory:
    """The last `capacity` transitions, in the order they were put in."""

    def __init__(self, capacity: int, moves: int) -> None:
        self.capacity, self.put_in = capacity, 0
        self._kept = Batch.empty(capacity, moves)

    def __len__(self) -> int:
        return min(self.put_in, self.capacity)

    def put(
        self,
        state: tuple[float, ...],
        action: int,
        reward: float,
        following: tuple[float, ...],
        allowed: NDArray[np.bool_],
    ) -> None:
        """Keeps a transition, in the place of the oldest where the memory is full."""
        kept, i = self._kept, self.put_in % self.capacity
        kept.state[i], kept.action[i], kept.reward[i] = state, action, reward
        kept.following[i], kept.allowed[i], kept.done[i] = following, allowed, not allowed.any()
        self.put_in += 1

    def draw(self, random: np.random.Generator, into: Batch) -> None:
        """Fills `into` with transitions drawn evenly, with replacement."""
        which = random.integers(len(self), size=len(into.reward))
        for name in FIELDS:
            np.take(getattr(self._kept, name), which, axis=0, out=getattr(into, name), mode="clip")

    def state(self) -> dict[str, NDArray[Any]]:
        """What is kept, as arrays."""
        return {f"memory_{name}": getattr(self._kept, name)[: len(self)].copy() for name in FIELDS}

    def restore(self, arrays: dict[str, NDArray[Any]], put_in: int) -> None:
        """What was kept; `put_in` transitions had come in all."""
        self.put_in = put_in
        for name in FIELDS:
            getattr(self._kept, name)[: len(self)] = arrays[f"memory_{name}"]
