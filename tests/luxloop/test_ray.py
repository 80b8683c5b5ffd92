"""The words for ray tracing: all bounded, and all that decides a result in the task's id."""

from __future__ import annotations

import json
from typing import Any

import pytest

from luxloop.client import as_task
from luxloop.errors import InputError
from luxloop.ray import PredictionRequest, RayRequest
from luxloop.words import parse

DESIGN = {"distance_um": 180.0, "width_um": 28.0, "spacing_um": 500.0, "thickness_um": 35.0, "dbr_pairs": 0.0}


def request(**changes: Any) -> RayRequest:
    """A request with what is changed in it."""
    return parse(RayRequest, {"environment": {}, "design": DESIGN, "histories": 1000} | changes)


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"histories": 0}, "histories"),
        ({"histories": 10**12}, "histories"),
        ({"histories": None}, "histories"),
        ({"target_error_points": 0.3}, "histories"),
        ({"histories": None, "target_error_points": float("nan")}, "target_error_points"),
        ({"histories": None, "target_error_points": 0.0}, "target_error_points"),
        ({"budget_s": float("inf")}, "budget_s"),
        ({"seed": "-1"}, "seed"),
        ({"seed": "01"}, "seed"),
        ({"seed": 10**19}, "seed"),
        ({"seed": "1.5"}, "seed"),
        ({"map_bins": 513}, "map_bins"),
        ({"array": {"rows": 0, "columns": 1}}, "array.rows"),
        ({"array": {"rows": 1, "columns": 1, "wall_reflectance": 1.01}}, "array.wall_reflectance"),
        ({"array": {"rows": 1, "columns": 1, "power": [float("nan")]}}, "array.power.0"),
        ({"array": {"rows": 1, "columns": 1, "offset_um": [[1.0]]}}, "array.offset_um.0"),
        ({"film": {"sha256": "00", "bytes": 1}}, "film.sha256"),
        ({"film": {"sha256": "0" * 64, "bytes": 0}}, "film.bytes"),
        ({"design": DESIGN | {"width_um": float("nan")}}, "design.width_um"),
        ({"environment": {"chip_absorption_per_cm": -1.0}}, "environment.chip_absorption_per_cm"),
        ({"images": [{}] * 65}, "images"),
        ({"images": [{"pixel_um": 0.0}]}, "images.0.pixel_um"),
        ({"method": "guess"}, "method"),
        ({"colour": "blue"}, "colour"),
    ],
)
def test_what_cannot_be_is_refused_by_name(changes: dict[str, Any], field: str) -> None:
    """Out of range, not a number, unknown, or two ways to end: the field says which."""
    with pytest.raises(InputError) as caught:
        request(**changes)
    assert caught.value.field.startswith(field)


@pytest.mark.parametrize(
    "changes",
    [
        {"seed": "2"},
        {"exit_seed": "2"},
        {"histories": 1001},
        {"map_bins": 65},
        {"stored_exits": True},
        {"far_field": True},
        {"array": {"rows": 1, "columns": 1}},
        {"film": {"sha256": "0" * 64, "bytes": 1}},
        {"images": [{}]},
        {"environment": {"emission": "in_plane_dipole"}},
    ],
)
def test_what_decides_the_result_decides_the_task(changes: dict[str, Any]) -> None:
    """Each change is another task; the same request, from its JSON too, is the same."""
    first, other = request(), request(**changes)
    assert as_task(first).id == as_task(RayRequest.model_validate(json.loads(first.model_dump_json()))).id
    assert as_task(first).id != as_task(other).id
    assert RayRequest.model_validate(json.loads(other.model_dump_json())) == other


def test_a_seed_is_a_word_or_a_number() -> None:
    """Both are the same seed, and travel as text: no reader rounds it."""
    assert request(seed=9007199254740993) == request(seed="9007199254740993")
    assert '"9007199254740993"' in request(seed=9007199254740993).model_dump_json()


def prediction(**changes: Any) -> PredictionRequest:
    """A prediction of one shot, with what is changed in it."""
    shot = {"environment": {}, "design": DESIGN, "array": {"rows": 1, "columns": 1}}
    return parse(PredictionRequest, {"shots": [shot]} | changes)


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"shots": []}, "shots"),
        ({"shots": [{"environment": {}}]}, "shots.0.design"),
        ({"columns": [""]}, "columns.0"),
        ({"anchor": {}}, "anchor.histories"),
        ({"anchor": {"histories": 1, "seed": "-1"}}, "anchor.seed"),
        ({"exit_histories": 524_289}, "exit_histories"),
        ({"task": "simulation"}, "task"),
        ({"histories": 1}, "histories"),
    ],
)
def test_a_prediction_that_cannot_be_is_refused_by_name(changes: dict[str, Any], field: str) -> None:
    """As with a simulation."""
    with pytest.raises(InputError) as caught:
        prediction(**changes)
    assert caught.value.field.startswith(field)


def test_a_task_says_that_it_is_a_prediction() -> None:
    """One kind of worker serves both; a simulation says nothing, so that its id stays what it was."""
    first = prediction()
    assert as_task(first).kind == as_task(request()).kind
    assert as_task(first).inputs["task"] == "prediction"
    assert "task" not in as_task(request()).inputs
    assert PredictionRequest.model_validate(json.loads(first.model_dump_json())) == first


@pytest.mark.parametrize(
    "changes",
    [{"columns": ["width_um"]}, {"anchor": {"histories": 1}}, {"exit_histories": 2}, {"exit_seed": "2"}],
)
def test_what_decides_a_prediction_decides_its_task(changes: dict[str, Any]) -> None:
    """Each change is another task."""
    assert as_task(prediction()).id != as_task(prediction(**changes)).id
