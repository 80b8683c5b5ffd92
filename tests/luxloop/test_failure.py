"""A failure says what went wrong, whatever it is about."""

from __future__ import annotations

from luxloop.bus.frame import decode, encode
from luxloop.failure import Failure


def test_a_failure_is_cut_short_and_not_refused() -> None:
    """A compiler's message of pages, a key of 5,000 letters, a file name that is no UTF-8: its asker is told."""
    long = "x" * 5000
    failure = Failure(
        code="crashed", message=long, field=long, value=long, allowed=long, mend=long, where=long,
        history=("m\udce4rz", long),
    )  # fmt: skip
    assert decode(encode(failure)).message == failure
    assert failure.history == ("m?rz", failure.message)
    assert (len(failure.message), failure.message[-4:]) == (4000, "x...")
    assert Failure.of(RuntimeError(long), long).where == failure.where
