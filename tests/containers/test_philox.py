"""Keyed random numbers: the published generator, one stream for each kind of event, uniform."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from containers.ray_tracing.philox import (
    BOTTOM,
    FACE,
    STREAM_WORDS,
    SUBSTRATE,
    Stream,
    draw,
    follow_up,
    philox4x32,
    start,
)

PUBLISHED = [
    ((0, 0, 0, 0), (0, 0), (0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8)),
    ((0xFFFFFFFF,) * 4, (0xFFFFFFFF,) * 2, (0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD)),
    (
        (0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344),
        (0xA4093822, 0x299F31D0),
        (0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1),
    ),
]
"""Counter, key and words of philox4x32-10 in the known answers of Random123 1.14 (kat_vectors)."""


def stream_of(seed: int, history: int) -> Stream:
    """A stream at the beginning of a history."""
    stream = np.full(STREAM_WORDS, 77, np.uint64)
    start(stream, np.uint64(seed), np.uint64(history))
    return stream


@pytest.mark.parametrize(("counter", "key", "words"), PUBLISHED)
def test_the_generator_gives_the_published_words(
    counter: tuple[int, ...], key: tuple[int, int], words: tuple[int, ...]
) -> None:
    """Ten rounds of Philox4x32."""
    found = philox4x32(*map(np.uint64, counter), np.uint64(key[0] | key[1] << 32))
    assert tuple(map(int, found)) == words


def test_events_of_one_kind_do_not_disturb_another() -> None:
    """However many faces a ray has met, its next substrate hit draws the same numbers."""
    quiet, busy = stream_of(3, 12), stream_of(3, 12)
    for event in range(50):
        draw(busy, FACE, 0)
        if event % 3:
            draw(busy, BOTTOM, 5)
        follow_up(busy, FACE)
    assert draw(quiet, SUBSTRATE, 0) == draw(busy, SUBSTRATE, 0)
    assert draw(quiet, FACE, 0) != draw(busy, FACE, 0)


def test_drawing_twice_gives_the_same_until_the_event_is_over() -> None:
    """A draw is a function of what it is for."""
    stream = stream_of(3, 12)
    first = draw(stream, FACE, 0)
    assert draw(stream, FACE, 0) == first
    assert draw(stream, FACE, 1) != first
    follow_up(stream, FACE)
    assert draw(stream, FACE, 0) != first


def test_seed_history_event_kind_and_attempt_all_change_the_numbers() -> None:
    """No two of some thousand different purposes share a draw."""
    seen = set()
    for seed in (0, 1, 1 << 40):
        for history in (0, 1, 2, 1 << 32, 1 << 33):
            stream = stream_of(seed, history)
            for _ in range(5):
                for kind in range(10):
                    for attempt in range(4):
                        seen.add(draw(stream, kind, attempt))
                    follow_up(stream, kind)
    assert len(seen) == 3 * 5 * 5 * 10 * 4


def test_draws_are_uniform_and_independent() -> None:
    """20,000 draws: Kolmogorov-Smirnov for each of the four, chi-square of pairs on a 10 x 10 grid."""
    drawn = np.array([draw(stream_of(9, history), FACE, 0) for history in range(20_000)])
    assert drawn.min() > 0.0
    assert drawn.max() < 1.0
    assert min(stats.kstest(column, "uniform").pvalue for column in drawn.T) > 1e-3
    for a, b in ((0, 1), (1, 2), (2, 3), (0, 3)):
        counts = np.histogram2d(drawn[:, a], drawn[:, b], bins=10, range=[[0, 1], [0, 1]])[0]
        assert stats.chisquare(counts.ravel()).pvalue > 1e-3
    successive = np.histogram2d(drawn[:-1, 0], drawn[1:, 0], bins=10, range=[[0, 1], [0, 1]])[0]
    assert stats.chisquare(successive.ravel()).pvalue > 1e-3
