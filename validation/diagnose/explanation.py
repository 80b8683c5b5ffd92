"""What one effect came to when it was added and fitted: its size, what it explains, what speaks against it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from luxloop.effect import Value
from validation.diagnose.explained import Share
from validation.diagnose.held_out import Change
from validation.fit import AT_LIMIT

LEVEL = 0.01
"""Chance that a diagnosis sees something where nothing is; structure and scores have half of it each."""
FOLLOWS = "follows the field"


@dataclass(frozen=True)
class Explanation:
    """What one effect came to when it was added and fitted."""

    name: str
    parameter: str
    unit: str
    value: float
    error: float
    shape: tuple[tuple[str, Value], ...]
    """What only shapes it, as it was fitted."""
    as_well: tuple[tuple[str, ...], ...]
    """Other words of its shape, with which it fits as well."""
    drop: float
    """Of chi2."""
    share: Share
    held_out: Change | None
    """None: a held-out test is not possible."""
    held_out_percent: tuple[float, float] | None
    """Rms error before and after."""
    log_evidence: float | None
    plausible: bool
    """Inside its range, or no further from it than noise; of a group, that its members do not follow the field."""
    at_end: bool
    """Of its range, to which noise may have taken it."""
    has_members: bool
    """A group: a number for each chip."""
    by_place: float | None
    """Chance that members of a group follow the field as closely, while chips know nothing of it; None: no group."""
    distrust: tuple[str, ...]
    """Why the fit with it may not be trusted: a parameter that a missing effect drives to its limit stays there."""
    p_left: float
    """Of the structure that is left."""
    sigma: float
    """Length of its whitened image after what is fitted has been projected out."""
    sigma_rival: dict[str, float]
    """The same also after each rival."""
    numbers: int = 1
    """Of the effect that were fitted, what shapes it among them; of a group its spread, of a switch whether it is."""

    def doubts(self) -> tuple[str, ...]:
        """Why the fit with it may not be trusted; where structure is left, but for limits, to which what is missing
        yet drives parameters."""
        leaves = self.p_left < LEVEL / 2.0
        return tuple(one for one in self.distrust if not (leaves and AT_LIMIT in one))

    @property
    def why_not(self) -> str:
        """Why it is not named, in a word or two; "" where it may be."""
        return "" if self.plausible else FOLLOWS if follows_field(self.by_place) else "implausible"

    @property
    def size(self) -> str:
        """For people."""
        shape = dict(self.shape)
        return size_in_words(self.parameter, self.value, self.error, self.unit, shape, self.as_well, self.at_end)


def follows_field(by_place: float | None) -> bool:
    """Whether a group's members follow the field so closely that it is no doing of chips."""
    return by_place is not None and by_place < LEVEL / 2.0


def size_in_words(
    parameter: str,
    value: float,
    error: float | None,
    unit: str,
    shape: Mapping[str, Value],
    as_well: Sequence[Sequence[str]] = (),
    at_end: bool = False,
) -> str:
    """A size and what shapes it: "edge_loss 0.078 +- 0.0028 (law cos4; as well: quadratic)"; a switch's word."""
    if parameter in shape:
        return ", ".join(f"{name} {one}" for name, one in shape.items())
    known = "" if error is None or not math.isfinite(error) else f" +- {error:.2g}"
    shaped = ", ".join(
        f"{name} {one:.4g}" if isinstance(one, float) else f"{name} {one}" for name, one in shape.items()
    )
    others = f"; as well: {', '.join(' '.join(words) for words in as_well)}" if as_well else ""
    ends = ", at the end of its range" if at_end else ""
    return f"{parameter} {value:.3g}{known} {unit}".rstrip() + (f" ({shaped}{others})" if shaped else "") + ends
