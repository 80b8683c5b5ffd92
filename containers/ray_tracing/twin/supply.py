"""Exits of chips for the twin: each chip walked once, one near another lent that one's exits, reweighted."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Sequence
from typing import TypeVar

from containers.ray_tracing.exits import Exits, chip_key
from containers.ray_tracing.twin.birthplace import born_as_in, evenly_lit, is_even
from containers.ray_tracing.twin.module import Lights
from containers.ray_tracing.twin.reweighting import OtherChipError, keeping_all, lender_of, reweighted
from containers.scene import Scene

EFFECTIVE, INEXACT = 1.0 / 3.0, 0.05
"""Share of exits that must stay effective, and of light whose weight may be inexact, where exits are reweighted.

With an effective share e the difference of two images has 1 / e - 1 of a walk's variance, with a walk of its own 2.
"""
RECENT = 32
Make = Callable[[Scene], Exits]
Key = TypeVar("Key")
Value = TypeVar("Value")


class Supply:
    """Exits of chips, each walked in once; of a chip near another one, the other's exits reweighted.

    Where the other's cannot stand for a chip, those of a chip between the two do (`lender_of`). All walks are of
    chips that shine evenly, below tops that take nothing beyond the critical angle; what unevenness adds is told by
    several sets of exits.

    Parameters
    ----------
    make : from a scene to exits of its chip, with notes; always with one seed, so that chips share random numbers.
    lights : of chips that are known already; they only save time.
    others : the same as `make`, further sets of exits for unevenness.

    Notes
    -----
    What a chip gets is a function of the chip and its base; what is remembered only saves time.
    """

    def __init__(self, make: Make, lights: Lights | None = None, others: Sequence[Make] = ()) -> None:
        self._makes, self.lights = (make, *others), Lights() if lights is None else lights
        self._known: OrderedDict[tuple[int, ...], tuple[Scene, str]] = OrderedDict()
        self._walked: OrderedDict[tuple[str, int], Exits] = OrderedDict()
        self._found: OrderedDict[tuple[str, str], Exits] = OrderedDict()

    def of(self, scene: Scene, base: Scene | None = None) -> Exits:
        """Exits of the scene's chip: the base's where they can stand for them, else its own."""
        lender = scene if base is None else base
        pair = self._key(scene), self._key(lender)
        return remembered(self._found, pair, lambda: self._near(scene, lender))

    def _near(self, scene: Scene, base: Scene) -> Exits:
        lit, other = evenly_lit(scene), evenly_lit(base)
        numbers = range(1 if is_even(scene) else len(self._makes))
        return born_as_in(scene, [self._even(lit, other, number) for number in numbers])

    def _even(self, scene: Scene, base: Scene, number: int) -> Exits:
        """A set of exits of a chip that shines evenly, as another one is."""
        for lender in map(keeping_all, (base, lender_of(scene, base))):
            if self._key(scene) == self._key(lender):
                break
            try:
                found = reweighted(self._walk(lender, number), lender, scene)
            except OtherChipError:
                continue
            if found.effective_share > EFFECTIVE and found.inexact_share < INEXACT:
                return found.exits
            break
        return self._walk(scene, number)

    def _walk(self, scene: Scene, number: int) -> Exits:
        return remembered(self._walked, (self._key(scene), number), lambda: self._makes[number](scene))

    def _key(self, scene: Scene) -> str:
        """Of its chip; the scene is kept, so that no other gets its ids."""
        ids = id(scene.chip), id(scene.substrate), id(scene.emission), id(scene.wavelength_weight)
        return remembered(self._known, ids, lambda: (scene, chip_key(scene)))[1]


def remembered(held: OrderedDict[Key, Value], key: Key, make: Callable[[], Value]) -> Value:
    """What is held under a key, or made now; of what is held, the latest `RECENT` are kept."""
    if key not in held:
        held[key] = make()
    held.move_to_end(key)
    if len(held) > RECENT:
        held.popitem(last=False)
    return held[key]
