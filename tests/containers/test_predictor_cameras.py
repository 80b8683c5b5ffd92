"""How images change with the camera, as the ray-tracing worker tells it: those predicted, and the twin's."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from containers.ray_tracing.exit_source import ExitSource
from tests.containers.test_predictor import CAMERA, HISTORIES, NINE, Arrays, Impatient, ask, request, shot, worker


@pytest.fixture(scope="module")
def source() -> ExitSource:
    """Chips that several tests ask for."""
    return ExitSource()


def test_camera_columns_are_differences_of_moved_cameras(source: ExitSource) -> None:
    """Along rows, along columns, about the module; beside columns of the scene and in the order asked for."""
    of, steps = worker(source), {"shift_row_px": 0.1, "rotation_deg": 0.5, "shift_column_px": 0.1}
    names = ("shift_row_px", "receiver_reflectance", "rotation_deg", "shift_column_px")
    found = ask(request(columns=names), of)["jacobian_per_mm2"]
    moves: dict[str, Callable[[float], Any]] = {
        "shift_row_px": lambda h: {"camera__shift_px": (h, 0.0)},
        "rotation_deg": lambda h: {"camera__rotation_deg": h},
        "shift_column_px": lambda h: {"camera__shift_px": (0.0, h)},
    }
    for name, h in steps.items():
        up, down = (
            ask(request(shot(**moves[name](s * h)), shot(NINE, **moves[name](s * h))), of)["images_per_mm2"]
            for s in (1.0, -1.0)
        )
        difference = (up - down) / (2.0 * h)
        np.testing.assert_allclose(found[names.index(name)], difference, atol=1e-2 * np.abs(difference).max())
    alone = ask(request(columns=names[1:2]), of)["jacobian_per_mm2"]
    np.testing.assert_array_equal(found[1:2], alone)


@pytest.mark.parametrize("bend", [0.0, 0.04])
def test_about_a_run_the_images_own_change_with_the_camera_is_told_beside_the_twins(
    source: ExitSource, bend: float
) -> None:
    """What the twin misses moves, too, with the run's noise; without a run there is nothing but the twin's."""
    of, names, h = worker(source), ("rotation_deg", "absorption_per_um", "shift_column_px"), 0.1
    sensor = {"gain_dn": 2000.0, "offset_dn": 50.0, "full_scale_dn": 4000.0}
    bent = {"effects": [{"name": "nonlinearity", "parameters": {"bend": bend}}]} if bend else {}
    own: dict[str, Any] = bent | {"camera": CAMERA | sensor}
    anchor = {"histories": HISTORIES, "shots": [shot(**own), shot(NINE, **own)]}

    def seen(**changes: Any) -> Arrays:
        shots = [shot(array, **own | {"camera": own["camera"] | changes}) for array in (None, NINE)]
        return ask(request(*shots, columns=names, anchor=anchor), of)

    found = seen()
    assert found["by_camera_per_mm2"].shape == (2, 2, 16, 16)
    moves: list[Callable[[float], Any]] = [lambda by: {"rotation_deg": by}, lambda by: {"shift_px": (0.0, by)}]
    for move, theirs, of_twin in zip(moves, found["by_camera_per_mm2"], found["jacobian_per_mm2"][::2], strict=True):
        up, down = (seen(**move(s * h)) for s in (1.0, -1.0))
        whole, twin = ((up[name] - down[name]) / (2.0 * h) for name in ("images_per_mm2", "twin_per_mm2"))
        scale = np.abs(whole).max()
        np.testing.assert_allclose(theirs, whole, atol=1e-2 * scale)
        np.testing.assert_allclose(of_twin, twin, atol=1e-2 * scale)
        assert np.abs(theirs - of_twin).max() > 5e-2 * scale
    alone = ask(request(columns=names, anchor={"histories": 0}), of)
    assert "by_camera_per_mm2" not in alone


def test_a_bent_sensor_sees_ambient_light_in_a_prediction(source: ExitSource) -> None:
    """With the camera's own plane added the prediction is the bent signal of all light; its slope is that there."""
    gain, offset, full, b, of = 2000.0, 50.0, 4000.0, 0.04, worker(source)
    sensor = {"gain_dn": gain, "offset_dn": offset, "full_scale_dn": full, "ambient_dn": (0.0, 300.0)}
    bend = [{"name": "nonlinearity", "parameters": {"bend": b}}]
    plain, bent = (
        ask(request(shot(camera=CAMERA | sensor, effects=some), columns=["receiver_reflectance"]), of)
        for some in ([], bend)
    )
    plane = np.linspace(-300.0, 300.0, 16)
    light = gain * plain["images_per_mm2"][0] + offset + plane
    found = gain * bent["images_per_mm2"][0] + offset + plane
    np.testing.assert_allclose(found, light * (1.0 - b * light / full), rtol=1e-12)
    slope = 1.0 - 2.0 * b * light / full
    np.testing.assert_allclose(bent["by_offset"][0], slope, rtol=1e-5)
    column = plain["jacobian_per_mm2"][0, 0]
    np.testing.assert_allclose(bent["jacobian_per_mm2"][0, 0], slope * column, atol=1e-6 * np.abs(column).max())


def test_camera_columns_take_no_run_of_the_twin(source: ExitSource) -> None:
    """They come of the image's own map: as many images are reported as without them; an anchored one has them too."""
    names = ("shift_row_px", "shift_column_px", "rotation_deg")
    plain, with_columns = Impatient(10**9), Impatient(10**9)
    of = worker(source)
    of.compute(request(), plain)
    expected = of.compute(request(columns=names), with_columns)[1]["jacobian_per_mm2"]
    assert len(plain.heard) == len(with_columns.heard)
    anchored = ask(request(columns=names, anchor={"histories": 1}), of)["jacobian_per_mm2"]
    np.testing.assert_allclose(anchored, expected, atol=1e-6 * np.abs(expected).max())
