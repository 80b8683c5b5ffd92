"""CPU time of one update and of choosing one move, beside stable-baselines3's DQN at equal net and batch.

    python benchmarks/learner_cost.py [--repeats 1000]

Both: 5 - 64 - 64 - moves, ReLU, batch 32, Adam, one torch thread, on the same transitions; CPU time of the process in
turns of 50, so that whatever else the machine does hits both alike. Targets: update 0.6 ms, choosing 15 us.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable

os.environ.setdefault("OMP_NUM_THREADS", "1")

import gymnasium
import numpy as np
import torch

from agent.ddqn import PRESETS, Learner, act
from agent.memory import Memory
from agent.moves import Profile, moves_of
from benchmarks.processes import percentile, table

TURN = 50


class Nowhere(gymnasium.Env[np.ndarray, np.int64]):
    """An environment that only says how large its spaces are."""

    def __init__(self, moves: int) -> None:
        self.observation_space = gymnasium.spaces.Box(-1.0, 1.0, (5,), np.float32)
        self.action_space = gymnasium.spaces.Discrete(moves)


def cpu_us(what: dict[str, Callable[[], object]], repeats: int) -> dict[str, list[float]]:
    """CPU time per call in us, mean of each turn, the turns of all taken by turns."""
    took: dict[str, list[float]] = {name: [] for name in what}
    for turn in range(-2, repeats // TURN):
        for name, call in what.items():
            begin = time.process_time_ns()
            for _ in range(TURN):
                call()
            if turn >= 0:
                took[name].append((time.process_time_ns() - begin) / TURN / 1e3)
    return took


def ours(profile: Profile) -> dict[str, Callable[[], object]]:
    """An update, minibatch included; choosing a move with the numpy copy, and with torch for comparison."""
    moves = len(moves_of(profile))
    learner, memory = Learner(PRESETS[profile], moves, seed=1), Memory(10_000, moves)
    random = np.random.default_rng(1)
    for _ in range(10_000):
        state, following = (tuple(random.uniform(-1.0, 1.0, 5)) for _ in range(2))
        memory.put(state, int(random.integers(moves)), float(random.normal()), following, random.random(moves) < 0.8)
    weights, state32 = learner.weights(), random.uniform(-1.0, 1.0, 5).astype(np.float32)
    allowed = random.random(moves) < 0.8

    def update() -> None:
        memory.draw(random, learner.batch)
        learner.update()

    return {
        f"luxloop, update, {moves} moves": update,
        f"luxloop, choosing, {moves} moves": lambda: np.where(allowed, act(weights, state32), -np.inf).argmax(),
    }


def theirs(profile: Profile) -> dict[str, Callable[[], object]]:
    """The same of stable-baselines3: its `train` of one gradient step, its `predict`."""
    try:
        from stable_baselines3 import DQN
        from stable_baselines3.common.logger import configure
    except ImportError:
        return {}
    moves = len(moves_of(profile))
    model = DQN(
        "MlpPolicy",
        Nowhere(moves),
        batch_size=32,
        buffer_size=10_000,
        policy_kwargs={"net_arch": [64, 64]},
        device="cpu",
    )
    model.set_logger(configure(None, []))
    random, memory = np.random.default_rng(1), model.replay_buffer
    assert memory is not None
    for _ in range(10_000):
        state, following = (random.uniform(-1.0, 1.0, (1, 5)).astype(np.float32) for _ in range(2))
        action, reward = random.integers(moves, size=(1, 1)), random.normal(size=1)
        memory.add(state, following, action, reward, np.zeros(1), [{}])
    state32 = random.uniform(-1.0, 1.0, 5).astype(np.float32)
    return {
        f"stable-baselines3, update, {moves} moves": lambda: model.train(1, 32),
        f"stable-baselines3, choosing, {moves} moves": lambda: model.predict(state32, deterministic=True),
    }


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--repeats", type=int, default=1000)
    repeats = parser.parse_args().repeats
    rows: list[list[object]] = []
    for profile in ("paper", "fast"):
        took = cpu_us(ours(profile) | theirs(profile), repeats)
        for name, us in took.items():
            target = 600 if "update" in name else 15
            rows.append(
                [name, f"{percentile(us, 50):.1f}", f"{percentile(us, 10):.1f}", target if "lux" in name else ""]
            )
    table(
        f"CPU time per call, torch {torch.__version__}", rows, ["what", "median us", "10th percentile us", "target"]
    )
