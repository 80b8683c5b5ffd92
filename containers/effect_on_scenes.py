"""What an effect on modules is tried on: a finite module and an endless one, and what holds of every surface."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from containers.acting import Effects
from containers.bsdf import Bsdf, check_energy, one_way_share, transmission_defect
from containers.effect_example import ANGLES, SHARE, Example, Seen
from containers.ray_tracing.build import array_of, cell_of, scene_of
from containers.ray_tracing.packing import emission_arrays, scene_arrays
from containers.scene import Array, Cell, Scene
from luxloop.design import Design
from luxloop.errors import InputError
from luxloop.model_file import find_model

SIDE = 5
"""Chips along an edge of the finite module."""
DESIGN = Design(distance_um=180.0, width_um=40.0, spacing_um=500.0, thickness_um=20.0, dbr_pairs=0.0)
ONE_WAY = 0.01
"""Share of the light that may lose its way back where a surface is said to stay reciprocal."""


def scenes() -> Iterator[Example[Any]]:
    """The examples of an effect on modules."""
    environment = find_model("paper").environment
    layouts: dict[str, Array | Cell] = {
        f"{SIDE} x {SIDE} chips": array_of(environment, DESIGN, SIDE, SIDE),
        "a cell": cell_of(environment, DESIGN),
    }
    for name, layout in layouts.items():
        scene = scene_of(environment, DESIGN, None, layout)
        yield Example(name, scene, Effects.scene, _seen, _refuse, _kept)


def _seen(scene: Scene) -> list[Seen]:
    return [*_flat(scene_arrays(scene)), *_flat(emission_arrays(scene))]


def _flat(parts: Any) -> Iterator[Seen]:
    for part in parts:
        if isinstance(part, tuple):
            yield from _flat(part)
        else:
            yield np.asarray(part)


def _refuse(scene: Scene) -> None:
    for part in _seen(scene):
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


def _kept(before: Scene, after: Scene, law: str) -> None:
    old = dict(_surfaces(before))
    for name, bsdf in _surfaces(after):
        if name in old and bsdf is not old[name]:
            (_albedo_kept if law == "energy" else _way_kept)(name, old[name], bsdf)
    if law == "energy":
        for name in ("absorption_per_um", "absorption_rise_per_um"):
            if (now := getattr(after.chip, name)) != getattr(before.chip, name):
                raise InputError(f"chip.{name}", now, "unchanged", 'leave out "energy"')
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
