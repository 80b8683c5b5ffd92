"""What every export returns: the file's text, and what did not fit into it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from luxloop.errors import InputError

MAX_CHARACTERS = 64 << 20


@dataclass(frozen=True)
class Exported:
    """An exported table."""

    text: str
    lost: Mapping[str, float]
    """What the format cannot carry, by name, with the largest error it makes. The name ends with the unit: `_ratio`
    is a power over the incident power, `_deg` and `_sr` are angles over which light in one direction is spread."""


def lost_words(lost: Mapping[str, float]) -> str:
    """One line for the file itself: what was lost, and by how much, each with its unit."""
    words = []
    for name, error in lost.items():
        plain, _, unit = name.rpartition("_")
        words.append(f"{plain} {error:.3g}" + ("" if unit == "ratio" else f" {unit}"))
    return "lost: " + ", ".join(words) if lost else "nothing lost"


def checked_text(field: str, text: str) -> str:
    """InputError for a text too large to be one of these files."""
    if len(text) > MAX_CHARACTERS:
        raise InputError(field, f"{len(text)} characters", f"at most {MAX_CHARACTERS}")
    return text


def numbers(field: str, words: list[str], count: int) -> list[float]:
    """`count` numbers out of a line's words; InputError where they are more, fewer, or no numbers."""
    try:
        found = [float(word) for word in words]
    except ValueError as error:
        raise InputError(field, words[:4], f"{count} numbers") from error
    if len(found) != count or any(number != number or abs(number) == float("inf") for number in found):
        raise InputError(field, f"{len(found)} numbers", f"{count} finite numbers", "the file was cut or edited")
    return found
