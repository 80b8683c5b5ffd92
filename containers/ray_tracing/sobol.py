"""Scrambled Sobol points in six dimensions: where, whereto and in which chip a history begins.

Joe and Kuo's direction numbers (new-joe-kuo-6.21201, first six dimensions); Owen's nested uniform scrambling by the
hash of Laine and Karras as improved by Vegdahl (Burley, JCGT 9(4), 2020), keyed by seed, group and dimension. Each
scramble is an unbiased sample, different scrambles are independent: errors come from the spread between groups.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from containers.compiled import inlined_kernel

DIMENSIONS = 6
_BITS = 32
_JOE_KUO = ((1, 0, (1,)), (2, 1, (1, 3)), (3, 1, (1, 3, 1)), (3, 2, (1, 1, 1)), (4, 1, (1, 1, 3, 3)))
"""Degree, coefficients of the polynomial, first direction numbers of dimensions 2 to 6."""
_MASK = np.uint64(0xFFFFFFFF)
_ONE = np.uint64(1)


def _direction_numbers() -> NDArray[np.uint64]:
    """(dimension, bit)"""
    v = np.zeros((DIMENSIONS, _BITS), np.uint64)
    v[0] = [1 << (31 - bit) for bit in range(_BITS)]
    for dimension, (degree, polynomial, first) in enumerate(_JOE_KUO, 1):
        m = [value << (31 - bit) for bit, value in enumerate(first)]
        for bit in range(degree, _BITS):
            value = m[bit - degree] ^ (m[bit - degree] >> degree)
            for k in range(1, degree):
                value ^= ((polynomial >> (degree - 1 - k)) & 1) * m[bit - k]
            m.append(value)
        v[dimension] = m
    return v


DIRECTIONS = _direction_numbers()


@inlined_kernel
def _mix(value: np.uint64, key: np.uint64) -> np.uint64:
    """Nested uniform scramble of bit-reversed words."""
    value = (value + key) & _MASK
    value ^= value * np.uint64(0x6C50B47C) & _MASK
    value ^= value * np.uint64(0xB82F1E52) & _MASK
    value ^= value * np.uint64(0xC7AFE638) & _MASK
    value ^= value * np.uint64(0x8D22F6E6) & _MASK
    return value


@inlined_kernel
def _reversed(value: np.uint64) -> np.uint64:
    """The 32 bits in the other order."""
    value = ((value >> np.uint64(1)) & np.uint64(0x55555555)) | ((value & np.uint64(0x55555555)) << np.uint64(1))
    value = ((value >> np.uint64(2)) & np.uint64(0x33333333)) | ((value & np.uint64(0x33333333)) << np.uint64(2))
    value = ((value >> np.uint64(4)) & np.uint64(0x0F0F0F0F)) | ((value & np.uint64(0x0F0F0F0F)) << np.uint64(4))
    value = ((value >> np.uint64(8)) & np.uint64(0x00FF00FF)) | ((value & np.uint64(0x00FF00FF)) << np.uint64(8))
    return (value >> np.uint64(16)) | ((value & np.uint64(0x0000FFFF)) << np.uint64(16))


@inlined_kernel
def point(
    directions: NDArray[np.uint64], index: np.uint64, keys: NDArray[np.uint64], out: NDArray[np.float64]
) -> None:
    """Point number `index` of the sequence scrambled by `keys` (dimension,), into `out` (dimension,), in (0, 1)."""
    for dimension in range(out.size):
        word, left, bit = np.uint64(0), index, 0
        while left:
            if left & _ONE:
                word ^= directions[dimension, bit]
            left >>= _ONE
            bit += 1
        scrambled = _reversed(_mix(_reversed(word), keys[dimension]))
        out[dimension] = (float(scrambled) + 0.5) * 2.0**-32
