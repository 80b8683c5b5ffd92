"""At its off value an effect is as if it were absent: bit for bit, for every effect of the catalogue."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from containers.acting import NONE, Effects
from containers.bsdf import Lambertian
from containers.catalogue import Catalogue
from containers.effect import CurveEffect, DetectorEffect, Effect, Reading, SceneEffect, StackEffect, changed
from containers.ray_tracing.exit_source import ExitSource
from containers.ray_tracing.several_tops import scenes_of
from containers.ray_tracing.worker import RayComputation
from containers.scene import Array, Face, Scene
from containers.stack import dbr_of
from containers.thin_film.worker import FilmComputation
from luxloop.camera import Camera
from luxloop.computation import Progress
from luxloop.design import Design
from luxloop.effect import AppliedEffect, EffectSpec, Value
from luxloop.model import Environment
from luxloop.ray import AnchorRequest, ChipArray, PredictionRequest, ShotRequest
from tests.ray_scenes import film_face, scene

Real = NDArray[np.float64]
SPECS = {spec.name: spec for spec in Catalogue().specs}
ENVIRONMENT = Environment(chip_absorption_per_cm=200.0)
DESIGN = Design(distance_um=180.0, width_um=40.0, spacing_um=500.0, thickness_um=20.0, dbr_pairs=0.0)
CAMERA = Camera(rows=16, columns=16, pixel_um=40.0, gain_dn=1500.0)
WITHOUT_OFF = {"active_layer_depth"}
Ask = Callable[..., dict[str, Real]]


def off_of(spec: EffectSpec, chips: int = 0) -> dict[str, Value]:
    """The parameters of an effect at off; `chips` numbers where there is a list per chip."""
    grids: dict[str, Any] = {one.name: one.shape_grid or one.choices for one in spec.parameters}
    found: dict[str, Value] = {}
    for one in spec.parameters:
        found[one.name] = grids[one.name][0] if one.off is None else one.off
        if one.per_chip:
            found[one.name] = (float(one.off or 0.0),) * chips
    return found


def acting(spec: EffectSpec, chips: int = 0) -> Effect:
    """The effect at off, as a request brings it."""
    applied = AppliedEffect(name=spec.name, parameters=off_of(spec, chips))
    return Catalogue().effects((applied,), "ray").all[0]


def same(before: Scene, after: Scene) -> bool:
    """Whether two scenes are alike in all that rays meet."""
    return after is before or not changed(before, after)


@pytest.mark.parametrize("name", sorted(set(SPECS) - WITHOUT_OFF))
def test_off_is_what_was_given(name: str) -> None:
    """Scene, camera, light, signal, stack, curve come back as they were, with empty and with whole lists per chip."""
    module = Array.regular(2, 2, 500.0)
    for effect in (acting(SPECS[name]), acting(SPECS[name], 4), type(acting(SPECS[name])).at_off()):
        one = Effects((effect,))
        if isinstance(effect, SceneEffect):
            for of in (scene(), scene(layout=module)):
                assert same(of, one.scene(of))
        elif isinstance(effect, StackEffect):
            stack = dbr_of(ENVIRONMENT, 2.5)
            for share, spot in effect.stacks(stack):
                assert share == 1.0
                assert spot == stack
        elif isinstance(effect, CurveEffect):
            value = np.random.default_rng(1).random((7, 3))
            reading = Reading("R", np.linspace(400.0, 500.0, 7), np.array([0.0, 30.0, 60.0]), "s")
            assert np.array_equal(effect.curve(value, reading), value)
        else:
            assert isinstance(effect, DetectorEffect)
            image = np.random.default_rng(1).random((16, 16)) * CAMERA.full_scale_dn
            assert one.camera(CAMERA) == CAMERA
            assert np.array_equal(one.light(image, CAMERA), image)
            assert np.array_equal(one.signal(image, CAMERA), image)


@pytest.mark.parametrize("name", sorted(SPECS))
def test_an_effect_says_all_that_a_reader_asks(name: str) -> None:
    """Formula, source, range; an effect without off is tested by a refit, a shape has three values to try or more."""
    spec = SPECS[name]
    assert spec.formula
    assert spec.reference
    assert spec.description.endswith((".", "said."))
    assert spec.discrete or any(one.off is not None for one in spec.parameters)
    for one in spec.parameters:
        assert one.off is not None or one.choices or len(one.shape_grid) >= 3
        assert not one.one_sided or one.off in (one.lower, one.upper)


def test_the_list_of_those_without_off_is_whole() -> None:
    """Only these have no value at which they are absent."""
    without = {name for name, spec in SPECS.items() if all(one.off is None for one in spec.parameters)}
    assert without == WITHOUT_OFF


@pytest.fixture(scope="module")
def ask() -> Ask:
    """A prediction of a module of four chips by both workers in this process."""
    film = FilmComputation.in_folder(Path(tempfile.mkdtemp()))
    ray = RayComputation(lambda sha, _: film.blob(sha) or b"", ExitSource())

    def predict(*effects: AppliedEffect, histories: int = 0) -> dict[str, Real]:
        array = ChipArray(rows=2, columns=2)
        shot = ShotRequest(environment=ENVIRONMENT, design=DESIGN, effects=effects, array=array, camera=CAMERA)
        anchor = AnchorRequest(histories=histories) if histories else None
        request = PredictionRequest(shots=(shot,), anchor=anchor, exit_histories=65_536)
        return dict(ray.compute(request.model_dump(), Progress())[1])  # type: ignore[arg-type]  # all are arrays

    return predict


WHOLE = ["distance_error", "dipole_orientation", "receiver_btdf", "substrate_leak", "veiling_glare", "saturation",
         "chip_position_errors", "side_wall_roughness"]  # fmt: skip


def test_off_predicts_the_base_image_bit_for_bit(ask: Ask) -> None:
    """Through worker, twin and camera; also with lists per chip as long as the module has chips."""
    base = ask()["images_per_mm2"]
    for name in WHOLE:
        applied = AppliedEffect(name=name, parameters=off_of(SPECS[name], 4))
        assert np.array_equal(ask(applied)["images_per_mm2"], base), name


def test_off_traces_the_base_image_bit_for_bit(ask: Ask) -> None:
    """By Monte Carlo, those included that the twin cannot represent."""
    base = ask(histories=65_536)["images_per_mm2"]
    for name in ("edge_walls", "receiver_tilt", "receiver_volume_scatter"):
        applied = AppliedEffect(name=name, parameters=off_of(SPECS[name], 4))
        assert np.array_equal(ask(applied, histories=65_536)["images_per_mm2"], base), name


def test_nothing_applied_is_nothing(ask: Ask) -> None:
    """The effects of a request that names none."""
    assert ask()["images_per_mm2"].shape == (1, 16, 16)
    assert NONE.all == ()


def test_effects_are_asked_one_after_the_other_whether_they_change_anything() -> None:
    """A layer's thickness needs its place, which the effect before it gives; walls at off change nothing."""
    applied = [
        AppliedEffect(name="active_layer_depth", parameters={"depth": 0.9}),
        AppliedEffect(name="active_layer_thickness", parameters={"reach": 0.3}),
        AppliedEffect(name="edge_walls", parameters=off_of(SPECS["edge_walls"])),
        AppliedEffect(name="receiver_tilt", parameters={"tilt_x_per_mm": 0.01, "tilt_y_per_mm": 0.0}),
    ]
    acting = Catalogue().effects(applied, "ray-tracing")
    module = replace(scene(), layout=Array.regular(3, 3, 400.0, 700.0))
    (said,) = acting.idle_in(module, 2.5, images=False)
    assert said.startswith("edge_walls has no influence: ")
    assert (acting.beyond_twin, acting.beyond_twin_in(module)) == (["edge_walls", "receiver_tilt"], ["receiver_tilt"])


class Darkens(SceneEffect):
    """A user's effect that makes the top face black, seen from inside."""

    name, stage, twin = "darkens", "surface", True

    def scene(self, scene: Scene) -> Scene:
        black = Face((Lambertian(0.0),) * len(scene.chip.top.inside), scene.chip.top.outside)
        return replace(scene, chip=replace(scene.chip, top=black))


def test_an_effect_on_the_top_acts_on_the_tops_of_all_films() -> None:
    """Regression: where chips had several films, those at other places kept the face without it."""
    film, base = film_face(2.5), replace(scene(), layout=Array.regular(3, 3, 400.0, 700.0))
    shares = np.eye(3)
    tops = tuple(zip((base.chip.top, film, film_face(5.5)), shares, strict=True))
    dark = Effects((Darkens(),)).scene(replace(base, tops=tops))
    assert [one.chip.top.inside for one in scenes_of(dark)] == [(Lambertian(0.0),)] * 3


@pytest.mark.parametrize(
    ("name", "values", "array", "why"),
    [
        ("receiver_tilt", {"tilt_x_per_mm": 0.01, "tilt_y_per_mm": 0.0}, False, "an endless array has no edge"),
        ("camera_psf", {"psf_um": 20.0, "profile": "gaussian"}, True, "no image|none is asked for"),
        ("film_dispersion", None, True, "measured films"),
        ("distance_error", {"distance_um": 0.0}, True, "leaves this module as it is$"),
        ("distance_error", {"distance_um": 5.0}, False, ""),
        ("receiver_tilt", {"tilt_x_per_mm": 0.01, "tilt_y_per_mm": 0.0}, True, ""),
    ],
)
def test_what_changes_nothing_of_a_module_is_said(
    name: str, values: dict[str, Value] | None, array: bool, why: str
) -> None:
    """By the scene that an effect leaves as it is, and by what is asked for."""
    spec = SPECS[name]
    effect = Catalogue().effects([AppliedEffect(name=name, parameters=values or off_of(spec))], "ray-tracing")
    base = scene()
    at = replace(base, layout=Array.regular(3, 3, 400.0, 700.0)) if array else base
    said = effect.idle_in(at, 2.5, images=False)
    assert len(said) == bool(why)
    if why:
        assert said[0].startswith(f"{name} has no influence: ")
        assert re.search(why, said[0])
