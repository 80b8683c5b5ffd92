"""What a scene refuses: every field that cannot be, named, with what is allowed and how to mend it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from containers.bsdf import GaussianLobe, Lambertian, Mirror
from containers.ray_tracing.packing import parts_of, scene_arrays
from containers.scene import Array, Cell, Emission, Receiver, Scene, lambertian_receiver
from luxloop.errors import InputError
from tests.ray_scenes import N, bare, chip, scene

nan, inf = float("nan"), float("inf")


def array(**changes: Any) -> Array:
    """Two rows of three chips, 300 um apart, with changes."""
    given: dict[str, Any] = {
        "rows": 2, "columns": 3, "spacing_um": 300.0, "half_x_um": 450.0, "half_y_um": 300.0,
        "power": np.ones((2, 3)), "offset_um": np.zeros((2, 3, 2)),
    }  # fmt: skip
    return Array(**{**given, **changes})


def one_at(shape: tuple[int, ...], value: float) -> np.ndarray[Any, Any]:
    """Zeros but for the last number."""
    numbers = np.zeros(shape)
    numbers.flat[-1] = value
    return numbers


Make = Callable[[], object]
REFUSED: list[tuple[str, str, Make]] = [
    ("overlapping chips", "width_um", lambda: scene(layout=Cell(28.0))),
    ("overlapping chips of an array", "width_um", lambda: scene(layout=Array.regular(2, 2, 20.0))),
    ("a chip above the receiver", "distance_um", lambda: scene(distance_um=30.0)),
    ("a chip that touches the receiver", "distance_um", lambda: scene(distance_um=35.0)),
    ("no distance", "distance_um", lambda: scene(distance_um=0.0)),
    ("a distance below the substrate", "distance_um", lambda: scene(distance_um=-180.0)),
    ("nan as distance", "distance_um", lambda: scene(distance_um=nan)),
    ("infinite distance", "distance_um", lambda: scene(distance_um=inf)),
    ("nan as spacing of a cell", "spacing_um", lambda: scene(layout=Cell(nan))),
    ("infinite spacing of a cell", "spacing_um", lambda: scene(layout=Cell(inf))),
    ("spacing 0", "spacing_um", lambda: scene(layout=Cell(0.0))),
    ("nan as spacing of an array", "spacing_um", lambda: scene(layout=array(spacing_um=nan))),
    ("tilt in a cell", "tilt_per_um", lambda: scene(tilt_per_um=(1e-4, 0.0))),
    ("nan as tilt", "tilt_per_um", lambda: scene(layout=array(), tilt_per_um=(nan, 0.0))),
    ("a receiver tilted into the chips", "distance_um", lambda: scene(layout=array(), tilt_per_um=(1.8e-3, 0.0))),
    ("a receiver that takes nothing", "receiver", lambda: scene(receiver=lambertian_receiver(1.0))),
    ("weights that do not add up", "wavelength_weight", lambda: scene(wavelength_weight=np.array([0.9]))),
    ("a weight too many", "wavelength_weight", lambda: scene(wavelength_weight=np.array([0.5, 0.5]))),
    ("nan as weight", "wavelength_weight", lambda: scene(wavelength_weight=np.array([nan]))),
    ("one surface for two wavelengths", "chip.top", lambda: scene(
        {"index": np.array([N, N])}, wavelength_weight=np.array([0.5, 0.5]))),
    ("width 0", "width_um", lambda: chip(width_um=0.0)),
    ("nan as width", "width_um", lambda: chip(width_um=nan)),
    ("thickness below 0", "thickness_um", lambda: chip(thickness_um=-1.0)),
    ("nan as thickness", "thickness_um", lambda: chip(thickness_um=nan)),
    ("absorption below 0", "absorption_per_um", lambda: chip(absorption_per_um=-1e-3)),
    ("absorption that rises from below 0", "absorption_rise_per_um", lambda: chip(
        absorption_per_um=1e-3, absorption_rise_per_um=-2e-3)),
    ("nan as rise", "absorption_rise_per_um", lambda: chip(absorption_rise_per_um=nan)),
    ("nan as absorption", "absorption_per_um", lambda: chip(absorption_per_um=nan)),
    ("two escape cones that overlap", "index", lambda: chip(index=np.array([1.41]))),
    ("nan as index", "index", lambda: chip(index=np.array([nan]))),
    ("no index", "index", lambda: chip(index=np.zeros(0))),
    ("a mirror without its surface", "mirror", lambda: chip(bottom="mirror")),
    ("a surface without its mirror", "mirror", lambda: chip(mirror=Mirror(0.9))),
    ("a layer above the chip", "layer_depth", lambda: Emission(layer_depth=1.01)),
    ("nan as layer", "layer_depth", lambda: Emission(layer_depth=nan)),
    ("cosines that fall", "cosine", lambda: Emission(cosine=np.array([1.0, -1.0]))),
    ("a cosine above 1", "cosine", lambda: Emission(cosine=np.array([-1.0, 1.5]))),
    ("a single cosine", "cosine", lambda: Emission(cosine=np.ones(1), intensity=np.ones(1))),
    ("an intensity too many", "cosine", lambda: Emission(intensity=np.ones(3))),
    ("nan as intensity", "intensity", lambda: Emission(intensity=np.array([1.0, nan]))),
    ("an intensity below 0", "intensity", lambda: Emission(intensity=np.array([1.0, -1.0]))),
    ("a chip that does not shine", "position", lambda: Emission(position=np.zeros((2, 2)))),
    ("directions that do not shine", "position", lambda: Emission(intensity=np.zeros(2))),
    ("nan as place", "position", lambda: Emission(position=np.array([[nan]]))),
    ("places in a row", "position", lambda: Emission(position=np.ones(3))),
    ("more spread light than light", "spread_share", lambda: Receiver(Lambertian(0.35), spread_share=1.1)),
    ("nan as spread", "spread_um", lambda: Receiver(Lambertian(0.35), spread_um=nan)),
    ("a response below 0", "response", lambda: Receiver(Lambertian(0.35), response=np.array([1.0, -1.0]))),
    ("nan as response", "response", lambda: Receiver(Lambertian(0.35), response=np.array([1.0, nan]))),
    ("a response at one angle", "response", lambda: Receiver(Lambertian(0.35), response=np.ones(1))),
    ("reflectance above 1", "reflectance", lambda: lambertian_receiver(1.01)),
    ("reflectance below 0", "reflectance", lambda: GaussianLobe(-0.1, 0.1)),
    ("nan as reflectance", "reflectance", lambda: Lambertian(nan)),
    ("no row", "rows", lambda: Array.regular(0, 3, 300.0)),
    ("too many columns", "columns", lambda: Array.regular(1, 1001, 300.0)),
    ("powers of another array", "power", lambda: array(power=np.ones((3, 2)))),
    ("nan as power", "power", lambda: array(power=one_at((2, 3), nan))),
    ("a power below 0", "power", lambda: array(power=one_at((2, 3), -1.0))),
    ("all chips dead", "power", lambda: array(power=np.zeros((2, 3)))),
    ("displacements of another array", "offset_um", lambda: array(offset_um=np.zeros((2, 3)))),
    ("nan as displacement", "offset_um", lambda: scene(layout=array(offset_um=one_at((2, 3, 2), nan)))),
    ("a chip that leaves its cell", "offset_um", lambda: scene(layout=array(offset_um=one_at((2, 3, 2), 137.0)))),
    ("a chip beyond the edge", "half_x_um", lambda: scene(layout=array(half_x_um=310.0))),
    ("a displaced chip beyond the edge", "half_y_um", lambda: scene(
        layout=array(half_y_um=170.0, offset_um=one_at((2, 3, 2), 10.0)))),
    ("nan as edge", "half_x_um", lambda: scene(layout=array(half_x_um=nan))),
]  # fmt: skip


@pytest.mark.parametrize(("field", "make"), [row[1:] for row in REFUSED], ids=[row[0] for row in REFUSED])
def test_what_cannot_be_is_refused_by_name(field: str, make: Make) -> None:
    """An InputError that names the field (or its object) and says what is allowed."""
    with pytest.raises(InputError) as refused:
        make()
    assert refused.value.field.startswith(field)
    assert refused.value.allowed


def test_a_surface_that_kernels_do_not_know_is_refused() -> None:
    """Not a silent default."""
    with pytest.raises(InputError, match="surface"):
        parts_of(object())  # type: ignore[arg-type]  # that it is none is the point


def test_a_displaced_chip_may_come_up_to_the_rim_of_its_cell() -> None:
    """Half of what is free between two chips, less the clearance."""
    room = (300.0 - 28.0 - 1e-3) / 2.0
    made: Scene = scene(layout=array(half_y_um=400.0, half_x_um=600.0, offset_um=one_at((2, 3, 2), room)))
    assert isinstance(made.layout, Array)
    assert made.layout.centres_um[1, 2] == pytest.approx([300.0, 150.0 + room])


def test_the_places_of_an_array_are_about_its_centre() -> None:
    """Rows along y, row 0 at the lowest y; columns along x."""
    centres = array().centres_um
    assert centres.mean(axis=(0, 1)) == pytest.approx([0.0, 0.0])
    assert centres[0, 0] == pytest.approx([-300.0, -150.0])
    assert centres[1, 2] == pytest.approx([300.0, 150.0])


def test_a_scene_is_symmetric_where_its_emission_is() -> None:
    """Eight symmetries: of a cell, with an emission that has them."""
    square = np.array([[1.0, 2.0, 1.0], [2.0, 3.0, 2.0], [1.0, 2.0, 1.0]])
    assert scene(emission=Emission(position=square)).symmetric
    for broken in (square[:2], square + np.arange(3), square + np.arange(3)[:, None]):
        assert not scene(emission=Emission(position=broken)).symmetric


def test_an_array_is_symmetric_where_it_is_a_square_of_equal_chips() -> None:
    """As many rows as columns, no chip displaced or of another power, no tilt."""
    square = Array.regular(2, 2, 500.0)
    assert scene(layout=square).symmetric
    assert not scene(layout=Array.regular(1, 2, 500.0)).symmetric
    assert not scene(layout=square, tilt_per_um=(1e-5, 0.0)).symmetric
    assert not scene(layout=replace(square, power=np.array([[1.0, 1.0], [1.0, 2.0]]))).symmetric
    assert not scene(layout=replace(square, offset_um=np.full((2, 2, 2), 1.0))).symmetric


def test_every_scene_that_is_taken_can_be_packed() -> None:
    """Bottoms, layouts and walls of all kinds become finite numbers."""
    for made in (
        scene(),
        scene({"bottom": "mirror", "mirror": Mirror(0.9)}),
        scene({"bottom": "air_gap"}),
        scene({"top": bare(1.5)}),
        scene(layout=Array.regular(2, 3, 300.0, wall=Lambertian(0.5))),
    ):
        arrays = scene_arrays(made)
        assert np.all(np.isfinite(arrays.surfaces.tables))
        assert arrays.surfaces.layout.shape[0] == 8
