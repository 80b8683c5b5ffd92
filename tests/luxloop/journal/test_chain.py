"""The chain: what it covers, and that nothing in it can change unseen."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from luxloop.journal.chain import GENESIS, Link, Mark

LINKS = st.builds(
    Link,
    topic=st.text(max_size=8),
    sequence=st.integers(0, 2**32 - 1),
    log_time_ns=st.integers(0, 2**63 - 1),
    data=st.binary(max_size=40),
)


def test_the_first_link_is_that_of_another_program() -> None:
    """Bytes assembled by printf and hashed by coreutils' sha256sum: topic /step, sequence 1, time 2 ns, data abc."""
    expected = "8d30e5b202d4ad0d2777732323afdd6b02788fb18a3b2f8999b27758318fa010"
    assert Mark().then([Link("/step", 1, 2, b"abc")]) == Mark(1, expected)


def test_no_records_have_the_root_of_zeros() -> None:
    """An empty chain is its beginning."""
    assert Mark().then([]) == Mark(0, GENESIS)


@settings(max_examples=50, derandomize=True)
@given(st.lists(LINKS, max_size=5), st.lists(LINKS, max_size=5))
def test_a_chain_may_be_computed_in_parts(first: list[Link], then: list[Link]) -> None:
    """A journal is read commit by commit and segment by segment."""
    assert Mark().then(first).then(then) == Mark().then(first + then)


@settings(max_examples=50, derandomize=True)
@given(st.lists(LINKS, min_size=2, max_size=6, unique=True), st.randoms(use_true_random=False))
def test_another_order_or_one_less_has_another_root(links: list[Link], random: object) -> None:
    """Reordered, or with a record deleted."""
    mark = Mark().then(links)
    assert Mark().then(links[::-1]).root != mark.root
    assert Mark().then(links[:-1]).root != mark.root
    assert Mark().then(links[1:]).root != mark.root


@pytest.mark.parametrize(
    "changed", [{"topic": "/stepp"}, {"sequence": 8}, {"log_time_ns": 10}, {"data": b"datb"}, {"topic": "/ste"}]
)
def test_every_part_of_a_record_is_covered(changed: dict[str, object]) -> None:
    """Topic, number, time and contents."""
    link = Link("/step", 7, 9, b"data")
    assert Mark().then([replace(link, **changed)]) != Mark().then([link])  # type: ignore[arg-type]  # by name


def test_bytes_cannot_move_between_topic_and_contents() -> None:
    """The topic's length is in the link."""
    assert Mark().then([Link("ab", 0, 0, b"c")]) != Mark().then([Link("a", 0, 0, b"bc")])
