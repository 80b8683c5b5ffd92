"""The effects of one request at work: in the order of their stages, each held to what its stage may change.

What an effect's own code does wrong (raises, returns something else, numbers that are not finite, a part of the
scene that is not its stage's) is an InputError that names the effect; the worker goes on.
"""

from __future__ import annotations

import traceback
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from containers.effect import (
    MAY_CHANGE,
    STAGES,
    CurveEffect,
    DetectorEffect,
    Effect,
    Reading,
    SceneEffect,
    StackEffect,
    changed,
)
from containers.scene import Cell, Scene
from containers.stack import StackRows, films_in, resolve, with_film
from luxloop.camera import Camera
from luxloop.errors import InputError
from luxloop.stack import Stack

Real = NDArray[np.float64]
Spot = tuple[tuple[float, Stack], ...]
Data = TypeVar("Data")

SHARES = 1e-9
"""By which the shares of a spot may miss the sum 1."""


@dataclass(frozen=True)
class Effects:
    """Those of a request, in the order in which they act."""

    all: tuple[Effect, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "all", tuple(sorted(self.all, key=lambda one: (STAGES.index(one.stage), one.rank))))

    @property
    def for_twin(self) -> Effects:
        """Without those that the twin cannot represent."""
        return Effects(tuple(one for one in self.all if one.twin)) if self.beyond_twin else self

    @property
    def beyond_twin(self) -> list[str]:
        """The names of those that the twin cannot represent."""
        return [one.name for one in self.all if not one.twin]

    def dbr(self, stack: Stack) -> Stack:
        """The DBR of a chip; InputError where an effect gives it several."""
        spot = self._spot(stack, "dbr")
        if len(spot) != 1:
            raise InputError("effects", f"{len(spot)} stacks on one spot", "one: a film's table is of one stack")
        return spot[0][1]

    def film(self, stack: Stack) -> Spot:
        """Shares of the spot on a measured film, and the stack at each of them.

        Which layer is the film is decided once, of the stack as it was measured (`with_film`). Raises InputError for
        an effect that makes a new layer of it, which those after it would not know.
        """
        return self._spot(with_film(stack), "film")

    @property
    def makes_media(self) -> bool:
        """Whether one of them acts on the rows of a measured film."""
        return any(type(one).rows is not StackEffect.rows for one in self._of("film"))

    def rows(self, rows: StackRows) -> StackRows:
        """What lies on a measured film, at the wavelengths of a measurement."""
        for effect in self._of("film"):
            after = guarded(effect, effect.rows, rows, kind=StackRows)
            if after is not rows and not np.all(np.isfinite(after.index) & (after.index.imag >= 0.0)):
                raise InputError(f"effects.{effect.name}", "an index that is none", "finite n, and k from 0 on")
            if rows.film.any() and not after.film.any():
                allowed = "rows with the film they were given"
                raise InputError(
                    f"effects.{effect.name}", "rows without it", allowed, "dataclasses.replace(rows, ...)"
                )
            rows = after
        return rows

    @property
    def varies_over_module(self) -> bool:
        """Whether one of them gives chips at different places different DBRs."""
        return any(type(one).beside is not StackEffect.beside for one in self._of("dbr"))

    def beside(self, stack: Stack, x_um: float) -> Stack:
        """The DBR of a chip at x from the module's centre, where that of a chip at the centre is `stack`."""
        for effect in self._of("dbr"):
            stack = guarded(effect, effect.beside, stack, x_um, kind=Stack)
        return stack

    def scene(self, scene: Scene) -> Scene:
        """The module that rays are traced in."""
        for effect in self.all:
            if isinstance(effect, SceneEffect):
                after = guarded(effect, effect.scene, scene, kind=Scene)
                beyond = [part for part in changed(scene, after) if not _may_change(effect, part)]
                if beyond:
                    allowed = "of stage " + effect.stage + ": " + ", ".join(MAY_CHANGE[effect.stage])
                    raise InputError(f"effects.{effect.name}", f"it changes {', '.join(beyond)}", allowed)
                scene = _on_each_top(effect, scene, after)
        return scene

    def camera(self, camera: Camera) -> Camera:
        """The camera before which the module stands."""
        for effect in self.all:
            if isinstance(effect, DetectorEffect):
                camera = guarded(effect, effect.camera, camera, kind=Camera)
        return camera

    def light(self, image: Real, camera: Camera) -> Real:
        """The irradiance (..., row, column) that pixels take in."""
        for effect in self.all:
            if isinstance(effect, DetectorEffect):
                image = _image(effect, effect.light, image, camera)
        return image

    def signal(self, signal_dn: Real, camera: Camera) -> Real:
        """The signal above black (row, column)."""
        for effect in self.all:
            if isinstance(effect, DetectorEffect):
                signal_dn = _image(effect, effect.signal, signal_dn, camera)
        return signal_dn

    @property
    def bends_signals(self) -> bool:
        """Whether one of them acts on the sensor's signal."""
        return any(
            isinstance(one, DetectorEffect) and type(one).signal is not DetectorEffect.signal for one in self.all
        )

    def curve(self, value: Real, reading: Reading) -> Real:
        """What an instrument reads of a film."""
        for effect in self.all:
            if isinstance(effect, CurveEffect):
                value = _image(effect, effect.curve, value, reading)
        return value

    def without_influence(self, dbr_pairs: float) -> list[str]:
        """A sentence for each effect on a DBR that is not there."""
        if dbr_pairs:
            return []
        idle = (one.name for one in self.all if isinstance(one, StackEffect) and one.of == ("dbr",))
        return [f"{name} has no influence: the chip has no DBR (0 pairs)" for name in idle]

    def idle_in(self, scene: Scene, dbr_pairs: float, images: bool) -> list[str]:
        """A sentence for each effect that changes nothing of a module, or of what is asked of it."""
        return self.without_influence(dbr_pairs) + [
            f"{one.name} has no influence: {why}"
            for one, acts in self._acting(scene)
            if (why := _idle(one, acts, scene, images))
        ]

    def beyond_twin_in(self, scene: Scene) -> list[str]:
        """The names of those that the twin cannot represent and that change the module: at off none does."""
        return [one.name for one, acts in self._acting(scene) if acts and not one.twin]

    def _acting(self, scene: Scene) -> list[tuple[Effect, bool]]:
        """Each effect, and whether it changes what those before it have made of a module."""
        found = []
        for one in self.all:
            after = guarded(one, one.scene, scene, kind=Scene) if isinstance(one, SceneEffect) else None
            found.append((one, after is not scene))
            scene = scene if after is None else after
        return found

    def idle_on(self, stack: Stack, wavelength_nm: ArrayLike) -> list[str]:
        """A sentence for each effect on films that leaves a measured one as it is."""
        film, why = with_film(stack), "at these values it leaves this sample as it is"
        if not any(films_in(film)):
            why += ", which has no coherent layer, hence no film"
        spots, said = self._spots(film, "film"), []
        rows = resolve(spots[-1][0][1], wavelength_nm)
        for one, before, after in zip(self._of("film"), spots, spots[1:], strict=False):
            changed_rows = guarded(one, one.rows, rows, kind=StackRows)
            if before == after and _same_rows(changed_rows, rows):
                said.append(f"{one.name} has no influence: {why}")
            rows = changed_rows
        return said

    def _spot(self, stack: Stack, of: Literal["dbr", "film"]) -> Spot:
        return self._spots(stack, of)[-1]

    def _spots(self, stack: Stack, of: Literal["dbr", "film"]) -> list[Spot]:
        """Shares of a spot and the stack at each of them: as it is, then with one effect after the other."""
        spot: Spot = ((1.0, stack),)
        spots = [spot]
        for effect in self._of(of):
            spread = [(share, guarded(effect, effect.stacks, one, kind=tuple)) for share, one in spot]
            spot = tuple((share * part, one) for share, parts in spread for part, one in parts)
            if abs(sum(share for share, _ in spot) - 1.0) > SHARES:
                raise InputError(f"effects.{effect.name}", sum(s for s, _ in spot), "shares of sum 1")
            lost = [one for _, one in spot if any(films_in(stack)) and not any(films_in(one))]
            if lost:
                mend = "change it by layer.model_copy(update={...}), to a thickness of 0 to take it away"
                raise InputError(f"effects.{effect.name}", str(lost[0]), "a stack with the film it was given", mend)
            spots.append(spot)
        return spots

    def _of(self, of: Literal["dbr", "film"]) -> list[StackEffect]:
        return [one for one in self.all if isinstance(one, StackEffect) and of in one.of]


NONE = Effects()


def _idle(effect: Effect, acts: bool, scene: Scene, images: bool) -> str:
    """Why an effect changes nothing here; empty where it may."""
    if isinstance(effect, CurveEffect) or (isinstance(effect, StackEffect) and effect.of == ("film",)):
        return "it acts on measured films, not on modules"
    if isinstance(effect, DetectorEffect) and not images:
        return "it acts on images of a camera, and none is asked for"
    if isinstance(effect, SceneEffect) and not acts:
        endless = "; an endless array has no edge, no middle and no single chip" * isinstance(scene.layout, Cell)
        return f"at these values it leaves this module as it is{endless}"
    return ""


def _on_each_top(effect: SceneEffect, before: Scene, after: Scene) -> Scene:
    """The scene after an effect, which acts on the films of chips at other places as on that of the middle."""
    if not before.tops or after.chip.top is before.chip.top:
        return after
    tops = []
    for top, share in before.tops:
        there = replace(before, chip=replace(before.chip, top=top))
        tops.append((guarded(effect, effect.scene, there, kind=Scene).chip.top, share))
    return replace(after, tops=tuple(tops))


def _same_rows(one: StackRows, other: StackRows) -> bool:
    pairs = ((one.index, other.index), (one.thickness_nm, other.thickness_nm), (one.roughness_nm, other.roughness_nm))
    return one is other or all(np.array_equal(a, b) for a, b in pairs)


def guarded(effect: Effect, hook: Callable[..., Data], *data: object, kind: type) -> Data:
    """What a hook makes of its data. Raises InputError that names the effect, whatever its code raised."""
    where = f"effects.{effect.name}"
    try:
        found = hook(*data)
    except InputError as error:
        raise InputError(f"{where}: {error.field}", error.value, error.allowed, error.mend) from error
    except Exception as error:  # an effect may be anybody's code; its mistakes do not end the worker
        place = traceback.extract_tb(error.__traceback__)[-1]
        raised = f"{type(error).__name__}: {error}"[:300]
        mend = f"line {place.lineno} of {place.filename.rpartition('/')[2]}; try luxloop effects check"
        raise InputError(where, raised, "an effect that does not raise", mend) from error
    if not isinstance(found, kind):
        raise InputError(where, type(found).__name__, f"a {kind.__name__}, as it was given one", "return it")
    return found


def _image(effect: Effect, hook: Callable[..., Real], image: Real, frame: object) -> Real:
    """The same for an array, which must keep its shape and be finite."""
    found = guarded(effect, hook, image, frame, kind=np.ndarray)
    where = f"effects.{effect.name}"
    if found.shape != image.shape:
        raise InputError(where, f"shape {found.shape}", f"shape {image.shape}, that of what it is given")
    if not np.all(np.isfinite(found)):
        raise InputError(where, "values that are not finite", "finite numbers", "look for a division by zero")
    return np.asarray(found, np.float64)


def _may_change(effect: Effect, part: str) -> bool:
    if effect.stage not in MAY_CHANGE:
        return True
    return any(part == one or part.startswith(f"{one}.") for one in MAY_CHANGE[effect.stage])
