"""Predictions as the ray-tracing worker answers them: images, Jacobian, anchor, and what it refuses."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from containers.acting import Effects
from containers.bsdf import GaussianLobe, Lambertian
from containers.effect import SceneEffect
from containers.effects.electrode_shadow import ElectrodeShadow
from containers.ray_tracing import predictor as predictor_module
from containers.ray_tracing.exit_source import BATCH, ExitSource, joined
from containers.ray_tracing.exits import make_exits
from containers.ray_tracing.field_source import HELD_BYTES
from containers.ray_tracing.monte_carlo import BLOCK
from containers.ray_tracing.predictor import SHADOW_RAYS, Predictor
from containers.ray_tracing.simulation import solver_of
from containers.ray_tracing.twin.columns import CAMERA_COLUMNS, COLUMNS
from containers.ray_tracing.twin.prediction import Shot, jacobian, twin_images
from containers.ray_tracing.twin.supply import Supply
from containers.ray_tracing.worker import RayComputation
from containers.scene import Array
from luxloop.camera import Camera
from luxloop.computation import Progress, Stopped
from luxloop.errors import InputError, RemoteError
from luxloop.model import Environment
from luxloop.ray import PredictionRequest
from luxloop.words import parse
from tests.ray_scenes import scene

Arrays = dict[str, NDArray[Any]]
DESIGN = {"distance_um": 180.0, "width_um": 28.0, "spacing_um": 500.0, "thickness_um": 35.0, "dbr_pairs": 0.0}
DIM = {"chip_absorption_per_cm": 200.0}
"""Walks are short in a chip that absorbs."""
CAMERA = {"rows": 16, "columns": 16, "pixel_um": 40.0}
BLUR = {"name": "camera_psf", "parameters": {"psf_um": 50.0, "profile": "gaussian"}}
SINGLE: dict[str, Any] = {"rows": 1, "columns": 1, "half_um": 500.0}
NINE: dict[str, Any] = {"rows": 3, "columns": 3}
HISTORIES = 32 * BLOCK


def shot(array: dict[str, Any] | None = None, **changes: Any) -> dict[str, Any]:
    """A shot of a single chip, or with what is changed in it; dotted paths reach inside."""
    wanted = {"environment": dict(DIM), "design": dict(DESIGN), "array": array or SINGLE, "camera": dict(CAMERA)}
    for path, value in changes.items():
        outer, _, inner = path.partition("__")
        wanted[outer] = wanted[outer] | {inner: value} if inner else value
    return wanted


def request(*shots: dict[str, Any], **changes: Any) -> dict[str, Any]:
    """The inputs of a task: shots, by default of one chip and of nine."""
    wanted = {"shots": shots or (shot(), shot(NINE)), "exit_histories": HISTORIES} | changes
    inputs: dict[str, Any] = json.loads(parse(PredictionRequest, wanted).model_dump_json())
    return inputs


def worker(source: ExitSource | None = None) -> RayComputation:
    """A worker that has seen nothing yet; nobody has films for it."""
    return RayComputation(nobody, source or ExitSource())


def nobody(sha256: str, size: int) -> bytes:
    """There is no blob."""
    raise AssertionError((sha256, size))


def ask(inputs: dict[str, Any], of: RayComputation | None = None) -> Arrays:
    """The arrays of an answer."""
    return dict((of or worker()).compute(inputs, Progress())[1])


def same(one: Arrays, other: Arrays) -> None:
    """Both are equal to the last bit."""
    assert one.keys() == other.keys()
    for name, array in one.items():
        assert array.dtype == other[name].dtype
        np.testing.assert_array_equal(array, other[name], err_msg=name)


@pytest.fixture(scope="module")
def source() -> ExitSource:
    """Chips that several tests ask for."""
    return ExitSource()


def test_images_and_columns_are_the_librarys(source: ExitSource) -> None:
    """A request comes to the scenes, exits and columns that it names; shapes say shot and column."""
    names = ("receiver_reflectance", "distance_um")
    result, found = worker(source).compute(request(columns=names, exit_seed="9"), Progress())
    case = scene(
        {"absorption_per_um": 2e-2}, receiver=scene().receiver, substrate=GaussianLobe(0.97, np.radians(5.0))
    )
    assert case.receiver.bsdf == Lambertian(0.35)
    camera = Camera(**CAMERA)
    of = [Shot(replace(case, layout=Array.regular(n, n, 500.0, half)), camera) for n, half in ((1, 500.0), (3, None))]
    supply = Supply(lambda wanted: make_exits(wanted, 9, BATCH * BLOCK, notes=True))
    options = {"blocks": 1, "shadow_rays": SHADOW_RAYS}
    np.testing.assert_allclose(found["images_per_mm2"], twin_images(of, supply, **options), rtol=1e-12)
    derivatives = jacobian(of, [COLUMNS[name] for name in names], supply, **options)
    scale = np.abs(derivatives).max()
    np.testing.assert_allclose(found["jacobian_per_mm2"], derivatives, rtol=1e-6, atol=1e-6 * scale)
    assert found["jacobian_per_mm2"].shape == (2, 2, 16, 16)
    assert (result["task"], result["columns"], result["exit_histories"]) == ("prediction", list(names), HISTORIES)


MOVES: dict[str, Callable[[float], dict[str, Any]]] = {
    "receiver_reflectance": lambda h: {"environment__receiver": {"scatter": "lambertian", "reflectance": 0.35 + h}},
    "substrate_reflectance": lambda h: {
        "environment__substrate": {"scatter": "gaussian", "sigma_deg": 5.0, "reflectance": 0.97 + h}
    },
    "absorption_per_um": lambda h: {"environment__chip_absorption_per_cm": 1e4 * (2e-2 + h)},
    "distance_um": lambda h: {"design__distance_um": 180.0 + h},
}


STEPS = {"receiver_reflectance": 5e-3, "substrate_reflectance": 5e-3, "absorption_per_um": 2e-4, "distance_um": 0.9}


@pytest.mark.parametrize(("name", "h"), STEPS.items())
def test_columns_are_differences_of_the_twins_images(source: ExitSource, name: str, h: float) -> None:
    """Half a step on either side, asked for as designs and environments of their own about one anchor."""
    anchored = {"anchor": {"shots": [shot(), shot(NINE)], "histories": 1}}
    at = [worker(source)] * 2
    up, down = (
        ask(request(shot(**MOVES[name](sign * h)), shot(NINE, **MOVES[name](sign * h)), **anchored), of)
        for sign, of in zip((1.0, -1.0), at, strict=True)
    )
    column = ask(request(columns=(name,), **anchored), at[0])["jacobian_per_mm2"][0]
    difference = (up["twin_per_mm2"].astype(float) - down["twin_per_mm2"]) / (2.0 * h)
    bound = 0.4 if name == "distance_um" else 0.03
    assert np.sqrt(np.mean((column - difference) ** 2)) < bound * np.sqrt(np.mean(difference**2))


DARK_CORNER = {"name": "electrode_shadow", "parameters": {"dark_share": 0.2, "corner": "left_low"}}


@pytest.mark.parametrize(("stored", "effects"), [(False, []), (True, []), (False, [DARK_CORNER])])
def test_at_the_anchor_a_prediction_agrees_with_monte_carlo(
    source: ExitSource, stored: bool, effects: list[Any]
) -> None:
    """Within the errors of both, for each of two modules; also of chips that shine unevenly."""
    common = {"histories": HISTORIES, "seed": "3", "stored_exits": stored}
    of = worker(source)
    found = ask(request(*(shot(one, effects=effects) for one in (SINGLE, NINE)), anchor=common, exit_seed="2"), of)
    for number, array in enumerate((SINGLE, NINE)):
        wanted = shot(array, effects=effects)
        camera = wanted.pop("camera")
        seen = ask(json.loads(json.dumps(wanted | common | {"exit_seed": "2", "images": [camera]})), of)
        image, error = found["images_per_mm2"][number], np.sqrt((found["noise_per_mm2"][:, number] ** 2).sum(axis=0))
        z = (image - seen["image_0"]) / np.hypot(error, seen["image_error_0"])
        assert 0.2 < np.sqrt(np.mean(z**2)) < 1.6
        of_mean = np.sqrt((found["noise_per_mm2"][:, number].mean(axis=(1, 2)) ** 2).sum())  # of either: two seeds
        assert abs(np.mean(image) - np.mean(seen["image_0"])) < 4.0 * np.sqrt(2.0) * of_mean < 0.2 * np.mean(image)
        assert np.sqrt(np.mean(error**2) / np.mean(seen["image_error_0"] ** 2)) < 3.0  # no modes are shrunk
    assert found["noise_per_mm2"].shape[1:] == (2, 16, 16)


def test_anchors_of_modules_with_other_powers_are_not_each_others() -> None:
    """Shares of the power are alike where all chips have as much more: each module has a run of its own."""
    of, source = worker(), ExitSource()
    bright = [{"name": "chip_power_spread", "parameters": {"gain": [0.2]}}]
    anchor = {"histories": HISTORIES}
    known = ask(request(shot(), anchor=anchor), of)["images_per_mm2"]
    found, fresh = (ask(request(shot(effects=bright), anchor=anchor), one) for one in (of, worker(source)))
    np.testing.assert_allclose(found["images_per_mm2"], fresh["images_per_mm2"])
    assert found["images_per_mm2"].sum() == pytest.approx(1.2 * known.sum(), rel=1e-6)


def test_an_emission_that_only_monte_carlo_knows_is_traced() -> None:
    """No chip shines evenly for Monte Carlo whose unevenness the twin does not know."""

    class Beyond(ElectrodeShadow):
        name = "beyond"
        twin = False

    def seen(*effects: SceneEffect) -> NDArray[Any]:
        wanted = parse(PredictionRequest, request(shot(), anchor={"histories": 32 * HISTORIES}))
        means = SimpleNamespace(film=nobody, effects=lambda _: Effects(effects))
        return np.asarray(Predictor(source).answer(wanted, means, Progress())[1]["images_per_mm2"][0])

    source = ExitSource()
    even, traced, known = seen(), *(seen(one(dark_share=0.3, corner="left_low")) for one in (Beyond, ElectrodeShadow))
    assert np.sqrt(np.mean((traced - known) ** 2)) < 0.5 * np.sqrt(np.mean((known - even) ** 2))


def test_a_prediction_beside_its_anchor_differs_by_the_twin(source: ExitSource) -> None:
    """Prediction - twin is the same share of the light as at the anchor, and so is the noise."""
    of, anchor = worker(source), {"shots": [shot(), shot(NINE)], "histories": HISTORIES}
    moved = [shot(array, **MOVES["receiver_reflectance"](0.05)) for array in (SINGLE, NINE)]
    at, there = ask(request(anchor=anchor), of), ask(request(*moved, anchor=anchor), of)
    twin_at, twin_there = ask(request(), of), ask(request(*moved), of)
    here, beside = (one["images_per_mm2"] for one in (twin_at, twin_there))
    share = (beside.sum(axis=(1, 2)) / here.sum(axis=(1, 2)))[:, None, None]
    assert np.all(np.abs(share - 1.0) > 0.01)
    found, expected = there["images_per_mm2"] - beside, share * (at["images_per_mm2"] - here)
    np.testing.assert_allclose(found, expected, atol=1e-9 * beside.max())
    np.testing.assert_allclose(there["noise_per_mm2"], share * at["noise_per_mm2"], rtol=1e-5)
    np.testing.assert_allclose(there["twin_per_mm2"], twin_there["images_per_mm2"], rtol=1e-6)


def test_where_a_sensor_bends_signals_the_twin_is_bent_and_so_are_its_derivatives(source: ExitSource) -> None:
    """By gain and offset, as the twin alone would have them at two of each; the noise stays that of the image."""
    bent: dict[str, Any] = {"effects": [{"name": "nonlinearity", "parameters": {"bend": 0.04}}]}
    gain, offset, of, step = 2000.0, 50.0, worker(source), 1e-3

    def seen(times: float, more_dn: float = 0.0, **changes: Any) -> Arrays:
        sensor = {"gain_dn": gain * times, "offset_dn": offset + more_dn, "full_scale_dn": 4000.0}
        return ask(request(shot(**bent, camera=CAMERA | sensor), shot(), **changes), of)

    found = seen(1.0, anchor={"histories": HISTORIES})
    low, at, high = (seen(times) for times in (1.0 - step, 1.0, 1.0 + step))
    np.testing.assert_allclose(found["twin_per_mm2"], at["images_per_mm2"], rtol=1e-6)
    assert np.abs(found["images_per_mm2"][0] - at["images_per_mm2"][0]).max() > 1e-3  # the anchor is another
    grown = [times * one["images_per_mm2"][0] for times, one in ((1.0 - step, low), (1.0 + step, high))]
    np.testing.assert_allclose(found["by_gain_per_mm2"][0], (grown[1] - grown[0]) / (2.0 * step), rtol=1e-4)
    np.testing.assert_allclose(at["by_gain_per_mm2"], found["by_gain_per_mm2"], rtol=0.05)
    low, high = (gain * seen(1.0, by)["images_per_mm2"][0] + by for by in (-1.0, 1.0))
    assert found["by_offset"][0].min() < 0.98
    np.testing.assert_allclose(found["by_offset"][0], (high - low) / 2.0, rtol=1e-4)
    assert (found["by_offset"][1] == 1.0).all()
    np.testing.assert_array_equal(found["by_gain_per_mm2"][1], found["twin_per_mm2"][1])


def test_modules_of_an_anchor_share_no_random_numbers(source: ExitSource, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither with each other nor with the exits of the twin; in another environment a module keeps its own."""
    seeds = []

    def listed(run: Any, *rest: Any) -> Any:
        seeds.append(run.seed)
        return solver_of(run, *rest)

    monkeypatch.setattr(predictor_module, "solver_of", listed)
    anchor = {"histories": HISTORIES, "seed": "1"}
    ask(request(shot(), shot(NINE), anchor=anchor, exit_seed="1"), worker(source))
    moved = [shot(array, **MOVES["receiver_reflectance"](0.05)) for array in (SINGLE, NINE)]
    ask(request(*moved, anchor=anchor), worker(source))
    assert len({*seeds, "1"}) == 3
    assert seeds[:2] == seeds[2:]
    ask(request(shot(), anchor=anchor | {"seed": "2"}), worker(source))
    assert seeds[4] not in seeds[:4]


def test_bits_do_not_depend_on_what_was_asked_before(monkeypatch: pytest.MonkeyPatch) -> None:
    """Cold, warm, after a chip that could have lent its exits, and after all that was kept has gone."""
    near = [shot(array, environment__chip_absorption_per_cm=203.0) for array in (SINGLE, NINE)]
    anchor = {"histories": HISTORIES, "stored_exits": True}
    plain = request(columns=("absorption_per_um", "distance_um"))
    anchored = request(*near, anchor=anchor | {"shots": [shot(), shot(NINE)]}, columns=("absorption_per_um",))
    cold, cold_anchored = ask(plain), ask(anchored)
    of = worker(ExitSource(memory_bytes=1))
    ask(request(*near, anchor=anchor), of)
    for _ in range(2):
        same(ask(anchored, of), cold_anchored)
        same(ask(plain, of), cold)
    monkeypatch.setattr(of._predictor._anchors, "_most", 0)
    ask(request(*near, anchor=anchor), of)
    assert len(of._predictor._anchors) == 1
    same(ask(anchored, of), cold_anchored)


def test_fields_are_kept_as_far_as_there_is_memory(source: ExitSource, monkeypatch: pytest.MonkeyPatch) -> None:
    """Those of large modules have 150 MB each; a request that needs more than are kept is answered the same."""
    wanted = request(shot(), shot(NINE), shot(), anchor={"histories": HISTORIES})
    plenty, little = worker(source), worker(source)
    monkeypatch.setattr(little._predictor._fields._held, "_most", 1.0)
    same(ask(wanted, plenty), ask(wanted, little))
    assert (len(plenty._predictor._fields._held), len(little._predictor._fields._held)) == (2, 1)
    assert plenty._predictor._fields._held._most == HELD_BYTES


def test_an_anchor_is_kept_for_its_own_requests(source: ExitSource) -> None:
    """Whatever decides it makes another: one worker answers as one that never saw the others."""
    of, plain = worker(source), {"histories": HISTORIES, "stored_exits": True}
    moved = {"shots": [shot(NINE, **MOVES["receiver_reflectance"](0.05))]}
    turned = {"shots": [shot(NINE, camera__rotation_deg=5.0)]}
    seen: list[Arrays] = []
    for change in ({}, {"seed": "2"}, {"stored_exits": False}, {"histories": 2 * HISTORIES}, moved, turned):
        seen.append(ask(request(shot(NINE), anchor=plain | change), of))
        same(seen[-1], ask(request(shot(NINE), anchor=plain | change), worker(source)))
    seen.append(ask(request(shot(NINE), anchor=plain, exit_seed="2"), of))
    for number, one in enumerate(seen):
        for other in seen[:number]:
            shown = [(a["images_per_mm2"], (a["noise_per_mm2"] ** 2).sum(axis=0)) for a in (one, other)]
            assert any(np.abs(a - b).max() > 1e-6 * a.max() for a, b in zip(*shown, strict=True))
    np.testing.assert_allclose(seen[5]["images_per_mm2"], seen[0]["images_per_mm2"], rtol=1e-9)  # its camera's place


def test_threads_and_company_change_nothing(source: ExitSource) -> None:
    """One thread as two; a shot and a column are the same whatever others are asked for."""
    names = ("width_um", "absorption_per_um")
    both = ask(request(columns=names), RayComputation(nobody, source, 2))
    same(ask(request(columns=names), RayComputation(nobody, source, 1)), both)
    for number, name in enumerate(names):
        alone = ask(request(columns=(name,)), worker(source))["jacobian_per_mm2"]
        np.testing.assert_array_equal(alone[0], both["jacobian_per_mm2"][number])
    near = shot(environment__chip_absorption_per_cm=203.0)
    beside = ask(request(near, shot(), shot(NINE), columns=names), worker(source))
    for name, array in both.items():
        shots = (slice(1, None), slice(None, None)) if name == "images_per_mm2" else (slice(None), slice(1, None))
        np.testing.assert_array_equal(beside[name][shots], array)


def test_a_module_seen_by_several_cameras_is_run_once(source: ExitSource, monkeypatch: pytest.MonkeyPatch) -> None:
    """Their noise is one: an image turned to the right has that of one turned to the left, turned."""
    runs = []

    def counted(*given: Any) -> Any:
        runs.append(given)
        return solver_of(*given)

    monkeypatch.setattr(predictor_module, "solver_of", counted)
    seen = [shot(), shot(NINE), *(shot(NINE, camera__rotation_deg=turned) for turned in (45.0, -45.0))]
    noise = ask(request(*seen, anchor={"histories": HISTORIES}), worker(source))["noise_per_mm2"]
    assert len(runs) == 2
    right, left, scale = noise[:, 2], noise[:, 3], np.abs(noise[:, 1:]).max()
    turned = (np.rot90(right, turns, axes=(1, 2)) for turns in (1, -1))
    assert min(np.abs(one - left).max() for one in turned) < 1e-4 * scale
    assert np.abs(noise[:, 1] - left).max() > 0.1 * scale


def test_batches_joined_are_one_walk() -> None:
    """Group by group, as if they had been walked at once."""
    case = scene({"absorption_per_um": 2e-2})
    parts = [make_exits(case, 1, BLOCK, first_block=block, notes=True) for block in range(3)]
    whole, found = make_exits(case, 1, 3 * BLOCK, notes=True), joined(parts, 3)
    for name in ("rays", "notes", "ends", "ledger"):
        np.testing.assert_array_equal(getattr(found, name), getattr(whole, name), err_msg=name)
    assert (found.first_block, found.histories, joined(parts[:1], 1)) == (0, 3 * BLOCK, parts[0])


def test_more_exits_than_a_batch_holds(source: ExitSource) -> None:
    """Two batches are landed where they are asked for, and the image hardly changes."""
    few, many = (ask(request(exit_histories=n), worker(source))["images_per_mm2"] for n in (131_072, 131_073))
    assert 0.0 < np.abs(few - many).max() < 0.1 * many.max()


class Impatient(Progress):
    """A progress that is stopped at its nth report, and keeps all reports."""

    def __init__(self, patience: int) -> None:
        super().__init__()
        self.patience, self.heard = patience, list[float]()

    def report(self, ratio: float, note: str = "") -> None:
        """Note it."""
        self.heard.append(ratio)
        if len(self.heard) == self.patience:
            self.stop.set()
        super().report(ratio, note)


def test_a_prediction_can_be_stopped_anywhere_and_asked_again() -> None:
    """In walks, in Monte Carlo, between images: it ends at the next report, and leaves nothing wrong behind."""
    inputs = request(anchor={"histories": HISTORIES, "stored_exits": False}, columns=("receiver_reflectance",))
    patient = Impatient(10**9)
    expected = dict(worker().compute(inputs, patient)[1])
    assert max(patient.heard) <= 1.0
    assert len(patient.heard) > 20
    for patience in np.linspace(2, len(patient.heard) - 2, 6).astype(int).tolist():
        of = worker()  # one that has run no Monte Carlo yet
        with pytest.raises(Stopped):
            of.compute(inputs, Impatient(patience))
    same(ask(inputs, of), expected)


WALLED = SINGLE | {"wall_reflectance": 0.5}
OTHER_SIZE = shot(camera__rows=8)
BAD: list[tuple[dict[str, Any], str, str]] = [
    ({"columns": ["distance"]}, "columns.0", "did you mean distance_um?"),
    ({"columns": ["distance_um", "distance_um"]}, "columns", "remove"),
    ({"shots": [shot(), OTHER_SIZE]}, "shots", "groups"),
    ({"shots": [shot() | {"array": None}]}, "shots.0.array", "rows = columns = 1"),
    ({"shots": [shot(), shot(WALLED)]}, "shots.1.array.wall_reflectance", "Monte Carlo"),
    ({"shots": [shot({"rows": 51, "columns": 50})]}, "shots.0.array", "a part"),
    ({"shots": [shot(camera__pixel_um=1000.0)]}, "shots.0.x of pixels in um", "smaller pixels"),
    ({"shots": [shot(design__distance_um=35.0)]}, "shots.0.design", ""),
    ({"shots": [shot(design__dbr_pairs=5.5)]}, "shots.0.film", "thin-film worker"),
    ({"shots": [shot(NINE | {"power": [1.0]})]}, "shots.0.array.power", "one for each chip"),
    ({"shots": [shot(camera__rows=4096, camera__columns=4096)] * 3}, "shots", "in parts"),
    (
        {
            "shots": [shot(environment__substrate={"scatter": "lambertian", "reflectance": 0.9})],
            "columns": ["substrate_sigma_rad"],
        },
        "shots.0.substrate",
        "",
    ),
    (
        {
            "shots": [shot(environment__receiver={"scatter": "lambertian", "reflectance": 0.0})],
            "columns": ["receiver_reflectance"],
        },
        "shots.0.receiver_reflectance",
        "leave the column out",
    ),
    ({"shots": [shot(), shot(camera__pixel_um=0.008, camera__psf_um=8.0)]}, "shots.1.camera.pixel_um", "is in um on"),
    (
        {"shots": [shot(camera__pixel_um=0.1, camera__psf_um=15.0)], "anchor": {"histories": 1}},
        "shots.0.camera.pixel_um",
        "is in um on the receiver",
    ),
    (
        {"shots": [shot(camera__pixel_um=0.3, effects=[BLUR])], "anchor": {"histories": 1}},
        "shots.0.camera.pixel_um",
        "is in um on the receiver",
    ),
    ({"anchor": {"shots": [shot()], "histories": 1}}, "anchor.shots", "in the same order"),
    ({"anchor": {"shots": [shot(), shot(WALLED)], "histories": 1}}, "anchor.shots.1.array.wall_reflectance", ""),
    ({"anchor": {"shots": [OTHER_SIZE, OTHER_SIZE], "histories": 1}}, "anchor.shots", "one for each of the wanted"),
    (
        {"shots": [shot(), shot(design__distance_um=float("nan"))]},
        "prediction request: shots.1.design.distance_um",
        "",
    ),
    ({"shots": []}, "prediction request: shots", ""),
    ({"anchor": {"histories": -1}}, "prediction request: anchor.histories", ""),
    ({"exit_histories": 10**9}, "prediction request: exit_histories", ""),
    ({"task": "guess"}, "prediction request: task", ""),
]


@pytest.mark.parametrize(("changes", "field", "mend"), BAD, ids=[f"{field} {mend}" for _, field, mend in BAD])
def test_what_cannot_be_predicted_is_refused_by_name(
    source: ExitSource, changes: dict[str, Any], field: str, mend: str
) -> None:
    """Field, value and mend; the same worker then answers what it can."""
    of = worker(source)
    with pytest.raises(InputError) as caught:
        of.compute(request() | changes, Progress())
    assert caught.value.field == field
    assert mend in caught.value.mend
    assert ask(request(), of)["images_per_mm2"].shape == (2, 16, 16)


def test_known_columns_are_listed(source: ExitSource) -> None:
    """Where one is not known, and in what the worker says of itself."""
    of = worker(source)
    with pytest.raises(InputError) as caught:
        of.compute(request(columns=["colour"]), Progress())
    assert caught.value.allowed == ", ".join(of.catalogue()["columns"]) == ", ".join([*COLUMNS, *CAMERA_COLUMNS])


def test_effects_of_any_shot_are_looked_at(source: ExitSource) -> None:
    """Of the anchor's too: nothing is predicted without an effect of its model."""
    effect = {"name": "receiver_dent", "parameters": {"depth_um": 2.0}}
    with_effect = shot(effects=[effect])
    for wanted in (request(with_effect), request(anchor={"shots": [shot(), with_effect], "histories": 1})):
        with pytest.raises(RemoteError) as caught:
            worker(source).compute(wanted, Progress())
        assert caught.value.failure.code == "unknown_effect"


def test_the_sensor_has_no_part_in_a_prediction(source: ExitSource) -> None:
    """Irradiance comes before gain, offset and saturation."""
    sensor = {"camera__gain_dn": 7.0, "camera__offset_dn": 3.0, "camera__full_scale_dn": 1.0}
    one, other = (ask(request(one), worker(source)) for one in (shot(), shot(**sensor)))
    same(one, other)
    assert Environment(**DIM).chip_absorption_per_cm == 200.0
