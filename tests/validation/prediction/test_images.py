"""Predictions against the workers that make them: what is asked, and that derivatives are those of the answers."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from luxloop.effect import AppliedEffect
from luxloop.errors import InputError, RemoteError
from luxloop.failure import Failure
from luxloop.messages import Pending
from luxloop.model import Fit, Model
from luxloop.model_file import find_model
from luxloop.ray import PredictionRequest
from tests.validation.prediction.views import FOUR, LAYER, LOSS, RECEIVER, SIGMA, SINGLE, SUBSTRATE, view
from tests.validation.workers import Workers
from validation.diagnose.columns import FitSight
from validation.effects.known import Known
from validation.effects.signatures import Sight, signature
from validation.prediction import POSE_COLUMNS, Anchored, Pose, Predictor
from validation.prediction import images as images_module
from validation.prediction.differences import moved_models
from validation.prediction.words import run_of


def test_views_of_one_size_are_one_request(workers: Workers, model: Model) -> None:
    """Two samples cost one question; a third of another size one more; the order is that of the views."""
    predictor = Predictor(workers)
    found = predictor.images(model, [view(), view(FOUR), view(size=10), view(FOUR)])
    assert [len(request.shots) for request in workers.of_kind("ray")] == [1, 3]
    assert [one.irradiance_per_mm2.shape for one in found] == [(12, 12), (12, 12), (10, 10), (12, 12)]
    np.testing.assert_array_equal(found[1].irradiance_per_mm2, found[3].irradiance_per_mm2)
    assert all(not one.jacobian_per_mm2 and one.noise_per_mm2 is None for one in found)


def test_a_sample_for_which_fewer_histories_do_has_a_request_of_its_own(workers: Workers, model: Model) -> None:
    """With its own number of them; what it sees does not depend on whom it is asked with."""
    few = Anchored(model, 65_536, enough=((FOUR.id, 32_768),))
    views = [view(), view(FOUR)]
    found = Predictor(workers).images(model, views, (), few)
    asked = {request.anchor.histories: request.shots[0].array.rows for request in workers.of_kind("ray")}
    assert asked == {65_536: 1, 32_768: 2}
    for one, here, anchor in zip(found, views, (few, replace(few, histories=32_768)), strict=True):
        (alone,) = Predictor(workers).images(model, [here], (), anchor)
        np.testing.assert_array_equal(one.irradiance_per_mm2, alone.irradiance_per_mm2)


def test_a_sample_is_asked_for_as_it_stands(workers: Workers, model: Model) -> None:
    """Its design, its half width (2 mm around a single), its film, its camera."""
    turned = view(FOUR, pose=Pose((0.5, -1.0), 2.0))
    single = replace(view(), sample=SINGLE.model_copy(update={"module_half_um": None}))
    Predictor(workers).images(model, [turned, single])
    (request,) = workers.of_kind("ray")
    four, one = request.shots
    assert (four.array.rows, four.array.columns, four.array.half_um) == (2, 2, 400.0)
    assert (one.array.rows, one.array.half_um, one.film) == (1, 2000.0, None)
    assert four.film is not None
    assert four.design == FOUR.design
    assert (four.camera.shift_px, four.camera.rotation_deg, four.camera.centre_px) == ((0.5, -1.0), 2.0, (5.5, 5.5))
    assert (four.camera.gain_dn, four.camera.pixel_um) == (1.0, 50.0)


def test_absorption_by_an_effect_is_the_absorption_of_the_chip(workers: Workers, model: Model) -> None:
    """One column serves both, so that an effect that is named is known as well as what it adds to."""
    path = "effects.chip_absorption.absorption_per_cm"
    effect = AppliedEffect(name="chip_absorption", parameters={"absorption_per_cm": 120.0, "profile": "even"})
    split = model.model_copy(update={"effects": (effect,)}).with_value(LOSS, 80.0)
    (found,) = Predictor(workers).images(split, [view(FOUR)], (LOSS, path), Anchored(split, 0))
    (whole,) = Predictor(workers).images(model.with_value(LOSS, 200.0), [view(FOUR)], (LOSS,), Anchored(model, 0))
    np.testing.assert_array_equal(found.jacobian_per_mm2[path], found.jacobian_per_mm2[LOSS])
    np.testing.assert_allclose(found.jacobian_per_mm2[path], whole.jacobian_per_mm2[LOSS], rtol=1e-6)
    assert np.all(found.jacobian_per_mm2[path] < 0.0)


@pytest.mark.parametrize("profile", ["rising", "falling"])
def test_absorption_that_rises_has_a_column_of_its_own(workers: Workers, model: Model, profile: str) -> None:
    """It is the difference of two images by one walk, and not the column of even absorption."""
    path = "effects.chip_absorption.absorption_per_cm"

    def at(per_cm: float) -> Model:
        parameters = {"absorption_per_cm": per_cm, "profile": profile}
        return model.model_copy(update={"effects": (AppliedEffect(name="chip_absorption", parameters=parameters),)})

    predictor, anchor = Predictor(workers), Anchored(at(100.0), 0)
    (found,) = predictor.images(at(100.0), [view(FOUR)], (LOSS, path), anchor)
    low, high = (predictor.images(at(per_cm), [view(FOUR)], (), anchor)[0] for per_cm in (95.0, 105.0))
    difference = (high.irradiance_per_mm2 - low.irradiance_per_mm2) / 10.0
    own, even = (found.jacobian_per_mm2[one] for one in (path, LOSS))
    assert np.linalg.norm(own - difference) < 0.02 * np.linalg.norm(difference)
    assert np.linalg.norm(own - even) > 0.1 * np.linalg.norm(even)


def test_a_profile_that_is_missing_is_refused_by_the_worker(workers: Workers, model: Model) -> None:
    """For any path; and one that a sample has of its own has no column of the others'."""
    effect = AppliedEffect(name="chip_absorption", parameters={"absorption_per_cm": 120.0})
    lacking = model.model_copy(update={"effects": (effect,)})
    for paths in ((RECEIVER,), (images_module.ABSORPTION,)):
        with pytest.raises(RemoteError, match="profile"):
            Predictor(workers).images(lacking, [view(FOUR)], paths)
    whole = effect.model_copy(update={"parameters": effect.parameters | {"profile": "rising"}})
    given = model.model_copy(
        update={"effects": (whole,), "samples": {FOUR.id: {effect.name: {"profile": "falling"}}}}
    )
    for one, known in ((given, False), (given.model_copy(update={"samples": {}}), True)):
        wanted = images_module.Wanted(one, (images_module.ABSORPTION,), None, lambda *_: None)
        assert (images_module.ABSORPTION in wanted.columns) is known
        assert (images_module.ABSORPTION in wanted.differences) is not known


def test_what_acts_by_chance_is_moved_far(workers: Workers, model: Model) -> None:
    """By a quarter of its range: two walks then agree about what the substrate scatters into all directions."""
    path = "effects.substrate_lobe.lambertian_share"
    lobe = AppliedEffect(name="substrate_lobe", parameters={"lambertian_share": 0.4})
    there = model.model_copy(update={"effects": (lobe,), "fit": {path: Fit(free=True, lower=0.0, upper=1.0)}})
    wanted = images_module.Wanted(there, (path,), None, lambda *_: None, by_chance=frozenset(["substrate_lobe"]))
    moves = list(images_module._moves(wanted, [view()]))
    assert [one.model.leaves()[path] for one in moves] == pytest.approx([0.65, 0.15])
    runs = [
        Predictor(workers).images(there, [view()], (path,), Anchored(there, 0, exit_seed=seed)) for seed in (2, 3)
    ]
    first, second = (found[0].jacobian_per_mm2[path].ravel() for found in runs)
    assert first @ second > 0.8 * np.linalg.norm(first) * np.linalg.norm(second)


def test_two_walks_agree_about_the_column_of_a_leak(workers: Workers, model: Model) -> None:
    """Which is spread in waves: drawn ray by ray, by a tenth of the range as a step, they agreed to 0.86."""
    predictor, spec = Predictor(workers), Known.ask(workers).spec("substrate_leak")
    views = [view(SINGLE, 28), view(FOUR, 28)]
    light = np.concatenate([one.irradiance_per_mm2.ravel() for one in predictor.images(model, views)])
    columns = []
    for run in range(2):
        (one,) = signature(Sight(predictor, views, run=run), model, spec)
        columns.append(np.concatenate([part.ravel() for part in one.parts]) / np.sqrt(light + 1e-9 * light.max()))
    first, second = columns
    assert first @ second > 0.998 * np.linalg.norm(first) * np.linalg.norm(second)


def test_films_are_asked_for_once(workers: Workers, model: Model) -> None:
    """What is no part of the film moves without a new question; the film's own layers do not."""
    predictor = Predictor(workers)
    for reflectance in (0.30, 0.32):
        predictor.images(model.with_value(RECEIVER, reflectance), [view(FOUR)])
    assert len(workers.of_kind("film")) == 1
    predictor.images(model.with_value("environment.aln_layer_nm", 50.0), [view(FOUR)])
    assert len(workers.of_kind("film")) == 2


def test_a_table_that_has_gone_is_computed_again(folder: Path, model: Model) -> None:
    """Once; a second loss is told."""
    workers = Workers(folder)
    workers.lost.add(workers.run(_film_request(model)).result["table_sha256"])
    predictor = Predictor(workers)
    assert predictor.images(model, [view(FOUR)])[0].irradiance_per_mm2.max() > 0.0

    class Forgetful(Workers):
        def _fetch(self, sha256: str, size: int) -> bytes:
            self.lost.add(sha256)
            return super()._fetch(sha256, size)

    with pytest.raises(RemoteError, match="nobody holds"):
        Predictor(Forgetful(folder)).images(model, [view(FOUR)])


def _film_request(model: Model) -> Any:
    asked = Recorder()
    with pytest.raises(LookupError):
        Predictor(asked).images(model, [view(FOUR)])
    return asked.request


class Recorder:
    """A client that keeps the first request and answers none."""

    def run(self, request: Any, **_: Any) -> Any:
        """Keep it."""
        self.request = request
        raise LookupError


STEPS = {SUBSTRATE: 5e-3, RECEIVER: 0.02, LOSS: 6.0}


def test_derivatives_are_differences_of_images_in_the_units_of_the_model(workers: Workers, model: Model) -> None:
    """By reflectances as shares, by loss per cm: from one request beside the images, one column each."""
    predictor = Predictor(workers)
    views = [view(), view(FOUR)]
    found = predictor.images(model, views, tuple(STEPS))
    assert len(workers.of_kind("ray")) == 2
    near = Anchored(model, histories=1)  # the same exits, reweighted, on either side
    for path, h in STEPS.items():
        value = model.leaves()[path]
        up, down = (predictor.images(model.with_value(path, value + s * h), views, (), near) for s in (1, -1))
        for one, high, low in zip(found, up, down, strict=True):
            difference = (high.irradiance_per_mm2 - low.irradiance_per_mm2) / (2.0 * h)
            error = np.sqrt(np.mean((one.jacobian_per_mm2[path] - difference) ** 2))
            assert error < 0.1 * np.sqrt(np.mean(difference**2)), path


def test_a_lobes_width_is_differentiated_per_degree(workers: Workers, model: Model) -> None:
    """Its column is asked for in radians and comes back pi / 180 as large."""
    found = Predictor(workers).images(model, [view()], (SIGMA,))
    request = next(one for one in workers.of_kind("ray") if one.columns)
    assert request.columns == ("substrate_sigma_rad",)
    column = workers.run(request).arrays["jacobian_per_mm2"][0, 0]
    np.testing.assert_allclose(found[0].jacobian_per_mm2[SIGMA], np.pi / 180.0 * column, rtol=1e-6)


def test_derivatives_by_the_pose_are_differences_of_moved_cameras(workers: Workers, model: Model) -> None:
    """Per pixel and per degree, beside another column, whatever their order."""
    predictor = Predictor(workers)
    found = predictor.images(model, [view(FOUR)], ("shift_column_px", RECEIVER, "shift_row_px", "rotation_deg"))[0]
    moves = {
        "shift_row_px": ((0.1, 0.0), 0.0),
        "shift_column_px": ((0.0, 0.1), 0.0),
        "rotation_deg": ((0.0, 0.0), 0.5),
    }
    for name, (shift, turn) in moves.items():
        poses = [Pose((s * shift[0], s * shift[1]), s * turn) for s in (1.0, -1.0)]
        high, low = predictor.images(model, [view(FOUR, pose=pose) for pose in poses])
        difference = (high.irradiance_per_mm2 - low.irradiance_per_mm2) / (2.0 * (max(shift) or turn))
        np.testing.assert_allclose(found.jacobian_per_mm2[name], difference, atol=0.02 * np.abs(difference).max())
    assert set(found.jacobian_per_mm2) == {*POSE_COLUMNS, RECEIVER}


def test_what_no_worker_differentiates_is_moved(workers: Workers, model: Model) -> None:
    """The derivative by the chip's index predicts another index's image; one that scales lux alone has none."""
    predictor, path = Predictor(workers), "environment.n_gan"
    found = predictor.images(model, [view()], (path, "environment.flux_per_chip_w"))[0]
    (moved,) = predictor.images(model.with_value(path, 2.4869 + 0.03), [view()])
    change = moved.irradiance_per_mm2 - found.irradiance_per_mm2
    assert np.sqrt(np.mean((change - 0.03 * found.jacobian_per_mm2[path]) ** 2)) < 0.5 * np.sqrt(np.mean(change**2))
    assert not found.jacobian_per_mm2["environment.flux_per_chip_w"].any()


def test_differences_stay_within_the_range_and_are_exact_for_parabolas(model: Model) -> None:
    """A layer at 0.99 moves down only, one at 0.5 both ways, one at 0 up; 3 x + x^2 has its slope."""
    for at, places in ((0.99, [0.99, 0.79, 0.59]), (0.5, [0.7, 0.3]), (0.0, [0.0, 0.2, 0.4])):
        moved = moved_models(model.with_value(LAYER, at), LAYER)
        values = [one.what.environment.active_layer_depth or 0.0 for one in moved]
        np.testing.assert_allclose(values, places)
        slope = sum(one.weight * (3.0 * x + x * x) for one, x in zip(moved, values, strict=True))
        assert slope == pytest.approx(3.0 + 2.0 * at)


def test_differences_are_asked_for_once_in_an_anchored_fit(
    workers: Workers, model: Model, monkeypatch: pytest.MonkeyPatch
) -> None:
    """About the anchor's model and a rounded pose: a small step of the fit asks the same question again."""
    monkeypatch.setattr(images_module, "DIFFERENCE_EXITS", 1 << 15)
    predictor, at = Predictor(workers), Anchored(model, 1)
    asked = []
    for step in (0.0, 0.01):
        workers.asked.clear()
        moved = model.with_value(RECEIVER, 0.35 - step)
        predictor.images(moved, [view(pose=Pose((0.3 + step, 0.0), step))], (LAYER,), at)
        asked += [one for one in workers.of_kind("ray") if one.anchor is not None and not one.anchor.histories]
    assert len(asked) == 2
    assert asked[0] == asked[1]


def test_derivatives_by_a_mirror_are_those_of_one_walk(workers: Workers, model: Model) -> None:
    """The moved mirrors' images by the exits of the chip between them: two walks agree about their difference.

    Each mirror's own exits had two walks agree by nothing (0.0 and -0.1), and refits by them found no end.
    """
    rough = AppliedEffect(name="dbr_roughness", parameters={"roughness_nm": 5.0})
    path = "effects.dbr_roughness.roughness_nm"
    limits = {path: Fit(free=True, lower=0.0, upper=8.0)}
    there = model.model_copy(update={"effects": (rough,), "fit": model.fit | limits})
    first, second = (
        Predictor(workers).images(there, [view(FOUR)], (path,), Anchored(model, 0, exit_seed=seed))[0]
        for seed in (1, 2)
    )
    slopes = [one.jacobian_per_mm2[path].ravel() for one in (first, second)]
    assert np.corrcoef(*slopes)[0, 1] > 0.95


def test_derivatives_by_a_lens_are_of_all_the_light_that_an_anchor_knows(workers: Workers, model: Model) -> None:
    """What Monte Carlo has over the twin is blurred, too: those of a fit, and the columns by which effects score."""
    at, views, predictor = Anchored(model, 1 << 16, seed=3), [view(size=16), view(FOUR, size=16)], Predictor(workers)
    path, shape = "effects.camera_psf.psf_um", {"profile": "gaussian"}
    there = model.model_copy(
        update={
            "effects": (AppliedEffect(name="camera_psf", parameters={"psf_um": 20.0} | shape),),
            "fit": model.fit | {path: Fit(free=True, lower=0.0, upper=50.0)},
        }
    )
    found, by_twin = (predictor.images(there, views, (path,), one) for one in (at, replace(at, histories=0)))
    moved = [(weight, predictor.images(one, views, (), at, noise=False)) for weight, one in moved_models(there, path)]
    known = Known.ask(workers)
    sight = FitSight(predictor, views, problem=SimpleNamespace(anchor=at, curves=()))  # type: ignore[arg-type]  # duck
    (column,) = sight.signature(model, known.spec("camera_psf"), shape)
    off, near, far = (
        predictor.images(there.with_value(path, step), views, (), at, noise=False)
        for step in (0.0, np.sqrt(column.step), np.sqrt(2.0 * column.step))
    )
    for number, one in enumerate(found):
        assert one.noise_per_mm2 is not None
        slope, twins = one.jacobian_per_mm2[path], by_twin[number].jacobian_per_mm2[path]
        expected = sum(weight * images[number].irradiance_per_mm2 for weight, images in moved)
        np.testing.assert_allclose(slope, expected, atol=1e-6 * np.abs(slope).max())
        assert np.abs(slope - twins).max() > 0.01 * np.abs(slope).max()
        assert moved[0][1][number].noise_per_mm2 is None
        stencil = zip((-1.5, 2.0, -0.5), (off, near, far), strict=True)
        by_square = sum(weight * images[number].irradiance_per_mm2 for weight, images in stencil) / column.step
        np.testing.assert_allclose(column.parts[number], by_square, atol=1e-9 * np.abs(by_square).max())
    quiet = [one for one in workers.asked if isinstance(one, PredictionRequest) and not one.noise]
    assert {one.exit_histories for one in quiet} == {images_module.COLUMN_EXITS}


def test_a_derivative_that_the_worker_has_is_taken_once(workers: Workers, model: Model) -> None:
    """Absorption that an effect adds has the column of the model's own, about Monte Carlo too, and no other."""
    path = "effects.chip_absorption.absorption_per_cm"
    more = AppliedEffect(name="chip_absorption", parameters={"absorption_per_cm": 20.0, "profile": "even"})
    limits = {path: Fit(free=True, lower=0.0, upper=500.0)}
    there = model.model_copy(update={"effects": (more,), "fit": model.fit | limits})
    (found,) = Predictor(workers).images(there, [view()], (path, LOSS), Anchored(there, 1 << 16))
    slope, own = (found.jacobian_per_mm2[one] for one in (path, LOSS))
    np.testing.assert_allclose(slope, own, atol=1e-6 * np.abs(own).max())


def test_images_of_one_sample_are_asked_for_together() -> None:
    """Twice four samples at 128 x 128: five images are a request's; parted, one run's noise would be told apart."""
    samples = [SINGLE.model_copy(update={"id": f"s{number}"}) for number in range(4)]
    views = [view(sample, size=128) for sample in (*samples, *samples)]
    groups = list(images_module._groups(views, images_module.MOST_VALUES // (5 * 128 * 128)))
    assert groups == [[0, 4, 1, 5], [2, 6, 3, 7]]
    assert list(images_module._together([[1, 2, 3], [4], [5, 6]], 2)) == [[1, 2], [3, 4], [5, 6]]


def test_two_samples_of_one_module_are_seen_by_one_run(workers: Workers, model: Model) -> None:
    """Replicates: the worker's histories are of the module, whatever it is called, so their images err together; as
    two runs, two images at a noise of 0.3 were told to differ from a right model in 13 % of cases at 1 %."""
    twin = SINGLE.model_copy(update={"id": "two"})
    apart = model.model_copy(update={"samples": {"two": {}}})
    assert run_of(SINGLE, model) == run_of(twin, model) != run_of(FOUR, model)
    assert run_of(twin, apart) == "two"
    views, at = [view(SINGLE), view(twin)], Anchored(model, 1 << 16)
    one, other = Predictor(workers).images(model, views, (), at)
    assert one.noise_per_mm2 is not None
    np.testing.assert_array_equal(one.noise_per_mm2, other.noise_per_mm2)
    larger = [view(SINGLE), view(FOUR), view(twin)]
    assert list(images_module._groups(larger, images_module.MOST_VALUES // (2 * 144), at)) == [[0, 2], [1]]
    sized = [view(SINGLE), view(twin, size=14)]
    for asked in (model, apart):  # a fit may have freed what the anchor, whose histories they are, has not
        bounded = Predictor(workers).images(asked, sized, (), at)  # of two requests: other functions
        noise = [one.noise_per_mm2 for one in bounded if one.noise_per_mm2 is not None]
        assert not np.any(noise[1][: len(noise[0])])
    alone = Predictor(workers).images(apart, views, (), Anchored(apart, 1 << 16))  # seen by a run of its own
    assert np.any(alone[0].irradiance_per_mm2 != alone[1].irradiance_per_mm2)


def test_more_shots_than_a_request_holds_are_split(
    workers: Workers, model: Model, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Images and moved models, by count and by pixels: the same as in one request, to the last bit."""
    predictor = Predictor(workers)
    views, paths = [view(size=size) for size in (8, 9, 8, 8)], ("environment.flux_per_chip_w", RECEIVER)
    monkeypatch.setattr(images_module, "DIFFERENCE_EXITS", 1 << 15)
    whole = predictor.images(model, views, paths)
    for name, least in (("MOST_SHOTS", 2), ("MOST_VALUES", 100)):
        monkeypatch.setattr(images_module, name, least)
        workers.asked.clear()
        parts = predictor.images(model, views, paths)
        assert max(len(request.shots) for request in workers.of_kind("ray")) <= 2
        for one, other in zip(whole, parts, strict=True):
            np.testing.assert_array_equal(one.irradiance_per_mm2, other.irradiance_per_mm2)
            for path in paths:
                np.testing.assert_array_equal(one.jacobian_per_mm2[path], other.jacobian_per_mm2[path])


def test_an_anchored_image_is_monte_carlo_there(workers: Workers, model: Model) -> None:
    """At the anchor twin and twin cancel; beside it error and noise are the same share of the light."""
    predictor, views = Predictor(workers), [view(), view(FOUR)]
    at = Anchored(model, histories=1 << 17, seed=3)
    beside = model.with_value(RECEIVER, 0.30)
    here, there = (predictor.images(one, views, (), at) for one in (model, beside))
    twin_here, twin_there = (predictor.images(one, views) for one in (model, beside))
    assert here[0].noise_per_mm2 is not None
    assert here[0].noise_per_mm2.shape[1:] == (12, 12)
    for a, b, twin_a, twin_b in zip(here, there, twin_here, twin_there, strict=True):
        error = np.sqrt((a.noise_per_mm2**2).sum(axis=0))
        assert 0.0 < error.mean() < 0.1 * a.irradiance_per_mm2.mean()
        assert np.abs(a.irradiance_per_mm2 - twin_a.irradiance_per_mm2).mean() < 4.0 * error.mean()
        share = twin_b.irradiance_per_mm2.sum() / twin_a.irradiance_per_mm2.sum()
        np.testing.assert_allclose(b.noise_per_mm2, share * a.noise_per_mm2, rtol=1e-5)
        errors = [one.irradiance_per_mm2 - twin.irradiance_per_mm2 for one, twin in ((a, twin_a), (b, twin_b))]
        np.testing.assert_allclose(errors[1], share * errors[0], atol=1e-9 * a.irradiance_per_mm2.max())


def test_noise_of_one_run_that_two_requests_tell_is_bounded(workers: Workers, model: Model) -> None:
    """Images of one sample in two sizes: each has twice its own variance and no function of the other's."""
    predictor, views = Predictor(workers), [view(), view(FOUR), view(size=16), view()]
    at = Anchored(model, histories=1 << 17, seed=3)
    together = [one.noise_per_mm2 for one in predictor.images(model, views, (), at)]
    alone = [one.noise_per_mm2 for one in predictor.images(model, [views[0], views[1], views[3]], (), at)]
    (large,) = (one.noise_per_mm2 for one in predictor.images(model, [views[2]], (), at))
    np.testing.assert_array_equal(together[1], alone[1])  # seen in one size only
    for place, own in ((0, alone[0]), (3, alone[2])):
        np.testing.assert_array_equal(together[place], np.sqrt(2.0) * own)
    count = len(alone[0])
    assert not together[2][:count].any()
    np.testing.assert_array_equal(together[2][count:], np.sqrt(2.0) * large)


def test_noise_that_data_have_of_their_own_is_told_beside_an_anchors(workers: Workers, model: Model) -> None:
    """Of the samples that it is known of; the twin alone has none to add it to."""
    of_data = np.full((2, 12, 12), 0.5)
    plain, views = Predictor(workers), [view(), view(FOUR)]
    knowing = plain.knowing({SINGLE.id: of_data})
    at = Anchored(model, histories=1 << 17, seed=3)
    (own, same), (both, other) = (predictor.images(model, views, (), at) for predictor in (plain, knowing))
    assert own.noise_per_mm2 is not None
    np.testing.assert_array_equal(both.noise_per_mm2, np.concatenate([own.noise_per_mm2, of_data]))
    np.testing.assert_array_equal(other.noise_per_mm2, same.noise_per_mm2)
    assert all(one.noise_per_mm2 is None for one in knowing.images(model, views))


def test_an_anchor_is_seen_from_its_own_poses(workers: Workers, model: Model) -> None:
    """None are given: unmoved cameras, whatever the views'; as many as views, or it is refused."""
    predictor, pose = Predictor(workers), Pose((0.3, 0.0), 1.0)
    for poses, expected in (((), Pose()), ((pose,), pose)):
        workers.asked.clear()
        predictor.images(model, [view(pose=pose)], (), Anchored(model, 1, poses=poses))
        camera = workers.of_kind("ray")[0].anchor.shots[0].camera
        assert (camera.shift_px, camera.rotation_deg) == (expected.shift_px, expected.rotation_deg)
    with pytest.raises(InputError, match=r"anchor\.poses"):
        predictor.images(model, [view()], (), Anchored(model, 1, poses=(pose, pose)))


def test_monte_carlo_images_have_random_numbers_of_their_own(workers: Workers, model: Model) -> None:
    """Two views of one sample differ by noise, the same seed repeats both, and both are near the twin."""
    predictor, views, heard = Predictor(workers), [view(), view()], []
    one, other = predictor.monte_carlo(model, views, 1 << 17, 5, lambda done, of: heard.append((done, of)))
    again = predictor.monte_carlo(model, views, 1 << 17, 5)
    assert heard == [(1, 2), (2, 2)]
    np.testing.assert_array_equal(one.irradiance_per_mm2, again[0].irradiance_per_mm2)
    assert np.abs(one.irradiance_per_mm2 - other.irradiance_per_mm2).max() > 0.0
    twin = predictor.images(model, views[:1])[0].irradiance_per_mm2
    np.testing.assert_allclose(one.irradiance_per_mm2, twin, atol=0.05 * twin.max())


BAD = [
    ("environment.substrate.reflectanse", "path"),
    ("environment.emission", "path"),
    ("name", "path"),
]


@pytest.mark.parametrize(("path", "field"), BAD)
def test_a_path_that_is_no_number_is_refused(workers: Workers, model: Model, path: str, field: str) -> None:
    """Misspelt, a word, not of the physics."""
    with pytest.raises(InputError) as caught:
        Predictor(workers).images(model, [view()], (path,))
    assert caught.value.field == field


def test_a_width_that_a_surface_does_not_have_fails(workers: Workers) -> None:
    """A Lambertian substrate has no sigma; the worker says so."""
    clear = find_model("clear_chip")
    surface = {"scatter": "lambertian", "sigma_deg": None, "reflectance": 0.9}
    dull = Model.model_validate(
        clear.model_dump() | {"environment": clear.environment.model_dump() | {"substrate": surface}}
    )
    with pytest.raises(RemoteError) as caught:
        Predictor(workers).images(dull, [view()], (SIGMA,))
    assert caught.value.failure.field == "shots.0.substrate"


def test_derivatives_by_other_exits_differ_by_their_noise(workers: Workers, model: Model) -> None:
    """Another exit seed walks other exits: the derivative is the same but for noise, no Monte Carlo is run again."""
    predictor, at = Predictor(workers), Anchored(model, 0)
    one, other = (predictor.images(model, [view()], (RECEIVER,), replace(at, exit_seed=seed))[0] for seed in (1, 2))
    assert {request.exit_seed for request in workers.of_kind("ray")} == {"1", "2"}
    by, again = (found.jacobian_per_mm2[RECEIVER] for found in (one, other))
    assert 0.0 < np.linalg.norm(by - again) < 0.2 * np.linalg.norm(by)


def test_a_long_answer_tells_how_far_it_is(model: Model) -> None:
    """What a client hears while it waits goes to whom the predictor was told."""
    heard: list[tuple[float, str]] = []

    class Slow:
        """Says once how far it is, then nothing more."""

        def map(self, _requests: Any, **options: Any) -> Any:
            options["on_pending"](Pending(task_id="0" * 64, state="running", progress_ratio=0.25, note="Monte Carlo"))
            return [(0, RemoteError(Failure(code="crashed", message="the end", mend="none")))]

    with pytest.raises(RemoteError):
        Predictor(Slow()).telling(lambda *said: heard.append(said)).images(model, [view()])  # type: ignore[arg-type]
    assert heard == [(0.25, "Monte Carlo")]
