"""A design of the module, the box it may be looked for in, and whether it can be built.

─────────────────────────── receiver, z = D (from the substrate, or from the chip's top)
    ┌────┐           ┌────┐
    │    │           │    │  z = T
────┴────┴───────────┴────┴──── substrate, z = 0
    |<W->|
    |<------ S ----->|          (S a pitch; or the gap between chips)
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, Field, field_validator, model_validator

from luxloop.errors import InputError
from luxloop.words import Words

CLEARANCE_UM = 5.0
MOST_VALUES = 1_000_000  # of one variable on a grid
DistanceFrom = Literal["substrate", "chip_top"]
SpacingIs = Literal["pitch", "gap"]
LENGTH_DECIMALS = 6  # of a um: a design that comes out of [-1, 1] is the one that went in, to a picometre


class Design(Words):
    """The five design variables of the paper's Table 3. Pairs come in halves; 0 is a chip without DBR."""

    model_config = ConfigDict(strict=True)

    FIELDS: ClassVar[tuple[str, ...]] = ("distance_um", "width_um", "spacing_um", "thickness_um", "dbr_pairs")

    distance_um: float = Field(gt=0.0, le=10_000.0, description="Distance D to the receiver.")
    width_um: float = Field(gt=0.0, le=2_000.0, description="Side W of the square chip.")
    spacing_um: float = Field(gt=0.0, le=20_000.0, description="Spacing S of the chips.")
    thickness_um: float = Field(gt=0.0, le=1_000.0, description="Height T of the chip.")
    dbr_pairs: float = Field(ge=0.0, le=100.0, description="Pairs of DBR layers, a multiple of 0.5.")

    @field_validator("dbr_pairs")
    @classmethod
    def _pairs_come_in_halves(cls, pairs: float) -> float:
        if not (2.0 * pairs).is_integer():
            raise InputError("dbr_pairs", pairs, "a multiple of 0.5, 0 to 100", f"nearest: {nearest_half(pairs):g}")
        return abs(pairs)  # -0.0 is 0.0: equal designs have one hash

    def as_vector(self) -> NDArray[np.float64]:
        """The state vector, shape (5,), in the order and the units of `FIELDS`."""
        return np.array([getattr(self, name) for name in self.FIELDS], dtype=np.float64)

    @classmethod
    def from_vector(cls, vector: Sequence[float] | NDArray[np.float64]) -> Design:
        """The design of a state vector of shape (5,) in the order and the units of `FIELDS`."""
        if len(vector) != len(cls.FIELDS):
            raise InputError("vector", len(vector), f"{len(cls.FIELDS)} numbers: {', '.join(cls.FIELDS)}")
        return cls(**{name: float(value) for name, value in zip(cls.FIELDS, vector, strict=True)})

    @property
    def f(self) -> float:
        """Geometry factor f = 4 T / W: side area over top area (Eq. 9 of the paper)."""
        return 4.0 * self.thickness_um / self.width_um

    def feasibility(self, distance_from: DistanceFrom = "substrate", spacing_is: SpacingIs = "pitch") -> str | None:
        """Why the module cannot be built, in a sentence, or None where it can."""
        base_um = self.thickness_um if distance_from == "substrate" else 0.0
        if self.distance_um < base_um + CLEARANCE_UM:
            return (
                f"the receiver needs {CLEARANCE_UM:g} um above the chip: distance_um {self.distance_um:g} from the"
                f" {distance_from.replace('_', ' ')} is below {base_um + CLEARANCE_UM:g}"
            )
        if spacing_is == "pitch" and self.width_um >= self.spacing_um:
            return f"chips overlap: width_um {self.width_um:g} is not below the pitch spacing_um {self.spacing_um:g}"
        return None

    def __str__(self) -> str:
        lengths = (f"{letter} {getattr(self, name):g}" for letter, name in zip("DWST", self.FIELDS, strict=False))
        return f"{', '.join(lengths)} um, {self.dbr_pairs:g} pairs"


class Bounds(Words):
    """The box of designs to look in, and the step of its grid, each written as a design."""

    low: Design
    high: Design
    step: Design

    @field_validator("low", "high")
    @classmethod
    def _as_designs_are(cls, end: Design) -> Design:
        return Design.from_vector(np.round(end.as_vector(), LENGTH_DECIMALS))  # designs on it would lie beside it

    @model_validator(mode="after")
    def _low_is_below_high(self) -> Bounds:
        for name in Design.FIELDS:
            low, high, step = (getattr(end, name) for end in (self.low, self.high, self.step))
            if low > high:
                raise InputError(f"low.{name}", low, f"up to high.{name} = {high:g}", "exchange the two")
            if high - low >= MOST_VALUES * step:
                mend = f"a grid has at most {MOST_VALUES:,} values of each variable; low = high fixes one"
                raise InputError(f"step.{name}", step, f"above {(high - low) / MOST_VALUES:g}", mend)
        return self

    def contains(self, design: Design) -> bool:
        """Whether the design lies in the box, its faces included; it need not lie on the grid."""
        return self.clip(design) == design

    def clip(self, design: Design) -> Design:
        """The design of the box nearest to `design`, variable by variable."""
        return Design.from_vector(np.clip(design.as_vector(), self.low.as_vector(), self.high.as_vector()))

    def moved(self, design: Design, name: str, steps: int) -> Design | None:
        """The design with one variable so many steps further; None where that lies outside the box."""
        low, high, step = (float(getattr(end, name)) for end in (self.low, self.high, self.step))
        value = getattr(design, name) + steps * step
        value = nearest_half(value) if name == "dbr_pairs" else round(value, LENGTH_DECIMALS)
        return design.model_copy(update={name: value}) if low <= value <= high else None

    def normalise(self, design: Design) -> NDArray[np.float64]:
        """The design in [-1, 1] per variable, shape (5,): -1 at `low`, 1 at `high`, 0 where the two are equal."""
        return (design.as_vector() - self._middle()) / self._half_range(where_zero=1.0)

    def denormalise(self, x: Sequence[float] | NDArray[np.float64]) -> Design:
        """The design of a point of [-1, 1], shape (5,); pairs go to the nearest half, lengths to 1e-6 um."""
        if len(x) != len(Design.FIELDS):
            raise InputError("x", len(x), f"{len(Design.FIELDS)} numbers from -1 to 1")
        vector = np.round(self._middle() + np.asarray(x) * self._half_range(), LENGTH_DECIMALS)
        return Design.from_vector([*vector[:-1], nearest_half(vector[-1])])

    def values(self, name: str) -> tuple[float, ...]:
        """The values of one variable on the grid, from `low` upwards in steps, `high` included where it is met."""
        low, step = float(getattr(self.low, name)), float(getattr(self.step, name))
        return tuple(round(low + i * step, LENGTH_DECIMALS) for i in range(self._size(name)))

    def _size(self, name: str) -> int:
        """How many values that are."""
        low, high, step = (float(getattr(end, name)) for end in (self.low, self.high, self.step))
        return math.floor((high - low) / step + 1e-9) + 1

    @property
    def count(self) -> int:
        """How many designs the grid holds, infeasible ones included."""
        return math.prod(map(self._size, Design.FIELDS))

    def grid(self) -> Iterator[Design]:
        """The designs of the grid one after the other, the last variable (pairs) fastest."""
        return (Design.from_vector(point) for point in itertools.product(*map(self.values, Design.FIELDS)))

    @classmethod
    def preset(cls, name: str) -> Bounds:
        """The bounds of that name; raises InputError with the names there are."""
        if name not in PRESETS:
            raise InputError("bounds", name, " or ".join(PRESETS), "or give low, high and step of every variable")
        return PRESETS[name]

    def _middle(self) -> NDArray[np.float64]:
        return (self.low.as_vector() + self.high.as_vector()) / 2.0

    def _half_range(self, where_zero: float = 0.0) -> NDArray[np.float64]:
        half = (self.high.as_vector() - self.low.as_vector()) / 2.0
        return np.where(half > 0.0, half, where_zero)


def nearest_half(value: float) -> float:
    """The multiple of 0.5 nearest to `value`."""
    return round(2.0 * float(value)) / 2.0


PRESETS = {
    # Table 3; the steps are the coarsest that meet all three best states of the paper (Table 5)
    "paper-table3": Bounds(
        low=Design.from_vector((100.0, 10.0, 300.0, 5.0, 4.5)),
        high=Design.from_vector((180.0, 100.0, 700.0, 55.0, 9.5)),
        step=Design.from_vector((10.0, 2.0, 20.0, 5.0, 0.5)),
    ),
    # the "entire loop": its 18 values of D need D from 10 um
    "paper-grid": Bounds(
        low=Design.from_vector((10.0, 10.0, 300.0, 5.0, 4.5)),
        high=Design.from_vector((180.0, 100.0, 700.0, 55.0, 9.5)),
        step=Design.from_vector((10.0, 10.0, 50.0, 10.0, 0.5)),
    ),
}
