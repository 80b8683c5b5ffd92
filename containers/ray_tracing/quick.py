"""Elementary functions of uniforms, to 1e-9 and about three times as fast as the library's."""

from __future__ import annotations

from math import cos, log, sin, sqrt

from containers.compiled import inlined_kernel


@inlined_kernel
def cos_sin_turn(turns: float) -> tuple[float, float]:
    """cos and sin of 2 pi x `turns`, for turns in [0, 1]: Taylor's series in an eighth of a turn, to 1e-11."""
    eighth = int(turns * 8.0 + 0.5)
    x = (turns - eighth * 0.125) * 6.283185307179586
    x2 = x * x
    s = x * (1.0 + x2 * (-1 / 6 + x2 * (1 / 120 + x2 * (-1 / 5040 + x2 * (1 / 362880)))))
    c = 1.0 + x2 * (-1 / 2 + x2 * (1 / 24 + x2 * (-1 / 720 + x2 * (1 / 40320 + x2 * (-1 / 3628800)))))
    if eighth & 1:
        s, c = (s + c) * 0.7071067811865476, (c - s) * 0.7071067811865476
        eighth -= 1
    quarter = (eighth >> 1) & 3
    if quarter == 0:
        return c, s
    if quarter == 1:
        return -s, c
    if quarter == 2:
        return -c, -s
    return s, -c


@inlined_kernel
def minus_log(u: float) -> float:
    """-ln u for u in (0, 1)."""
    return -log(u)


@inlined_kernel
def cos_sinc(square: float) -> tuple[float, float]:
    """cos(t) and sin(t) / t of t^2, to 1e-11; Taylor's series up to t = 1."""
    if square > 1.0:
        t = sqrt(square)
        return cos(t), sin(t) / t
    q = square
    c = 1.0 + q * (
        -1 / 2 + q * (1 / 24 + q * (-1 / 720 + q * (1 / 40320 + q * (-1 / 3628800 + q * (1 / 479001600)))))
    )
    s = 1.0 + q * (
        -1 / 6 + q * (1 / 120 + q * (-1 / 5040 + q * (1 / 362880 + q * (-1 / 39916800 + q * (1 / 6227020800)))))
    )
    return c, s
