"""The replay memory: what was put in comes out, evenly, the oldest gives way."""

from __future__ import annotations

import numpy as np

from agent.memory import Batch, Memory

MOVES = 4


def filled(capacity: int, count: int) -> Memory:
    """A memory with transitions that tell their number in every field."""
    memory = Memory(capacity, MOVES)
    for i in range(count):
        state, following = tuple(i + x / 10 for x in range(5)), tuple(-i - x / 10 for x in range(5))
        memory.put(state, i % MOVES, 10.0 * i, following, np.arange(MOVES) < i % (MOVES + 1))
    return memory


def test_a_transition_comes_out_as_it_went_in() -> None:
    """State, action, reward, what followed, its mask; done where no move is left."""
    memory, batch = filled(100, 20), Batch.empty(400, MOVES)
    memory.draw(np.random.default_rng(0), batch)
    number = (batch.reward / 10.0).astype(int)
    assert set(number.ravel()) == set(range(20))
    digits = np.arange(5) / 10
    np.testing.assert_allclose(batch.state, number + digits, rtol=1e-6)
    np.testing.assert_allclose(batch.following, -number - digits, rtol=1e-6)
    np.testing.assert_array_equal(batch.action, number % MOVES)
    np.testing.assert_array_equal(batch.allowed.sum(axis=1), (number % (MOVES + 1)).ravel())
    np.testing.assert_array_equal(batch.done.ravel() == 1.0, (number % (MOVES + 1) == 0).ravel())


def test_the_oldest_give_way() -> None:
    """Of 25 transitions a memory of 10 keeps the last 10."""
    memory, batch = filled(10, 25), Batch.empty(500, MOVES)
    memory.draw(np.random.default_rng(0), batch)
    assert len(memory) == 10
    assert set((batch.reward / 10.0).astype(int).ravel()) == set(range(15, 25))


def test_draws_are_even() -> None:
    """Each of 20 transitions is drawn a twentieth of the time, within five standard errors."""
    memory, batch = filled(100, 20), Batch.empty(20_000, MOVES)
    memory.draw(np.random.default_rng(3), batch)
    counts = np.bincount((batch.reward / 10.0).astype(int).ravel(), minlength=20)
    assert np.abs(counts - 1000).max() < 5 * np.sqrt(1000 * 0.95)


def test_a_restored_memory_goes_on_as_the_first() -> None:
    """The same draws and the same places after a round trip, also when it has wrapped."""
    first, second = filled(10, 17), Memory(10, MOVES)
    second.restore(first.state(), first.put_in)
    for memory in (first, second):
        memory.put((1.0,) * 5, 1, 5.0, (2.0,) * 5, np.ones(MOVES, bool))
    drawn = [Batch.empty(64, MOVES) for _ in range(2)]
    for memory, batch in zip((first, second), drawn, strict=True):
        memory.draw(np.random.default_rng(1), batch)
    for ours, theirs in zip(vars(drawn[0]).values(), vars(drawn[1]).values(), strict=True):
        np.testing.assert_array_equal(ours, theirs)
