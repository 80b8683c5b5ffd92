"""Something that an effect is tried on: how it acts there, what a worker would see of it, which laws hold."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from containers.acting import Effects

Seen = NDArray[Any]
Thing = TypeVar("Thing")

SHARE = 1e-3
"""By which what is conserved may change."""
MORE = 1e-9
"""By which light may become more: rounding."""
ANGLES = np.radians(np.linspace(0.0, 88.0, 23))


@dataclass(frozen=True)
class Example(Generic[Thing]):
    """Something that an effect acts on, and how it is looked at."""

    name: str
    thing: Thing
    act: Callable[[Effects, Thing], Any]
    seen: Callable[[Any], list[Seen]]
    """Everything of a thing that a worker would read, as arrays: equal arrays are equal things."""
    refuse: Callable[[Any], None]
    """Raises InputError for what no worker could use, or creates energy."""
    conserved: Callable[[Thing, Any, str], None]
    """Raises InputError where "energy" or "reciprocity" is not conserved."""


def text_of(json: str) -> Seen:
    """A text as an array."""
    return np.frombuffer(json.encode(), np.uint8)


def alone(array: Seen) -> list[Seen]:
    """What is seen of an array."""
    return [array]


def no_law(*_: object) -> None:
    """No law holds there."""
