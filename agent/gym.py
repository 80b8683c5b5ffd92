"""Gymnasium's view of a run: an environment, and a vector of them, over the same door that the designers use.

    observation   the design in [-1, 1] of the bounds, float32 (5,)
    action        the number of a move of the profile, 0 to 9 (`paper`) or 0 to 39 (`fast`)
    reward        as the run's plan says; a move outside the bounds leads nowhere, to what cannot be built U = 0
    info          design, uniformity, its error, reason, and `action_mask`: the moves worth taking, int8 (moves,)

Every episode ends by its length (`truncated`); a design is never an end in itself. A step that could not be evaluated
raises `RemoteError`.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Protocol

import gymnasium
import numpy as np
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from agent.moves import Moves, Profile, Space, key_of
from luxloop.campaign import Action, Move, Step
from luxloop.design import Design
from luxloop.errors import InputError, RemoteError

State = NDArray[np.float32]
Info = dict[str, Any]


class Door(Protocol):
    """The way to the environment-control agent."""

    def act(self, action: Action) -> Step:
        """The step that came of an action; vector environments call it from one thread for each lane."""


class Lane:
    """One lane of a run behind the door: numbers its actions, knows which moves it has."""

    def __init__(self, door: Door, space: Space, profile: Profile, *, run: str, designer: str, lane: int) -> None:
        self.space, self.moves = space, Moves(space, profile)
        self._act: Callable[[Action], Step] = door.act
        self._names: dict[str, Any] = {"run": run, "designer": designer, "lane": lane}
        self._number = 0

    def begin(self, random: np.random.Generator, design: Design | None) -> tuple[State, Info]:
        """Observation and info at `design`, or at one drawn from the grid."""
        key = key_of(design) if design is not None else self.space.draw(random)
        if key is None:
            raise InputError("bounds", str(self.space.bounds), "a grid with a design that can be built")
        step = self._evaluated(design=Design.from_vector(key))
        return self._seen(step)

    def move(self, number: int) -> tuple[State, float, Info]:
        """Observation, reward and info after the move of that number."""
        step = self._evaluated(move=self.moves.all[number])
        state, info = self._seen(step)
        return state, step.reward, info

    def _evaluated(self, design: Design | None = None, move: Move | None = None) -> Step:
        step = self._act(Action(**self._names, number=self._number, design=design, move=move))
        self._number += 1
        if step.failure is not None:
            raise RemoteError(step.failure)
        return step

    def _seen(self, step: Step) -> tuple[State, Info]:
        info = {
            "design": step.design.as_vector(),
            "uniformity": step.uniformity,
            "uniformity_error": step.uniformity_error,
            "feasible": step.feasible,
            "reason": step.reason,
            "action_mask": self.moves.mask(key_of(step.design)).astype(np.int8),
        }
        return np.array(step.state, np.float32), info


def _spaces(moves: int) -> tuple[Any, Any]:
    """Observation and action space of one lane; Any, for Box is typed for floats of every width at once."""
    return gymnasium.spaces.Box(-1.0, 1.0, (len(Design.FIELDS),), np.float32), gymnasium.spaces.Discrete(moves)


class DesignEnv(gymnasium.Env[State, np.int64]):
    """One lane of a run as an environment; `reset(options={"design": ...})` begins at a design of one's own."""

    def __init__(
        self,
        door: Door,
        space: Space,
        *,
        run: str,
        profile: Profile = "paper",
        episode: int = 50,
        designer: str = "gymnasium",
        lane: int = 0,
    ) -> None:
        self.metadata = {"render_modes": []}
        self._lane = Lane(door, space, profile, run=run, designer=designer, lane=lane)
        self._episode, self._taken = episode, 0
        self.observation_space, self.action_space = _spaces(len(self._lane.moves))

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[State, Info]:
        """Observation and info at the beginning of an episode."""
        super().reset(seed=seed)
        self._taken = 0
        return self._lane.begin(self.np_random, (options or {}).get("design"))

    def step(self, action: np.int64) -> tuple[State, float, bool, bool, Info]:
        """Observation, reward, terminated (never), truncated (at the episode's length), info."""
        state, reward, info = self._lane.move(int(action))
        self._taken += 1
        return state, reward, False, self._taken >= self._episode, info


class VectorDesignEnv(gymnasium.vector.VectorEnv[State, NDArray[np.int64], Any]):
    """Lanes 0 to n - 1 of a run, evaluated at the same time; what comes back is in lane order whoever is first."""

    def __init__(
        self,
        door: Door,
        space: Space,
        *,
        run: str,
        lanes: int,
        profile: Profile = "paper",
        episode: int = 50,
        designer: str = "gymnasium",
    ) -> None:
        self.num_envs = lanes
        self.metadata = {"render_modes": [], "autoreset_mode": gymnasium.vector.AutoresetMode.NEXT_STEP}
        self._lanes = [Lane(door, space, profile, run=run, designer=designer, lane=lane) for lane in range(lanes)]
        self._episode, self._taken = episode, np.zeros(lanes, np.int64)
        self.single_observation_space, self.single_action_space = _spaces(len(self._lanes[0].moves))
        self.observation_space = batch_space(self.single_observation_space, lanes)
        self.action_space = batch_space(self.single_action_space, lanes)
        self._threads = ThreadPoolExecutor(lanes, thread_name_prefix="lane")

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[State, Info]:
        """Observations (lanes, 5) and infos at the beginning of an episode in each lane."""
        if seed is not None or not hasattr(self, "_random"):
            self._random = [np.random.default_rng(own) for own in self._seeds(seed)]
        self._taken[:] = 0
        design = (options or {}).get("design")
        begun = list(self._threads.map(lambda pair: pair[0].begin(pair[1], design), self._pairs()))
        return np.stack([state for state, _ in begun]), self._gathered([info for _, info in begun])

    def step(
        self, actions: NDArray[np.int64]
    ) -> tuple[State, NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], Info]:
        """Observations, rewards, terminated, truncated, infos; a lane whose episode is over begins the next one."""
        over = self._taken >= self._episode

        def one(lane: int) -> tuple[State, float, Info]:
            if over[lane]:
                state, info = self._lanes[lane].begin(self._random[lane], None)
                return state, 0.0, info
            return self._lanes[lane].move(int(actions[lane]))

        made = list(self._threads.map(one, range(self.num_envs)))
        self._taken = np.where(over, 0, self._taken + 1)
        states, rewards = np.stack([state for state, _, _ in made]), np.array([reward for _, reward, _ in made])
        never = np.zeros(self.num_envs, np.bool_)
        return states, rewards, never, self._taken >= self._episode, self._gathered([info for _, _, info in made])

    def close_extras(self, **_: Any) -> None:
        """Ends the threads."""
        self._threads.shutdown()

    def _seeds(self, seed: int | list[int | None] | None) -> list[int | None]:
        """A seed for each lane: those given, or the one given and its successors."""
        if isinstance(seed, list):
            return seed
        return [None if seed is None else seed + lane for lane in range(self.num_envs)]

    def _pairs(self) -> list[tuple[Lane, np.random.Generator]]:
        return list(zip(self._lanes, self._random, strict=True))

    def _gathered(self, infos: list[Info]) -> Info:
        """The infos of all lanes in Gymnasium's form: an array for each name, and one that says who has it."""
        gathered: Info = {}
        for lane, info in enumerate(infos):
            gathered = self._add_info(gathered, info, lane)
        return gathered
