"""Elementary functions of the kernels against the library's."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from containers.ray_tracing.quick import cos_sin_turn, cos_sinc, minus_log

FEW = settings(max_examples=300, derandomize=True, deadline=None)


@FEW
@given(st.floats(0.0, 1.0))
def test_cos_and_sin_of_a_turn(turns: float) -> None:
    """To 1e-10, of unit length to 1e-10."""
    c, s = cos_sin_turn(turns)
    assert complex(c, s) == pytest.approx(np.exp(2j * np.pi * turns), abs=1e-10)


def test_cos_and_sin_at_all_eighths() -> None:
    """Where the series changes its octant, from either side."""
    for turns in (*np.arange(17) / 16.0, *(np.arange(1, 16) / 16.0 - 1e-12), *(np.arange(16) / 16.0 + 1e-12)):
        c, s = cos_sin_turn(float(turns))
        assert complex(c, s) == pytest.approx(np.exp(2j * np.pi * turns), abs=1e-10)


@FEW
@given(st.floats(0.0, 10.0))
def test_cos_and_sinc_of_a_square(square: float) -> None:
    """cos t and sin t / t to 1e-10, at 0 and across the change of method at 1."""
    t = np.sqrt(square)
    assert cos_sinc(square) == pytest.approx((np.cos(t), np.sinc(t / np.pi)), abs=1e-10)


def test_cos_and_sinc_agree_across_their_seam() -> None:
    """No step at t = 1."""
    assert cos_sinc(1.0) == pytest.approx(cos_sinc(1.0 + 1e-13), abs=1e-10)
    assert cos_sinc(0.0) == (1.0, 1.0)


@FEW
@given(st.floats(2.0**-33, 1.0 - 2.0**-33))
def test_minus_log(u: float) -> None:
    """As the library's, never below 0."""
    assert minus_log(u) == pytest.approx(-np.log(u), rel=1e-9)
    assert minus_log(u) >= 0.0
