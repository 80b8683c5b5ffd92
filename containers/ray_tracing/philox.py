"""Keyed random numbers: Philox4x32-10 (Salmon, Moraes, Dror, Shaw, SC11), four uniforms a call.

key      seed of the run, 64 bit
counter  (number of the history, 64 bit | number of the event of its kind | kind and attempt)

So a draw is a function of what it is for. The n-th receiver hit of history h draws the same numbers whatever happened
in between, in any order, on any number of threads, in any design: an effect that is switched on leaves the other
draws alone, and two designs with one seed share their random numbers.

A stream lies in a small array of uint64 that a thread owns: key, number of the history, events of each kind so far.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from containers.compiled import inlined_kernel

Stream = NDArray[np.uint64]

EMISSION, FACE, BOTTOM, SUBSTRATE, RECEIVER, ENTRY, PLATE, EDGE, CHIP, ROULETTE, LEAK = range(11)
"""Kinds of events that draw random numbers."""
STREAM_WORDS = 2 + 11

_LOW = np.uint64(0xFFFFFFFF)
_HALF = np.uint64(32)
_M0, _M1 = np.uint64(0xD2511F53), np.uint64(0xCD9E8D57)
_W0, _W1 = np.uint64(0x9E3779B9), np.uint64(0xBB67AE85)
_ONE, _EIGHT = np.uint64(1), np.uint64(8)
_SCALE = 2.0**-32


@inlined_kernel
def philox4x32(
    c0: np.uint64, c1: np.uint64, c2: np.uint64, c3: np.uint64, key: np.uint64
) -> tuple[np.uint64, np.uint64, np.uint64, np.uint64]:
    """Four 32-bit words (as uint64) of ten rounds; words of the counter above 32 bit must be 0."""
    k0, k1 = key & _LOW, key >> _HALF
    for _ in range(10):
        p0, p1 = _M0 * c0, _M1 * c2
        c0, c1, c2, c3 = (p1 >> _HALF) ^ c1 ^ k0, p1 & _LOW, (p0 >> _HALF) ^ c3 ^ k1, p0 & _LOW
        k0, k1 = (k0 + _W0) & _LOW, (k1 + _W1) & _LOW
    return c0, c1, c2, c3


@inlined_kernel
def start(stream: Stream, seed: np.uint64, history: np.uint64) -> None:
    """Begin a history: no event of any kind yet."""
    stream[0] = seed
    stream[1] = history
    for kind in range(2, STREAM_WORDS):
        stream[kind] = np.uint64(0)


@inlined_kernel
def draw(stream: Stream, kind: int, attempt: int) -> tuple[float, float, float, float]:
    """Four uniforms in (0, 1) of the current event of a kind; `attempt` counts draws again within the event."""
    history = stream[1]
    a, b, c, d = philox4x32(
        history & _LOW,
        history >> _HALF,
        stream[2 + kind] & _LOW,
        (np.uint64(attempt) << _EIGHT) | np.uint64(kind),
        stream[0],
    )
    return (float(a) + 0.5) * _SCALE, (float(b) + 0.5) * _SCALE, (float(c) + 0.5) * _SCALE, (float(d) + 0.5) * _SCALE


@inlined_kernel
def follow_up(stream: Stream, kind: int) -> None:
    """The event of a kind is over: the next one draws new numbers."""
    stream[2 + kind] += _ONE
