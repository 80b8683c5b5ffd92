"""The double DQN, whole: hyper-parameters, network, update (Eqs. 6 and 7), and its walk through the designs.

    tell(step t)   the updates still due are done; transition t goes into the replay memory; new updates fall due
    ask            epsilon-greedy, with a numpy copy of the weights as they were at the last `tell`
    learn          the updates that are due, while step t + 1 is awaited

    y = r + gamma Q(s', argmax_a' Q(s', a'; theta); theta')          Eq. 6: theta chooses, theta' values
    L = mean over the minibatch of huber(y - Q(s, a; theta))         Eq. 7, with Huber's loss for the square

An episode is a walk of a fixed number of moves from a design; its end is not the world's end, so the value of what
follows still counts in y. Only a design from which no move is allowed ends the sum. The trajectory depends on the
seed and on the steps told alone: so many updates for each transition, no clock, one torch thread.
"""

from __future__ import annotations

import functools
import hashlib
import itertools
from dataclasses import asdict, dataclass
from types import ModuleType
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from agent.ask_tell import Checkpoint, Known, Lanes, Proposal, refuse_another
from agent.memory import Batch, Memory
from agent.moves import Key, Moves, Profile, Space, start_of
from luxloop.campaign import Reward, Step
from luxloop.design import Design
from luxloop.errors import InputError
from luxloop.words import Words

if TYPE_CHECKING:
    import torch

EXPLORE, REPLAY = 1, 2  # what a stream of random numbers is for


class Learning(Words):
    """The hyper-parameters. The defaults are the paper's agent; what the paper leaves open is our reading."""

    profile: Profile = Field("paper", description="Actions: the paper's 10, or 40 with steps x1, x2, x4, x8.")
    reward: Reward = Field("r1", description="What the plan of the run is to reward.")
    budget: int = Field(16_000, ge=1, le=10**7, description="Steps that epsilon is scheduled for.")
    start: Design | None = Field(None, description="Where the first episode begins; none: drawn from the grid.")
    restart: Literal["random", "start", "best"] = Field(
        "random", description="Where later episodes begin: drawn from the grid, at `start`, or at the best design."
    )
    patience: int | None = Field(
        None,
        ge=1,
        le=10**6,
        description="With `best`: episodes without a better design until it begins afresh elsewhere.",
    )
    episode: int = Field(50, ge=1, le=100_000, description="Moves in an episode.")
    gamma: float = Field(0.9, ge=0.0, lt=1.0, description="Discount of the following reward.")
    epsilon_first: float = Field(1.0, ge=0.0, le=1.0, description="Share of random moves at the beginning.")
    epsilon_last: float = Field(0.05, ge=0.0, le=1.0, description="The same at the end.")
    exploration: float = Field(
        0.5, gt=0.0, le=1.0, description="Share of the budget over which epsilon falls, evenly."
    )
    mask_infeasible: bool = Field(True, description="Moves to what cannot be built are not offered.")
    mask_known: bool = Field(False, description="Moves to designs asked for before are not offered.")
    replay: int = Field(10_000, ge=1, le=10**6, description="Transitions kept; the oldest is overwritten.")
    batch: int = Field(32, ge=1, le=4096, description="Transitions in a minibatch; learning begins with so many.")
    updates: int = Field(1, ge=0, le=64, description="Updates for each transition.")
    target_period: int = Field(500, ge=1, le=10**6, description="Updates between copies of theta to theta'.")
    learning_rate: float = Field(1e-3, gt=0.0, le=1.0, description="Of Adam.")
    width: int = Field(64, ge=1, le=1024, description="Neurons in each of the two hidden layers (ReLU).")
    random_actions: bool = Field(False, description="No network: every move is random. The ablation of all learning.")

    @model_validator(mode="after")
    def _a_minibatch_comes_together(self) -> Learning:
        if self.batch > self.replay:
            raise InputError("batch", self.batch, f"at most replay, {self.replay}", "else nothing is ever learnt")
        return self

    @property
    def name(self) -> str:
        """What the designer is called in tables and journals."""
        return f"ddqn-{self.profile}" + "-random" * self.random_actions

    def epsilon(self, steps: int) -> float:
        """The share of random moves after so many steps of all lanes."""
        if self.random_actions:
            return 1.0
        done = min(1.0, steps / (self.exploration * self.budget))
        return self.epsilon_first + done * (self.epsilon_last - self.epsilon_first)


PRESETS: dict[Profile, Learning] = {
    "paper": Learning(),
    "fast": Learning(
        profile="fast",
        reward="gain",
        budget=2_000,
        restart="best",
        patience=10,
        episode=10,
        gamma=0.5,
        epsilon_last=0.1,
        exploration=0.05,
        mask_known=True,
        updates=4,
        target_period=50,
    ),
}


@functools.cache
def _torch() -> ModuleType:
    """torch, set up to compute the same twice: one thread (two cost 26 times as much), deterministic kernels."""
    import torch

    torch.set_num_threads(1)
    # the same switch as `use_deterministic_algorithms`, which in torch 2.13 also imports the compiler
    torch.set_deterministic_debug_mode("error")
    # memory is never read before it is written here, and filling it costs half of an update again
    deterministic: Any = torch.utils.deterministic  # its properties are made at run time
    deterministic.fill_uninitialized_memory = False
    return torch


def q_values(weights: list[torch.Tensor], state: torch.Tensor) -> torch.Tensor:
    """Q(s, .; theta), shape (n, moves), of states (n, 5) in [-1, 1]; `weights`: W, b of each of the three layers."""
    linear, relu = _torch().nn.functional.linear, _torch().nn.functional.relu
    hidden = relu(linear(relu(linear(state, *weights[0:2])), *weights[2:4]))
    values: torch.Tensor = linear(hidden, *weights[4:6])
    return values


def target_values(
    reward: torch.Tensor,
    done: torch.Tensor,
    ours: torch.Tensor,
    theirs: torch.Tensor,
    allowed: torch.Tensor,
    gamma: float,
) -> torch.Tensor:
    """y of Eq. 6, shape (n, 1): of the allowed moves `ours` = Q(s'; theta) chooses, `theirs` = Q(s'; theta') values.

    reward, done: (n, 1); ours, theirs, allowed: (n, moves).
    """
    chosen = ours.masked_fill(~allowed, -float("inf")).argmax(dim=1, keepdim=True)
    return reward + gamma * (1.0 - done) * theirs.gather(1, chosen)


def act(weights: list[NDArray[np.float32]], state: NDArray[np.float32]) -> NDArray[np.float32]:
    """Q(s, .; theta) of one state, shape (moves,), in numpy: a third of the time that torch takes for one state."""
    first, first_bias, second, second_bias, last, last_bias = weights
    hidden = np.maximum(first @ state + first_bias, 0.0)
    hidden = np.maximum(second @ hidden + second_bias, 0.0)
    values: NDArray[np.float32] = last @ hidden + last_bias
    return values


class Adam:
    """torch's fused Adam by its function: the class imports torch's compiler, 1.5 s of a process that learns."""

    def __init__(self, weights: list[torch.Tensor], rate: float) -> None:
        torch = _torch()
        self.weights, self.rate = weights, rate
        self.step_count = [torch.zeros((), dtype=torch.float32) for _ in weights]
        self.mean, self.square = ([torch.zeros_like(weight) for weight in weights] for _ in range(2))

    def step(self) -> None:
        """Move the weights by their gradients, which all of them have, and let go of these."""
        from torch.optim.adam import adam

        slopes = [weight.grad for weight in self.weights if weight.grad is not None]  # a type checker's question
        with _torch().no_grad():
            adam(
                self.weights, slopes, self.mean, self.square, [], self.step_count, fused=True,
                amsgrad=False, maximize=False, weight_decay=0.0, beta1=0.9, beta2=0.999, eps=1e-8, lr=self.rate,
            )  # fmt: skip
        for weight in self.weights:
            weight.grad = None

    def memory(self, i: int) -> dict[str, torch.Tensor]:
        """What is remembered of the i-th weights, by torch's names."""
        return {"step": self.step_count[i], "exp_avg": self.mean[i], "exp_avg_sq": self.square[i]}


class Learner:
    """The two networks theta and theta', and Adam: what learns from minibatches."""

    theta: list[torch.Tensor]
    target: list[torch.Tensor]
    loss: torch.Tensor | None

    def __init__(self, learning: Learning, moves: int, seed: int) -> None:
        torch = _torch()
        self.learning, self.updates = learning, 0
        self.loss = None
        random = torch.Generator().manual_seed(seed)
        self.theta = []
        sizes = (len(Design.FIELDS), learning.width, learning.width, moves)
        for n_in, n_out in itertools.pairwise(sizes):
            for shape in ((n_out, n_in), (n_out,)):
                drawn = torch.empty(shape).uniform_(-(n_in**-0.5), n_in**-0.5, generator=random)
                self.theta.append(drawn.requires_grad_())
        self.target = [parameter.detach().clone() for parameter in self.theta]
        self.adam = Adam(self.theta, learning.learning_rate)
        self.batch = Batch.empty(learning.batch, moves)
        self._tensors = {name: torch.from_numpy(array) for name, array in vars(self.batch).items()}

    def update(self) -> None:
        """One step of Adam on the transitions in `self.batch`."""
        torch, batch = _torch(), self._tensors
        with torch.no_grad():
            ours, theirs = (q_values(weights, batch["following"]) for weights in (self.theta, self.target))
            y = target_values(batch["reward"], batch["done"], ours, theirs, batch["allowed"], self.learning.gamma)
        loss = torch.nn.functional.huber_loss(q_values(self.theta, batch["state"]).gather(1, batch["action"]), y)
        loss.backward()
        self.adam.step()
        self.updates, self.loss = self.updates + 1, loss.detach()
        if self.updates % self.learning.target_period == 0:
            torch._foreach_copy_(self.target, [parameter.detach() for parameter in self.theta])

    def weights(self) -> list[NDArray[np.float32]]:
        """A copy of theta."""
        return [parameter.detach().numpy().copy() for parameter in self.theta]

    def state(self) -> dict[str, NDArray[Any]]:
        """theta, theta' and what Adam remembers."""
        arrays = {"loss": np.array(np.nan if self.loss is None else float(self.loss), np.float32)}
        for i, (parameter, copy) in enumerate(zip(self.theta, self.target, strict=True)):
            arrays |= {f"theta_{i}": parameter.detach().numpy().copy(), f"target_{i}": copy.numpy().copy()}
            if self.updates:
                arrays |= {f"adam_{i}_{name}": kept.numpy().copy() for name, kept in self.adam.memory(i).items()}
        return arrays

    def restore(self, arrays: dict[str, NDArray[Any]], updates: int) -> None:
        """The learner as it was after so many updates."""
        torch = _torch()
        self.updates, self.loss = updates, torch.from_numpy(arrays["loss"]) if updates else None
        for i, parameter in enumerate(self.theta):
            parameter.data.copy_(torch.from_numpy(arrays[f"theta_{i}"]))
            self.target[i].copy_(torch.from_numpy(arrays[f"target_{i}"]))
            for name, kept in self.adam.memory(i).items():  # none of it is on record before the first update
                kept.copy_(torch.from_numpy(arrays[f"adam_{i}_{name}"]) if updates else torch.zeros(()))


@dataclass
class Walk:
    """Where a lane is: its design (None: it begins anew), moves made in this episode, the episode's number."""

    key: Key | None = None
    state: tuple[float, ...] = ()
    moves: int = 0
    episode: int = 0


@dataclass
class Climb:
    """What `restart = "best"` goes by: the designs told after the first `since`, the best, the episode it came in."""

    since: int = 0
    top: float | None = None
    gained: int = 0


class DoubleDqn:
    """The paper's designing agent, in lanes that share one network; `agent.ask_tell` has the order of calls."""

    def __init__(self, space: Space, learning: Learning, *, seed: int, lanes: int = 1) -> None:
        self.name, self.learning, self.finished = learning.name, learning, False
        self.space, self.moves = space, Moves(space, learning.profile)
        self.known, self.steps, self.episodes, self.due = Known(), 0, 0, 0
        self._start = start_of(space, learning.start)
        self._settings = {
            "learning": learning.model_dump(mode="json"),
            "space": space.plain(),
            "seed": seed,
            "lanes": lanes,
        }
        self._climb = Climb()
        self._learnt: dict[str, Any] = {}
        self._seen: list[NDArray[np.float32]] = []
        self._lanes, self._walks = Lanes(lanes), [Walk() for _ in range(lanes)]
        self._explore = [np.random.default_rng([seed, EXPLORE, lane]) for lane in range(lanes)]
        self._replay = np.random.default_rng([seed, REPLAY])
        self.memory = Memory(learning.replay, len(self.moves))
        self.learner = None if learning.random_actions else Learner(learning, len(self.moves), seed)
        self._see(self.learner.weights() if self.learner else [])

    def ask(self, lane: int) -> Proposal | None:
        """The next move of this lane's walk, or the design its next episode begins at; None where nothing is left."""
        walk, random = self._walks[lane], self._explore[lane]
        key = walk.key
        if key is None or walk.moves == self.learning.episode or not self._allowed(key).any():
            key = self._beginning(walk, random)
            if key is None:
                self.finished = True
                return None
            self.episodes, walk.episode, walk.moves = self.episodes + 1, self.episodes, 0
            if key != walk.key:
                self.known.ask(key)
                return self._lanes.ask(lane, design=key, **self._record(walk))
        number, greedy, q = self._choose(walk.state, self._allowed(key), random)
        walk.moves += 1
        self.known.ask(self.space.moved(key, self.moves.all[number]))
        return self._lanes.ask(lane, move=self.moves.all[number], greedy=greedy, q=q, **self._record(walk))

    def tell(self, lane: int, step: Step) -> None:
        """Takes a step: into the memory where it came of a move, new updates fall due; a failed one is forgotten."""
        proposal, walk = self._lanes.told(lane, step), self._walks[lane]
        self.learn()
        self._see(self.learner.weights() if self.learner else [])
        if step.failure is not None:
            walk.key = None
            return
        self.steps += 1
        before, walk.key, walk.state = walk.state, self.known.tell(step), step.state
        if self._climb.top is None or step.uniformity > self._climb.top:
            self._climb.top, self._climb.gained = step.uniformity, self.episodes
        if proposal.move is not None and self.learner is not None:
            number = self.moves.number[proposal.move]
            self.memory.put(before, number, step.reward, step.state, self._allowed(walk.key))
            if len(self.memory) >= self.learning.batch:
                self.due = self.learning.updates

    def learn(self) -> None:
        """The updates that are due; the moves asked for before the next `tell` do not see them."""
        if self.learner is not None:
            for _ in range(self.due):
                self.memory.draw(self._replay, self.learner.batch)
                self.learner.update()
        self.due = 0

    def awaited(self, lane: int) -> Proposal | None:
        """The proposal of this lane that was not told yet."""
        return self._lanes.awaited[lane]

    def state(self) -> Checkpoint:
        """Networks, Adam, memory, streams of random numbers, walks, proposals under way; updates due are done."""
        self.learn()
        words = {
            "name": self.name,
            "settings": self._settings,
            "counts": [self.steps, self.episodes, self.memory.put_in, self.learner.updates if self.learner else 0],
            "finished": self.finished,
            "learnt": self._learnt,
            "lanes": self._lanes.state(),
            "climb": asdict(self._climb),
            "walks": [asdict(walk) for walk in self._walks],
            "random": [stream.bit_generator.state for stream in (*self._explore, self._replay)],
        }
        arrays = {**self.known.state(), **self.memory.state(), **(self.learner.state() if self.learner else {})}
        return Checkpoint(words, {**arrays, **{f"seen_{i}": array for i, array in enumerate(self._seen)}})

    def restore(self, checkpoint: Checkpoint) -> None:
        """Becomes what `state` was taken from."""
        words, arrays = checkpoint.words, checkpoint.arrays
        refuse_another(checkpoint, self.name, self._settings)
        self.steps, self.episodes, put_in, updates = words["counts"]
        self.finished = words["finished"]
        self._lanes.restore(words["lanes"])
        self._climb = Climb(**words["climb"])
        self._walks = [Walk(**{**walk, "key": walk["key"] and tuple(walk["key"])}) for walk in words["walks"]]
        for stream, state in zip((*self._explore, self._replay), words["random"], strict=True):
            stream.bit_generator.state = state
        self.known.restore(arrays)
        self.memory.restore(arrays, put_in)
        if self.learner is not None:
            self.learner.restore(arrays, updates)
        self._seen = [arrays[f"seen_{i}"] for i in range(len(self._seen))]
        self._learnt = words["learnt"]
        self.due = 0

    def _allowed(self, key: Key) -> NDArray[np.bool_]:
        known = self.known if self.learning.mask_known else ()
        return self.moves.mask(key, known, build=self.learning.mask_infeasible)

    def _beginning(self, walk: Walk, random: np.random.Generator) -> Key | None:
        """Where an episode begins, by the rule `restart`; None where no walk is left in the whole space."""
        asked = self.known.asked if self.learning.mask_known else ()
        if self.learning.restart == "best":
            if self.learning.patience and self.episodes - self._climb.gained >= self.learning.patience:
                self._climb = Climb(since=self.known.evaluations, gained=self.episodes)
            for key in self.known.best_first(self._climb.since):
                if self._allowed(key).any():
                    return key
        elif self.learning.restart == "start" and self._start:
            return None if self._start == walk.key and walk.moves == 0 else self._start
        if self._start and self._start not in self.known:
            return self._start
        drawn = self.space.draw(random, asked)
        nowhere_to_go = drawn is not None and drawn == walk.key and not self._allowed(drawn).any()
        return None if nowhere_to_go else drawn

    def _choose(
        self, state: tuple[float, ...], allowed: NDArray[np.bool_], random: np.random.Generator
    ) -> tuple[int, bool, float | None]:
        """The number of a move, epsilon-greedy; whether it is the greedy one; its Q."""
        if random.random() < self.learning.epsilon(self.steps):
            return int(random.choice(np.flatnonzero(allowed))), False, None
        q = np.where(allowed, act(self._seen, np.array(state, np.float32)), -np.inf)
        best = int(q.argmax())
        return best, True, float(q[best])

    def _see(self, weights: list[NDArray[np.float32]]) -> None:
        """From now on moves are chosen with these weights, and the record says what the learner was like then."""
        self._seen, learner = weights, self.learner
        if learner is not None:
            whole = hashlib.sha256(b"".join(array.astype("<f4").tobytes() for array in weights))
            loss = None if learner.loss is None else float(learner.loss)
            self._learnt = {"loss": loss, "updates": learner.updates, "weights_sha256": whole.hexdigest()}

    def _record(self, walk: Walk) -> dict[str, Any]:
        return {"episode": walk.episode, "epsilon": self.learning.epsilon(self.steps), **self._learnt}
