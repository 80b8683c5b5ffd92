"""What is asked of an effect before it is used: an example of its stage, the laws that hold there, a time limit.

off      at its off value the example comes back bit for bit
acts     inside the range, and at its ends, it makes something that a worker can use, of its stage alone, that
         is finite, does not shine more than it is lit, and takes less than `ACT_S`
again    the same comes of the same, and what it was given stays as it was
conserves energy, reciprocity    where it says so
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from containers.acting import Effects
from containers.bsdf import Bsdf, check_energy, one_way_share, transmission_defect
from containers.effect import CurveEffect, Effect, Reading, SceneEffect, StackEffect
from containers.ray_tracing.build import array_of, cell_of, scene_of
from containers.ray_tracing.packing import emission_arrays, scene_arrays
from containers.scene import Array, Cell, Scene
from containers.stack import dbr_of, resolve
from luxloop.camera import Camera
from luxloop.design import Design
from luxloop.effect import EffectParameter, EffectSpec, Value
from luxloop.errors import InputError
from luxloop.model_file import find_model
from luxloop.stack import Layer, Medium, Stack
from luxloop.words import parse

Real = NDArray[np.float64]
Thing = TypeVar("Thing")
Look = Callable[[], str]

ACT_S = 1.0
SHARE = 1e-3
"""By which what is conserved may change."""
MORE = 1e-9
"""By which light may become more: rounding."""
ONE_WAY = 0.01
"""Share of the light that may lose its way back where a surface is said to stay reciprocal."""
ANGLES = np.radians(np.linspace(0.0, 88.0, 23))


@dataclass(frozen=True)
class Example(Generic[Thing]):
    """Something that an effect acts on, and how it is looked at."""

    name: str
    thing: Thing
    act: Callable[[Effects, Thing], Any]
    seen: Callable[[Any], list[Real]]
    """Everything of a thing that a worker would read, as arrays: equal arrays are equal things."""
    refuse: Callable[[Any], None]
    """Raises InputError for what no worker could use, or creates energy."""
    conserved: Callable[[Thing, Any, str], None]
    """Raises InputError where "energy" or "reciprocity" is not conserved."""


def findings_of(kind: type[Effect], spec: EffectSpec) -> Iterator[tuple[str, Look]]:
    """What to look at, one by one: a name, and a look that tells what it found or raises what is wrong."""
    examples, values = examples_of(kind), list(inside(spec))
    yield "off", lambda: _off(kind, spec, examples)
    yield "acts", lambda: _acts(kind, values, examples)
    yield "again", lambda: _again(kind, values[0], examples)
    for law in spec.conserves:
        yield f"conserves {law}", lambda law=law: _conserves(kind, values, examples, law)  # type: ignore[misc]


def inside(spec: EffectSpec) -> Iterator[dict[str, Value]]:
    """Values of the parameters: a third of the way from off, then both ends, then every value of every shape."""
    middle = {one.name: _at(one, 1.0 / 3.0) for one in spec.parameters}
    yield middle
    for share in (1.0, -1.0):
        yield {one.name: _at(one, share) for one in spec.parameters}
    for one in spec.parameters:
        for shape in one.shape_grid or one.choices:
            yield middle | {one.name: shape}


def _at(one: EffectParameter, share: float) -> Value:
    """The value that share of the way from off to the upper end, below 0 to the lower one; of chips every other."""
    if one.off is None or one.choices:
        grid = one.shape_grid or one.choices
        return grid[len(grid) // 2] if grid[len(grid) // 2] != one.off else grid[0]
    off, lower, upper = float(one.off), float(one.lower or 0.0), float(one.upper or 0.0)
    end = upper if (share > 0.0 and upper > off) or lower >= off else lower
    value = end if abs(share) == 1.0 else off + abs(share) * (end - off)
    return tuple([value, off] * (CHIPS // 2) + [value]) if one.per_chip else value


def _off(kind: type[Effect], spec: EffectSpec, examples: Sequence[Example[Any]]) -> str:
    if all(one.off is None for one in spec.parameters):
        return "it has no off value: it is absent where it is left out"
    shapes: list[dict[str, Value]] = [{}]
    shapes += [{one.name: x} for one in spec.parameters if one.off is None for x in one.shape_grid or one.choices]
    for shape in shapes:
        effects = Effects((kind.at_off(**shape),))
        for example in examples:
            before, after = example.seen(example.thing), example.seen(example.act(effects, example.thing))
            if not _same(before, after):
                where = f"{spec.name} at off" + "".join(f", {name} {value}" for name, value in shape.items())
                mend = "give back what came in where the parameter is at off"
                raise InputError(where, f"another {example.name}", "the same to the last bit", mend)
    return f"{', '.join(one.name for one in examples)}: the same to the last bit"


def _acts(kind: type[Effect], values: Sequence[dict[str, Value]], examples: Sequence[Example[Any]]) -> str:
    longest_s = 0.0
    for given in values:
        effects = Effects((parse(kind, given),))
        for example in examples:
            try:
                found, taken_s = _timed(example, effects)
                example.refuse(found)
                longest_s = max(longest_s, taken_s)
            except InputError as error:
                error.args = (f"{example.name}, {_told(given)}: {error}",)
                raise
    names = ", ".join(one.name for one in examples)
    return f"{len(values)} settings inside the range on {names}; one act takes at most {1e3 * longest_s:.2g} ms"


def _again(kind: type[Effect], given: dict[str, Value], examples: Sequence[Example[Any]]) -> str:
    effects = Effects((parse(kind, given),))
    for example in examples:
        before = [part.copy() for part in example.seen(example.thing)]
        first, second = (example.seen(example.act(effects, example.thing)) for _ in range(2))
        if not _same(first, second):
            mend = "an effect draws no random numbers and remembers nothing"
            raise InputError(example.name, "two results of the same values", "one", mend)
        if not _same(before, example.seen(example.thing)):
            raise InputError(example.name, "it was changed in place", "untouched", "make a copy, change that")
    return "the same of the same; what it is given stays as it was"


def _timed(example: Example[Any], effects: Effects) -> tuple[Any, float]:
    """What an act gives, and its time in s, the shorter of two where the first is long; InputError over `ACT_S`."""
    taken_s: list[float] = []
    while not taken_s or (taken_s[-1] > ACT_S and len(taken_s) < 2):
        begin_s = time.perf_counter()
        found = example.act(effects, example.thing)
        taken_s.append(time.perf_counter() - begin_s)
    if min(taken_s) > ACT_S:
        raise InputError(
            "one act", f"{min(taken_s):.1f} s", f"at most {ACT_S:g} s", "do less, or do it once at import"
        )
    return found, min(taken_s)


def _conserves(
    kind: type[Effect], values: Sequence[dict[str, Value]], examples: Sequence[Example[Any]], law: str
) -> str:
    for given in values:
        for example in examples:
            example.conserved(example.thing, example.act(Effects((parse(kind, given),)), example.thing), law)
    return f"{law} is conserved" + (f" within {SHARE:g}" if law == "energy" else "")


def _told(given: dict[str, Value]) -> str:
    return ", ".join(f"{name} {'per chip' if isinstance(value, tuple) else value}" for name, value in given.items())


def _same(before: Sequence[Real], after: Sequence[Real]) -> bool:
    return len(before) == len(after) and all(
        a.shape == b.shape and a.tobytes() == b.tobytes() for a, b in zip(before, after, strict=True)
    )


# Examples, one kind for each stage

CHIPS = 25
DESIGN = Design(distance_um=180.0, width_um=40.0, spacing_um=500.0, thickness_um=20.0, dbr_pairs=0.0)
WAVELENGTH_NM = (430.0, 445.0, 460.0)


def examples_of(kind: type[Effect]) -> list[Example[Any]]:
    """What an effect of that class is tried on."""
    if issubclass(kind, StackEffect):
        return list(_films(kind))
    if issubclass(kind, SceneEffect):
        environment = find_model("paper").environment
        layouts: dict[str, Array | Cell] = {
            "5 x 5 chips": array_of(environment, DESIGN, 5, 5),
            "a cell": cell_of(environment, DESIGN),
        }
        return [
            Example(
                name,
                scene_of(environment, DESIGN, None, layout),
                Effects.scene,
                _scene_seen,
                _refuse_scene,
                _scene_kept,
            )
            for name, layout in layouts.items()
        ]
    return list(_curves() if issubclass(kind, CurveEffect) else _images())


def _films(kind: type[StackEffect]) -> Iterator[Example[Any]]:
    dbr = dbr_of(find_model("paper").environment, 2.5)
    polymer = Layer(medium=Medium(cauchy=(1.5, 0.004)), thickness_nm=300.0)
    film = Stack(inside=Medium(material="Si"), layers=(polymer,), outside=Medium(n=1.0))
    if "dbr" in kind.of:
        yield Example(
            "a DBR of 2.5 pairs", dbr, lambda all_, one: ((1.0, all_.dbr(one)),), _spot, _refuse_spot, _spot_kept
        )
    if "film" in kind.of:
        yield Example("a polymer on silicon", film, Effects.film, _spot, _refuse_spot, _spot_kept)


def _spot(stacks: Any) -> list[Real]:
    """Shares and rows of the stacks on a spot, or of a stack alone."""
    stacks = ((1.0, stacks),) if isinstance(stacks, Stack) else stacks
    rows = [(share, stack, resolve(stack, WAVELENGTH_NM)) for share, stack in stacks]
    parts = [[np.array([share]), row.index, row.thickness_nm, row.roughness_nm] for share, _, row in rows]
    text = [np.frombuffer(stack.model_dump_json().encode(), np.uint8).astype(float) for _, stack, _ in rows]
    return [part for one in parts for part in one] + text


def _refuse_spot(stacks: Any) -> None:
    """Every layer of a range that can be, and passive: then R + T is at most 1."""
    for share, stack in stacks:
        if not 0.0 <= share <= 1.0:
            raise InputError("share of the spot", share, "0 to 1", "shares of sum 1")
        rows = resolve(parse(Stack, stack.model_dump(), "stack"), WAVELENGTH_NM)
        if rows.index.imag.min() < 0.0 or rows.index.real.min() <= 0.0:
            raise InputError(
                "n + ik", complex(rows.index.flat[rows.index.imag.argmin()]), "n > 0, k >= 0", "R + T > 1"
            )


def _spot_kept(before: Stack, stacks: Any, law: str) -> None:
    """A film that absorbs nothing goes on so; every film of isotropic layers is reciprocal."""
    absorbs = any(resolve(stack, WAVELENGTH_NM).index.imag.any() for _, stack in stacks)
    if law == "energy" and absorbs and not resolve(before, WAVELENGTH_NM).index.imag.any():
        raise InputError("conserves", "a film that absorbs", "k = 0 in all of it", 'leave out "energy"')


def _scene_seen(scene: Scene) -> list[Real]:
    return [*_flat(scene_arrays(scene)), *_flat(emission_arrays(scene))]


def _flat(parts: Any) -> Iterator[Real]:
    for part in parts:
        if isinstance(part, tuple):
            yield from _flat(part)
        else:
            yield np.asarray(part)


def _refuse_scene(scene: Scene) -> None:
    for part in _scene_seen(scene):
        if np.isnan(part).any():
            raise InputError("scene", "values that are not finite", "finite numbers", "look for a division by zero")
    for name, bsdf in _surfaces(scene):
        try:
            check_energy(bsdf, ANGLES)
        except InputError as error:
            raise InputError(f"{name}, {error.field}", error.value, error.allowed, error.mend) from error


def _surfaces(scene: Scene) -> Iterator[tuple[str, Bsdf]]:
    """Everything that light meets, by name."""
    chip, wall = scene.chip, scene.layout.wall if isinstance(scene.layout, Array) else None
    named = {"substrate": scene.substrate, "receiver": scene.receiver.bsdf, "chip.mirror": chip.mirror, "wall": wall}
    yield from ((name, bsdf) for name, bsdf in named.items() if bsdf is not None)
    for name, face in (("chip.top", chip.top), ("chip.sides", chip.sides)):
        yield f"{name} from inside", face.inside[0]
        yield f"{name} from outside", face.outside[0]


def _scene_kept(before: Scene, after: Scene, law: str) -> None:
    old = dict(_surfaces(before))
    for name, bsdf in _surfaces(after):
        if name in old and bsdf is not old[name]:
            (_albedo_kept if law == "energy" else _way_kept)(name, old[name], bsdf)
    if law == "energy" and after.chip.absorption_per_um != before.chip.absorption_per_um:
        raise InputError("chip.absorption_per_um", after.chip.absorption_per_um, "unchanged", 'leave out "energy"')
    if law == "reciprocity":
        for name in ("chip.top", "chip.sides"):
            now, then = dict(_surfaces(after)), old
            lost = transmission_defect(now[f"{name} from inside"], now[f"{name} from outside"], ANGLES)
            if lost > transmission_defect(then[f"{name} from inside"], then[f"{name} from outside"], ANGLES) + SHARE:
                raise InputError(f"{name}: transmission", round(lost, 6), "the same from both sides", "change both")


def _albedo_kept(name: str, old: Bsdf, new: Bsdf) -> None:
    change = np.abs(new.albedo(ANGLES) - old.albedo(ANGLES))
    if change.max() > SHARE:
        where = f"{name}, albedo at {np.degrees(ANGLES[change.argmax()]):.0f} deg"
        raise InputError(where, f"{change.max():.2g} away", f"within {SHARE:g}", 'scale it, or leave out "energy"')


def _way_kept(name: str, old: Bsdf, new: Bsdf) -> None:
    lost = one_way_share(new)
    if lost > one_way_share(old) + ONE_WAY:
        mend = 'symmetrise the table, or leave out "reciprocity"'
        raise InputError(
            f"{name}, light without a way back", f"{100 * lost:.1f} %", f"{100 * ONE_WAY:g} % more", mend
        )


def _images() -> Iterator[Example[Any]]:
    camera = Camera(rows=16, columns=16, pixel_um=40.0, gain_dn=1000.0)
    row, column = np.mgrid[:16, :16] - 7.5
    spot = 2.0 * np.exp(-((row - 0.7) ** 2 + column**2) / (2 * 1.8**2))
    signal = 1000.0 * spot + 20.0
    yield Example("a camera", camera, Effects.camera, _camera_seen, _refuse_camera, _camera_kept)
    yield Example(
        "light of 16 x 16 pixels",
        spot,
        lambda all_, image: _light(all_, image, camera),
        _alone,
        _refuse_more(spot),
        _light_kept,
    )
    yield Example(
        "a signal of 16 x 16 pixels",
        signal,
        lambda all_, image: all_.signal(image, camera),
        _alone,
        lambda _: None,
        _kept,
    )


def _camera_seen(camera: Camera) -> list[Real]:
    return [np.frombuffer(camera.model_dump_json().encode(), np.uint8).astype(float)]


def _alone(image: Real) -> list[Real]:
    return [image]


def _kept(*_: object) -> None:
    """No law holds there."""


def _refuse_camera(camera: Camera) -> None:
    parse(Camera, camera.model_dump(), "camera")
    for name, before in (("rows", 16), ("columns", 16), ("pixel_um", 40.0)):
        if getattr(camera, name) != before:
            raise InputError(f"camera.{name}", getattr(camera, name), f"{before}", "an image keeps its pixels")
    if camera.gain_dn > 1000.0 * (1.0 + MORE):
        raise InputError("camera.gain_dn", camera.gain_dn, "at most what it was", "light would be made")


def _camera_kept(before: Camera, after: Camera, law: str) -> None:
    if law == "energy" and (before.gain_dn, before.vignetting) != (after.gain_dn, after.vignetting):
        raise InputError("conserves", "another gain or vignetting", "no light lost", 'leave out "energy"')


def _light(effects: Effects, image: Real, camera: Camera) -> Real:
    """The light of an image. InputError where it is not linear, or images in one array are not each its own."""
    found = effects.light(image, camera)
    both = effects.light(np.stack([image, 3.0 * image[::-1]]), camera)
    apart = np.stack([found, 3.0 * effects.light(image[::-1], camera)])
    if np.abs(both - apart).max() > MORE * max(1.0, float(np.abs(apart).max())):
        mend = "work on the last two axes; what bends with the light belongs into signal"
        raise InputError("light", "not linear, or images mixed", "linear, each image for itself", mend)
    return found


def _refuse_more(spot: Real) -> Callable[[Any], None]:
    def refuse(image: Real) -> None:
        if image.sum() > spot.sum() * (1.0 + MORE):
            mend = "light from elsewhere belongs into signal, or the camera's ambient_dn"
            raise InputError("light", f"{image.sum() / spot.sum():.6f} of what came in", "at most 1", mend)

    return refuse


def _light_kept(before: Real, after: Real, law: str) -> None:
    share = float(after.sum() / before.sum())
    if law == "energy" and abs(share - 1.0) > SHARE:
        raise InputError("light", f"{share:.6f} of what came in", f"1 within {SHARE:g}", 'leave out "energy"')


def _curves() -> Iterator[Example[Any]]:
    wavelength, aoi = np.linspace(400.0, 800.0, 9), np.array([0.0, 45.0, 70.0])
    wave = 0.5 + 0.4 * np.sin(wavelength / 40.0)[:, None] * np.cos(np.radians(aoi))
    for quantity, value in (("R", wave), ("T", 1.0 - wave), ("psi", 45.0 * wave), ("delta", 180.0 * wave)):
        polarisation = "u" if quantity in "RT" else "p"
        reading = Reading(quantity, wavelength, aoi, polarisation)  # type: ignore[arg-type]
        name = f"a curve of {quantity}"
        yield Example(name, value, lambda all_, one, at=reading: all_.curve(one, at), _alone, lambda _: None, _kept)  # type: ignore[misc]
