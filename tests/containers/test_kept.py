"""What was dear stays, what was cheap goes, and in the end all goes."""

from __future__ import annotations

from containers.ray_tracing.kept import Kept


def made(kept: Kept[str], key: str, cost: float) -> bool:
    """Whether it had to be made; what is made is named after its key."""
    fresh: list[str] = []

    def make() -> str:
        fresh.append(key)
        return key

    assert kept.of(key, cost, make) == key
    return bool(fresh)


def test_a_dear_one_outlives_many_cheap_ones_and_goes_in_the_end() -> None:
    """An anchor's field of 32 million histories had been pushed out by 36 runs of columns, and was run anew."""
    kept = Kept[str](4)
    assert made(kept, "anchor", 32.0)
    assert all(made(kept, f"column {n}", 0.5) for n in range(36))
    assert not made(kept, "anchor", 32.0)
    assert len(kept) == 4
    for n in range(1000):
        made(kept, f"later {n}", 0.5)
    assert "anchor" not in kept


def test_of_equals_the_one_used_longest_ago_goes() -> None:
    """A use makes it new."""
    kept = Kept[str](2)
    for key in ("a", "b", "a", "c"):
        made(kept, key, 1.0)
    assert "a" in kept
    assert "b" not in kept


def test_large_ones_go_before_small_ones_of_one_cost_and_the_last_stays() -> None:
    """Whatever its size: who asked for it needs it."""
    kept = Kept[str](20.0, lambda value: float(len(value)))
    for key in ("large" * 2, "small", "medium"):
        made(kept, key, 1.0)
    assert "large" * 2 not in kept
    assert "small" in kept
    made(kept, "huge" * 10, 1.0)
    assert len(kept) == 1
