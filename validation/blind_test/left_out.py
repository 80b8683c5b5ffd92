"""Kinds that a truth could not be given as strongly as was asked: too weak there, or no amount was found.

What is too weak in one truth may show in another: other surroundings, other light. Each truth has a list of its own,
beside the answers, so that making goes on as if it had not been cut short.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from luxloop.errors import InputError
from validation.blind_test.folders import ANSWERS, WEAK, read_json, write_whole


def left_out(folder: Path, truth: int) -> dict[str, float | None]:
    """Of a truth, by kind: the sigma that it shows by at its most; None where no amount was found."""
    return dict(_read(folder).get(_name(truth), {}))


def leave_out(folder: Path, truth: int, kinds: dict[str, float | None]) -> None:
    """Put them on record."""
    write_whole(folder / ANSWERS / WEAK, _read(folder) | {_name(truth): kinds})


def weak_kinds(folder: Path) -> dict[str, float]:
    """Kinds that do not show as strongly as was asked in some truth, with the least sigma at their most."""
    found: dict[str, float] = {}
    for kind, sigma in _all(folder):
        if sigma is not None:
            found[kind] = min(sigma, found.get(kind, sigma))
    return found


def no_amounts(folder: Path) -> list[str]:
    """Kinds that are strong enough at their most, and for which no amount near the asked strength was found."""
    return sorted({kind for kind, sigma in _all(folder) if sigma is None})


def _all(folder: Path) -> Iterator[tuple[str, float | None]]:
    for kinds in _read(folder).values():
        yield from kinds.items()


def _read(folder: Path) -> dict[str, dict[str, Any]]:
    """By truth; lists of before were of all truths together."""
    path = folder / ANSWERS / WEAK
    found = read_json(path, WEAK, "sigma by kind, by truth", "remove it") if path.exists() else {}
    by_truth = {name: one for name, one in found.items() if isinstance(one, dict)}
    older = {name: one for name, one in found.items() if not isinstance(one, dict)}
    by_truth |= {"all": older} if older else {}
    for kinds in by_truth.values():
        for kind, sigma in kinds.items():
            if not (sigma is None or (isinstance(sigma, int | float) and not isinstance(sigma, bool))):
                raise InputError(f"{WEAK}: {kind}", sigma, "its sigma at its most, or null", "put the file back")
    return by_truth


def _name(truth: int) -> str:
    return f"truth-{truth + 1}"
