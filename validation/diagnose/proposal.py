"""A measurement that is proposed: the sentence that a verdict ends with, and what to write into the manifest."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from validation.dataset.manifest import Sample
from validation.effects.confounding import TOLD_APART

NO_IMAGE = "No further image of these samples would separate them: measure the camera's own targets first."
NO_FILM = "measure the films' thickness or index by another method, and fix them in the data set"


@dataclass(frozen=True)
class Proposal:
    """A measurement, and what it would bring."""

    words: str
    sample: Sample
    exposure_ratio: float
    expected_sigma: float
    now_sigma: float
    is_there: bool = False
    """Whether the sample is one of those that were measured."""
    taken: tuple[str, ...] = ()
    """Ids of the shots that there are."""

    def document(self) -> dict[str, Any]:
        """As plain values, with the stanza for the manifest."""
        return {
            "words": self.words, "sample": self.sample.model_dump(mode="json", exclude_defaults=True),
            "exposure_ratio": self.exposure_ratio, "expected_sigma": self.expected_sigma,
            "now_sigma": self.now_sigma, "stanza": self._stanza(),
        }  # fmt: skip

    def _stanza(self) -> str:
        """What to fill into dataset.toml once the image is taken; of a sample that is there, only a shot more."""
        sample, lines = self.sample, []
        if not self.is_there:
            lines = ["[[samples]]", *_as_toml(sample), ""]
        shot = free_id(f"further-{sample.id}" if self.is_there else sample.id, self.taken)
        exposure = "exposure_ms = 0.0  # fill in"
        if (ratio := self.exposure_ratio) != 1.0:
            exposure += f": {ratio:g} times that of {sample.id}, or frames_averaged = {ratio:g}"
        lines += ["[[shots]]", f'id = "{shot}"', 'kind = "image"', f'sample = "{sample.id}"']
        return "\n".join([*lines, f'file = "images/{shot}.tif"', exposure, ""])


def next_in_words(proposals: Sequence[Proposal], left_out: Sequence[str] = (), *, images: bool = True) -> str:
    """The sentence that a verdict ends with.

    `left_out`: rivals that the proposals are not about. `images`: whether one can tell (`image_can_tell`); nothing
    else is proposed.
    """
    if not images:
        return f"To separate them, {NO_FILM}."
    if not proposals:
        return f"Which image would separate them is not known: {chip_by_chip(left_out)}" if left_out else NO_IMAGE
    best = proposals[0]
    expected = f"expected separation {best.expected_sigma:.0f} sigma (now {best.now_sigma:.1f})"
    if best.expected_sigma < TOLD_APART:
        expected += f", less than the {TOLD_APART:.0f} that tell them apart: it takes more than that"
    others = f" That is of the others: {chip_by_chip(left_out)}" if left_out else ""
    return f"Take one image: {best.words}: {expected}.{others}"


def chip_by_chip(names: Sequence[str]) -> str:
    """Why rivals of these names are left out."""
    has = "has a number of its own" if len(names) == 1 else "have numbers of their own"
    return f"{', '.join(names)} {has} for each chip."


def free_id(name: str, taken: Collection[str]) -> str:
    """A name that no shot has yet: the name itself, or with the first number that is free."""
    return next(one for one in (name, *(f"{name}-{n}" for n in range(2, len(taken) + 3))) if one not in taken)


def _as_toml(sample: Sample) -> Iterator[str]:
    for name, value in sample.model_dump(mode="json", exclude_none=True).items():
        yield f'{name} = "{value}"' if isinstance(value, str) else f"{name} = {value}"
