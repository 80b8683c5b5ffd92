"""Model and data side by side, on an analytic predictor: what is told, and what is not trusted."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from luxloop.audit import Compared, Place
from luxloop.effect import AppliedEffect
from luxloop.errors import InputError
from luxloop.model import Model
from luxloop.model_file import find_model
from tests.validation import analytic as spots
from validation import reexecute, told, virtual_realistic
from validation.auditor import compared as re_derived
from validation.auditor import decided
from validation.calibrate_command import paths_of
from validation.calibration import calibrated
from validation.compare_command import errors_of as errors_kept
from validation.comparing import Solver, compared, differing
from validation.fit.problem import sensor_of
from validation.observed import Observed
from validation.prediction import Predicted, View
from validation.profiles import profiles
from validation.virtual_realistic import KINDS, Candidate, Experiment, errors_of, line_of


def observed() -> Observed:
    """Two images with the noise of a camera."""
    return Observed(tuple(spots.two_images()), (), (), {})


def test_a_model_that_is_right_differs_by_noise_alone() -> None:
    """No shot is called different, chi2 is 1 per pixel, and the document is plain JSON."""
    found = compared(spots.MODEL, observed(), spots.Spots(), Solver(None), free=tuple(spots.MODEL.fit))
    assert found.differ == []
    assert found.structure.p > 0.01
    document = json.loads(json.dumps(found.document(), allow_nan=False))
    assert [shot["id"] for shot in document["shots"]] == list(found.observed.shots)
    for shot in document["shots"]:
        assert shot["rms_error_percent"] == pytest.approx(shot["noise_percent"], rel=0.1)
        assert shot["chi2_per_pixel"] == pytest.approx(1.0, abs=0.15)
    assert "none of the" in document["sentence"]
    assert document["solver"]["method"] == "twin"


def test_of_many_shots_chance_names_none() -> None:
    """Each of n is held to an n-th of 1 %; of very many those beyond all draws, if all together are seen."""
    rng = np.random.default_rng(1)
    told_of = [differing(dict(enumerate(rng.uniform(size=50))), 0.5) for _ in range(1000)]
    assert sum(map(bool, told_of)) < 25  # 10 are expected; each at 1 % 395 would be
    few = {"a": 0.004, "b": 0.3, "c": 0.0001}
    assert differing(few, 0.3) == ["c"]
    assert differing({"a": 0.009}, 0.5) == ["a"]
    many = {f"{number}": 0.5 for number in range(200)} | {"0": 1 / 10_001, "1": 0.0002}
    assert (differing(many, 0.02), differing(many, 0.002)) == ([], ["0"])


def test_a_sentence_on_record_is_held_against_the_level_of_its_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """Before, each shot was held to 1 %, however many there were; a sentence that neither gives differs.

    The same where the fit is made anew.
    """
    document = compared(spots.MODEL, observed(), spots.Spots(), Solver(None)).document()
    document["structure"] |= {"p": 0.2, "p_text": "0.2", "draws": 9999}
    for shot, p in zip(document["shots"], (0.007, 0.5), strict=True):
        shot |= {"p": p, "p_text": f"{p:g}"}

    def verdict(sentence: str) -> str:
        found: list[Compared] = []
        decided(document | {"sentence": sentence}, Place(found.append))
        return next(one.verdict for one in found if one.what == "sentence")

    none = "none of the 2 images differs from the model by more than noise (p = 0.2)"
    one = "1 of 2 images differ from the model by more than noise"
    assert verdict(none) == verdict(one) == "identical"
    assert verdict("2 of 2 images differ from the model by more than noise") == "differs"

    def anew(sentence: str) -> str:
        step = SimpleNamespace(document={"sentence": sentence})
        return str(reexecute.compared_again(step, spots.MODEL, reexecute.FromAnswers({}))["sentence"])

    now = SimpleNamespace(document=lambda: document | {"sentence": none})
    monkeypatch.setattr(reexecute, "compared", lambda *_: now)
    monkeypatch.setattr(reexecute, "_asked", lambda _: (None, None))
    assert [anew(said) for said in (none, one, "2 of 2")] == [none, one, none]


def test_residuals_are_measured_less_model_in_standard_deviations() -> None:
    """Of each image; NaN where a pixel is not used."""
    found = compared(spots.MODEL, observed(), spots.Spots(), Solver(None))
    arrays = found.arrays()
    for image in found.fit.problem.images:
        left = arrays[f"{image.shot.id}/measured_dn"] - arrays[f"{image.shot.id}/model_dn"]
        sd = np.sqrt(image.variance_dn2(arrays[f"{image.shot.id}/model_dn"]))
        z = arrays[f"{image.shot.id}/z"]
        assert np.isfinite(z).sum() == image.used.sum()
        np.testing.assert_allclose(z[image.used], (left / sd)[image.used], atol=0.1)


def test_every_image_has_its_profiles() -> None:
    """Against distance, azimuth, radius and frequency; most points lie in the band of noise."""
    found = compared(spots.MODEL, observed(), spots.Spots(), Solver(None), free=tuple(spots.MODEL.fit))
    rows = profiles(found.fit)
    for image in found.fit.problem.images:
        against = {row["against"] for row in rows if row["shot"] == image.shot.id}
        assert against == {"distance from the nearest chip", "azimuth", "field radius", "spatial frequency"}
    inside = [
        abs(value) <= band
        for row in rows
        if "relative_percent" in row
        for value, band in zip(row["relative_percent"], row["band_percent"], strict=True)
    ]
    assert np.mean(inside) > 0.9


def test_the_table_has_a_line_for_every_shot() -> None:
    """And says what may not be trusted of the twin alone."""
    found = compared(spots.MODEL, observed(), spots.Spots(), Solver(None))
    text = "\n".join(told.comparison(found.document()))
    assert all(shot in text for shot in found.observed.shots)
    assert "By the twin alone" in text


def test_an_image_tells_its_own_values_with_errors_and_a_wrong_exposure_is_said() -> None:
    """Gains tied to exposures: one that is 6 % off pulls at its prior of 1 %, in the JSON and on the terminal."""
    seen = observed()
    images = []
    for image, exposure in zip(seen.images, (8.0 * 1.06, 8.0), strict=True):  # both of the same gain
        camera = image.camera.model_copy(update={"gain_mode": "exposure"})
        shot = image.shot.model_copy(update={"exposure_ms": exposure})
        images.append(replace(image, camera=camera, shot=shot))
    right = replace(images[0], shot=images[0].shot.model_copy(update={"exposure_ms": 8.0}))
    plain = compared(spots.TRUTH, replace(seen, images=(right, images[1])), spots.Spots(), Solver(None)).document()
    assert not list(told.pulled(plain["shots"]))
    document = compared(spots.TRUTH, replace(seen, images=tuple(images)), spots.Spots(), Solver(None)).document()
    shot = next(one for one in document["shots"] if one["id"] == images[0].shot.id)
    (gain,) = (one for one in shot["nuisances"] if one["name"] == "gain_error")
    assert gain["value"] < -0.02
    assert 0.0 < gain["error"] < 0.01
    assert gain["pull"] == pytest.approx(gain["value"] / 0.01)
    assert any("is its exposure_ms right?" in line for line in told.pulled(document["shots"]))


def test_rows_of_binned_images_are_told_to_be_no_rows_of_the_camera() -> None:
    """Only where lines of the image are named, and only of what was binned; earlier documents know of no binning."""
    shots = [{"id": "a", "binning": 4}, {"id": "b", "binning": 1}, {"id": "c"}]
    assert not list(told.binned(shots, ["azimuth 315-337.5 deg", "the 3 rows"]))
    (line,) = told.binned(shots, ["a  2.43 %  rows 2-3, columns 22-23 (-3.4 sigma)"])
    assert line == "Rows and columns of a are of the images as compared: each is 4 of the camera's."
    (line,) = told.binned(shots[:1], ["columns 40-41 (+2.9 sigma)"])
    assert line == "Rows and columns are of the images as compared: each is 4 of the camera's."
    assert not list(told.binned(shots[1:], ["columns 40-41 (+2.9 sigma)"]))


def test_a_straight_line_is_found_with_its_weights() -> None:
    """Slope and intercept; a point without weight has no say."""
    x = np.linspace(0.0, 1.0, 9)
    y = 3.0 * x + 0.5
    y[4] = 100.0
    weight = np.ones(9)
    weight[4] = 0.0
    assert line_of(x, y, weight) == pytest.approx((3.0, 0.5))


def test_the_error_of_eq_1_is_what_gain_and_offset_leave() -> None:
    """0 for any gain and offset of the same image; in DN^2 as large as what was added to it."""
    image = spots.two_images()[0]
    light = (image.signal_dn - 5.0) / 700.0
    mse, mse_dn2, chi2 = errors_of(image, light)
    assert (mse, mse_dn2, chi2) == pytest.approx((0.0, 0.0, 0.0), abs=1e-18)
    rng = np.random.default_rng(1)
    noisy = light + rng.standard_normal(light.shape) * 2.0 / 700.0
    assert errors_of(image, noisy)[1] == pytest.approx(4.0, rel=0.2)


def test_a_candidate_changes_one_surface_and_its_fit() -> None:
    """A Lambertian surface has no sigma, so no fit of one; the other surface stays."""
    model = find_model("paper")
    changed = Candidate("substrate", "Lambertian", 0.95).applied(model)
    assert changed.environment.substrate.scatter == "lambertian"
    assert changed.environment.substrate.reflectance == 0.95
    assert "environment.substrate.sigma_deg" not in changed.fit
    assert changed.environment.receiver == model.environment.receiver
    assert (
        Candidate("receiver", "Gaussian 5 deg", 0.3).applied(model).environment.receiver.sigma_deg
        == KINDS["Gaussian 5 deg"]
    )


def test_a_value_that_no_shot_sees_has_no_error(monkeypatch: pytest.MonkeyPatch) -> None:
    """Regression: infinite, it could not be put on record, and nothing was told at all."""
    found = compared(spots.MODEL, observed(), spots.Spots(), Solver(None), free=tuple(spots.MODEL.fit))
    monkeypatch.setattr(type(found.fit), "error", lambda *_: math.inf)
    document = json.loads(json.dumps(found.document(), allow_nan=False))
    assert [one["error"] for one in document["parameters"]] == [None] * len(spots.MODEL.fit)
    assert any("not seen by these data" in line for line in told.comparison(document | {"warnings": []}))


def test_candidates_of_a_surface_are_seen_by_the_sensor_that_the_fit_has() -> None:
    """Regression: an effect on a sensor's signal acted on irradiances, of a camera with gain 1: not at all."""
    seen: list[View] = []

    class Watched(spots.Spots):
        def images(self, model: Model, views: Sequence[View], *more: Any, **options: Any) -> list[Predicted]:
            seen.extend(views)
            return super().images(model, views, *more, **options)

    found = compared(spots.MODEL, observed(), spots.Spots(), Solver(None)).fit
    values = found.problem.unknowns.named(found.values)
    images = observed().images
    for effects in ((), (AppliedEffect(name="nonlinearity", parameters={"bend": 0.05}),)):
        experiment = Experiment(images, found.poses, values, Watched(), Solver(None).anchor(spots.MODEL))
        experiment.tried(spots.MODEL.model_copy(update={"effects": effects}), [], images)
    assert [view.sensor for view in seen[:2]] == [None, None]
    assert [view.sensor for view in seen[2:]] == [sensor_of(image, values) for image in images]


def test_an_experiment_needs_images_of_both_layouts() -> None:
    """Said by name, before anything is predicted."""
    experiment = Experiment((), {}, {}, spots.Spots(), Solver(None).anchor(spots.MODEL))
    with pytest.raises(InputError, match="layout single"):
        experiment.stage(find_model("paper"), "substrate", lambda *_: None)


def test_what_has_no_limits_cannot_be_fitted() -> None:
    """Names what can be."""
    model = find_model("paper")
    assert "environment.substrate.reflectance" in paths_of(model, None)
    with pytest.raises(InputError, match=r"environment\.n_gan"):
        paths_of(model, "environment.n_gan")


def test_a_calibration_tells_values_errors_and_what_became_of_the_file() -> None:
    """By the fit alone: every fitted parameter with its interval and profile; the file only where it was written."""
    free = list(spots.MODEL.fit)
    found = calibrated(spots.MODEL, observed(), spots.Spots(), Solver(None), way=None, free=free)
    document = json.loads(json.dumps(found.document(), allow_nan=False)) | {"model": {"file": "mine.toml"}}
    assert [row["path"] for row in document["fit"]["parameters"]] == free
    for row in document["fit"]["parameters"]:
        assert row["lower95"] < row["value"] < row["upper95"]
    assert {one["path"] for one in document["fit"]["profiles"]} == set(free)
    assert all(min(one["chi2"]) > -0.5 for one in document["fit"]["profiles"])
    assert document["fit"]["unseen"] == document["fit"]["left_out"] == []
    lost = replace(found, asked=(*found.asked, "environment.receiver.sigma_deg")).document()
    assert (lost["fit"]["unseen"], lost["fit"]["left_out"]) == ([], ["environment.receiver.sigma_deg"])
    assert "mine.toml is as it was" in "\n".join(told.calibration(document | {"version": None}))
    text = "\n".join(told.calibration(document | {"version": 3}))
    assert "mine.toml is version 3" in text
    document["shots"][0]["unit"] = "deg"  # as that of psi
    in_degrees = "\n".join(told.calibration(document | {"version": 3}))
    assert [in_degrees.count(unit) - text.count(unit) for unit in (" deg", " %")] == [4, -4]


def test_a_version_keeps_errors_of_angles_in_degrees() -> None:
    """Of all other shots in percent."""
    psi = {"id": "psi", "unit": "deg", "rms_error": 0.5, "rms_error_percent": 0.5}
    shots = [psi, {"id": "R", "unit": "1", "rms_error": 0.01, "rms_error_percent": 3.0}]
    found: Any = SimpleNamespace(document=lambda: {"shots": shots}, structure=SimpleNamespace(p=0.2))
    assert errors_kept(found) == {"psi rms deg": 0.5, "R rms %": 3.0, "p": 0.2}


def test_the_joint_experiment_is_not_told_as_that_in_turn(monkeypatch: pytest.MonkeyPatch) -> None:
    """All images decide, each curve is the best over the other surface, and there are no rounds."""
    few = {"substrate": (0.6, 0.7), "receiver": (0.4, 0.5)}
    monkeypatch.setattr(virtual_realistic, "REFLECTANCES", few)
    monkeypatch.setattr(virtual_realistic, "KINDS", {"Gaussian 5 deg": 5.0, "Gaussian 10 deg": 10.0})
    joint, in_turn = (
        calibrated(spots.MODEL, observed(), spots.Spots(), Solver(None), way=way, free=[]).document()
        for way in ("joint", "in turn")
    )
    parts = ("the substrate, with the best receiver", "the receiver, with the best substrate")
    assert [one["name"] for one in joint["stages"]] == [f"all images: {part}" for part in parts]
    assert [one["best"]["x"] for one in joint["stages"]] == [0.7, 0.5]
    assert joint["rounds"] == []
    names = ["single chips: the substrate", "chip arrays: the receiver"]
    assert [one["name"] for one in in_turn["stages"]] == names
    assert len(in_turn["rounds"]) > 2


def test_a_changed_pixel_of_a_residual_is_found_by_the_replay() -> None:
    """Chi2 follows from the maps; a map that was altered, or is not there, is named by its shot."""
    found = compared(spots.MODEL, observed(), spots.Spots(), Solver(None))
    document, maps = found.document(), found.residual_maps()
    first = next(iter(maps))

    def verdicts(of: dict[str, np.ndarray]) -> dict[str, str]:
        told_: list[Compared] = []
        re_derived(document, of, Place(told_.append))
        return {one.what: one.verdict for one in told_}

    assert set(verdicts(maps).values()) <= {"identical", "within tolerance"}
    altered = maps[first].copy()
    altered[3, 3] += 20.0
    assert verdicts(maps | {first: altered})[f"chi2 per pixel, {first}"] == "differs"
    assert verdicts({})[f"chi2 per pixel, {first}"] == "not comparable"


def test_a_diagnosis_lets_the_last_anchor_have_eight_times_as_many_histories():
    """Unless it is told; the twin alone has none. It stands in the record."""
    assert Solver.of_diagnosis(4_000_000, 2, None) == Solver(4_000_000, 2, 32_000_000)
    assert Solver.of_diagnosis(4_000_000, 2, 0) == Solver(4_000_000, 2)
    assert Solver.of_diagnosis(None, 2, None) == Solver(None, 2)
    assert Solver.of_diagnosis(200_000_000, 2, None).most_histories == 10**9  # that a request may ask for
    assert Solver.of_diagnosis(1_000, 2, 5_000).document()["most_histories"] == 5_000
