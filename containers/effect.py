"""What a physical effect is: parameters with units and an off value, and one hook from data to data.

    stack      Stack -> Stack                       before the film is computed
    surface    Scene -> Scene, surfaces only        ┐
    volume     Scene -> Scene, media only           │
    emission   Scene -> Scene, what shines only     ├ before rays are traced, Monte Carlo and twin alike
    geometry   Scene -> Scene, places only          │
    module     Scene -> Scene                       ┘
    detector   Camera -> Camera, image -> image, curve -> curve

An effect never runs in a kernel: it acts once per request, on the frozen descriptions. At its off value it gives back
what it got, so that the base model stays what it is, bit for bit. `containers.effects` holds the catalogue, one file
each; a user's own effect is a file like those.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, JsonValue

from containers.bsdf import Bsdf
from containers.scene import Chip, Emission, Receiver, Scene
from containers.stack import StackRows
from luxloop.camera import Camera
from luxloop.effect import EffectParameter, EffectSpec, Scope, Stage
from luxloop.errors import InputError
from luxloop.stack import Stack
from luxloop.words import Words, parse

Real = NDArray[np.float64]
MARK = "effect"
"""Under which a field keeps what `parameter` was told of it."""


def parameter(
    description: str,
    *,
    unit: str,
    lower: float | None = None,
    upper: float | None = None,
    off: float | str | None = None,
    score: Literal["value", "square"] = "value",
    one_sided: bool = False,
    shape_grid: tuple[float, ...] = (),
    choices: tuple[str, ...] = (),
    per_chip: bool = False,
) -> Any:
    """A field of an effect.

    Parameters
    ----------
    unit : that its name ends with, "" for a number without one; stated, so that nobody forgets it.
    lower, upper : its plausible range; or `choices`, the words it may be.
    off : where the effect is absent; None for a parameter that only shapes it, which then has a `shape_grid`.
    score : what has a slope at off, the value, or with off 0 its square. one_sided : only one side of off exists.
    per_chip : a list, one number for each chip of the modules that have as many.
    """
    told: dict[str, JsonValue] = {
        "unit": unit, "lower": lower, "upper": upper, "off": off, "score_variable": score, "one_sided": one_sided,
        "shape_grid": list(shape_grid), "choices": list(choices), "per_chip": per_chip,
    }  # fmt: skip
    limits: dict[str, Any] = {} if choices or per_chip else {"ge": lower, "le": upper}
    return Field(description=description, json_schema_extra={MARK: told}, **limits)


class Effect(Words):
    """A physical effect with the values of its parameters; what it is called and where it acts stand in its class."""

    name: ClassVar[str]
    stage: ClassVar[Stage]
    formula: ClassVar[str]
    reference: ClassVar[str]
    scope: ClassVar[Scope] = "global"
    twin: ClassVar[bool] = True
    """Whether the twin can represent what it makes of a scene; else Monte Carlo alone does."""
    walks: ClassVar[bool] = False
    """Whether light takes other ways inside the chips with each value: the twin's images then have other noise."""
    by_chance: ClassVar[bool] = False
    """Whether a share of the light, drawn by chance, goes another way: short steps leave the noise of a few rays,
    long ones bend no more."""
    discrete: ClassVar[bool] = False
    """Whether it is there or not: its words, or numbers of a shape grid without an off value, are tried in turn."""
    conserves: ClassVar[tuple[Literal["energy", "reciprocity"], ...]] = ()
    excludes: ClassVar[tuple[str, ...]] = ()
    """Effects that say the same in another way: a model has one of them."""
    rank: ClassVar[int] = 0
    """Within its stage: lower ones act first, equal ones in the order of the model."""

    @classmethod
    def spec(cls) -> EffectSpec:
        """What the catalogue says of it; InputError for a field that is no `parameter`, or says what cannot be."""
        for word in ("name", "stage", "formula", "reference"):
            if not isinstance(getattr(cls, word, None), str):
                raise InputError(f"{cls.__name__}.{word}", getattr(cls, word, None), "a text", f"write {word} = ...")
        return EffectSpec(
            name=cls.name,
            stage=cls.stage,
            description=(cls.__doc__ or "").strip().partition("\n")[0],
            parameters=tuple(cls._parameter(name) for name in cls.model_fields),
            acts_on=cls.acts_on(),
            scope=cls.scope,
            twin=cls.twin,
            walks=cls.walks,
            by_chance=cls.by_chance,
            discrete=cls.discrete,
            conserves=cls.conserves,
            excludes=cls.excludes,
            formula=cls.formula,
            reference=cls.reference,
        )

    @classmethod
    def acts_on(cls) -> tuple[Literal["modules", "films"], ...]:
        """What it may change: modules, films that are measured by themselves, or both."""
        return ("modules",)

    @classmethod
    def _parameter(cls, name: str) -> EffectParameter:
        field = cls.model_fields[name]
        extra = field.json_schema_extra
        if not isinstance(extra, dict) or not isinstance(told := extra.get(MARK), dict):
            raise InputError(f"{cls.__name__}.{name}", "a plain field", "a parameter", "parameter('...', unit=...)")
        said, where = {"name": name, "description": field.description or ""}, f"{cls.__name__}.{name}: off"
        one = parse(EffectParameter, said | told, f"{cls.__name__}.{name}")
        if one.score_variable == "square" and one.off not in (None, 0.0):
            mend = "count it from there, or score the value"
            raise InputError(where, one.off, "0, from which a square is counted", mend)
        is_line = not cls.twin or cls.walks
        if is_line and not (cls.discrete or one.choices) and one.off not in (None, 0.0):
            mend = "count it from there: what only Monte Carlo shows is a straight line from 0"
            raise InputError(where, one.off, "0, of an effect that the twin does not follow", mend)
        if cls.discrete and one.off is not None and not one.choices:
            mend = "choices, or a shape_grid of values to try in place of off"
            raise InputError(where, one.off, "none, of a number of a discrete effect: it has no slope there", mend)
        return one

    @classmethod
    def at_off(cls, **shape: Any) -> Self:
        """It at its off value, with these values for what only shapes it (default: the middle of their grids)."""
        values: dict[str, Any] = {}
        for one in cls.spec().parameters:
            grid = one.shape_grid or one.choices or (one.lower,)
            values[one.name] = grid[len(grid) // 2] if one.off is None else one.off
            if one.per_chip:
                values[one.name] = ()
        return cls(**values | shape)


class StackEffect(Effect):
    """Acts on a film before it is computed: on the DBR of a chip, on a film that was measured, or on both."""

    stage = "stack"
    of: ClassVar[tuple[Literal["dbr", "film"], ...]] = ("dbr", "film")

    @classmethod
    def acts_on(cls) -> tuple[Literal["modules", "films"], ...]:
        """By `of`: a DBR is a module's."""
        return tuple("modules" if one == "dbr" else "films" for one in cls.of)

    def stack(self, stack: Stack) -> Stack:
        """The stack with the effect. Of a measured film it is marked which layer is the film (`stack.films_in`)."""
        return stack

    def stacks(self, stack: Stack) -> tuple[tuple[float, Stack], ...]:
        """Shares of the measured spot, of sum 1, and what lies there; their powers are added."""
        return ((1.0, self.stack(stack)),)

    def rows(self, rows: StackRows) -> StackRows:
        """What lies there at the wavelengths of a measurement, where a medium of its own is to be made."""
        return rows

    def beside(self, stack: Stack, x_um: float) -> Stack:  # noqa: ARG002  # a hook
        """The DBR of a chip at x from the module's centre, of `stack` there."""
        return stack


class SceneEffect(Effect):
    """Acts on the module before rays are traced; its stage says what of a scene it may change (`MAY_CHANGE`)."""

    def scene(self, scene: Scene) -> Scene:
        """The scene with the effect."""
        raise NotImplementedError


class DetectorEffect(Effect):
    """Acts in the camera: on its description, on the light in its image plane, or on the signal of its sensor."""

    stage = "detector"
    scope = "per_camera"

    def camera(self, camera: Camera) -> Camera:
        """The camera with the effect."""
        return camera

    def light(self, image: Real, camera: Camera) -> Real:  # noqa: ARG002  # a hook
        """The irradiance (..., row, column) of pixels; linear, for differences and noise go through it too."""
        return image

    def signal(self, signal_dn: Real, camera: Camera) -> Real:  # noqa: ARG002  # a hook
        """The expected signal above black (row, column); pixel by pixel, where it is not linear."""
        return signal_dn


@dataclass(frozen=True)
class Reading:
    """What an instrument reads of a film: R, T as shares, psi, delta in degrees, each (wavelength, angle)."""

    quantity: Literal["R", "T", "psi", "delta"]
    wavelength_nm: Real
    aoi_deg: Real
    polarisation: Literal["s", "p", "u"]


class CurveEffect(Effect):
    """Acts in the instrument that measures a film."""

    stage = "detector"
    scope = "per_camera"

    @classmethod
    def acts_on(cls) -> tuple[Literal["modules", "films"], ...]:
        """Films alone."""
        return ("films",)

    def curve(self, value: Real, reading: Reading) -> Real:
        """The values (wavelength, angle) with the effect."""
        raise NotImplementedError


MAY_CHANGE: dict[Stage, tuple[str, ...]] = {
    "surface": ("chip.top", "chip.sides", "chip.mirror", "substrate", "receiver.bsdf", "receiver.response"),
    "volume": (
        "chip.index",
        "chip.absorption_per_um",
        "chip.absorption_rise_per_um",
        "receiver.spread_share",
        "receiver.spread_um",
    ),
    "emission": ("emission", "layout.power"),
    "geometry": ("layout", "distance_um", "tilt_per_um", "chip.width_um", "chip.thickness_um"),
}
"""Of a scene, by stage; a stage that is not here may change all of it."""


def changed(before: Scene, after: Scene) -> list[str]:
    """Which parts of a scene differ, by the names of `MAY_CHANGE`."""
    found = []
    for part in Scene.__dataclass_fields__:
        old, new = getattr(before, part), getattr(after, part)
        if old is new:
            continue
        if part in ("chip", "receiver", "layout") and type(old) is type(new):
            names = old.__dataclass_fields__
            found += [f"{part}.{name}" for name in names if not _same(getattr(old, name), getattr(new, name))]
        elif not _same(old, new):
            found.append(part)
    return found


def _same(old: Any, new: Any) -> bool:
    if isinstance(old, np.ndarray) or isinstance(new, np.ndarray):
        return old is new or np.array_equal(old, new)
    if isinstance(old, tuple) and isinstance(new, tuple):
        return len(old) == len(new) and all(map(_same, old, new))
    return old is new or (not isinstance(old, Bsdf | Emission) and bool(old == new))


def with_chip(scene: Scene, change: Callable[[Chip], Chip]) -> Scene:
    """The scene with its chip changed."""
    return replace(scene, chip=change(scene.chip))


def with_receiver(scene: Scene, change: Callable[[Receiver], Receiver]) -> Scene:
    """The scene with its receiver changed."""
    return replace(scene, receiver=change(scene.receiver))


def with_emission(scene: Scene, change: Callable[[Emission], Emission]) -> Scene:
    """The scene with its emission changed."""
    return replace(scene, emission=change(scene.emission))


STAGES: tuple[Stage, ...] = ("stack", "surface", "volume", "emission", "geometry", "module", "detector")
"""In the order in which effects act; within a stage they do so in the order of the model."""
