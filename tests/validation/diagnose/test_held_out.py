"""Errors in what was left out, in the unit of what is told."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.validation.analytic import ARRAY, HALO, MODEL, PATHS, SINGLE, TRUTH, Spots, blank, measured
from tests.validation.diagnose.made_up import THIRD, images_of, noise_percent
from tests.validation.lines import SIGMA, fit_of_lines, noisy
from validation.diagnose.held_out import (
    BLOCK_PX,
    Change,
    HeldOut,
    change,
    folds_by_blocks,
    folds_by_sample,
    folds_of,
    held_out,
)
from validation.fit import CurveData, Parameter, fit
from validation.measured import MeasuredImage
from validation.prediction import PredictedCurve

Real = NDArray[np.float64]
AXIS = np.linspace(0.0, 1.0, 40)
SIDE = 20


@pytest.mark.parametrize("curves", [0, 3])
def test_spectra_beside_images_do_not_change_the_error_of_the_images(curves: int) -> None:
    """Percent of the images' mean signal: a reflectance is no DN. Without images it is that of the spectra."""
    random = np.random.default_rng(7)
    spectra = [
        CurveData(f"r{number}", 0.5 + 0.01 * random.standard_normal(40), np.full(40, 0.01), axis=AXIS)
        for number in range(curves)
    ]

    def predict(_model: object, asked: object, *_: object) -> list[PredictedCurve]:
        return [PredictedCurve(np.full(40, 0.5), {}) for _ in spectra]

    found = fit(MODEL, images_of(TRUTH, 3), Spots(), free=PATHS, curves=spectra, predict_curves=predict)  # type: ignore[arg-type]  # it predicts what is asked for
    left = held_out(found, folds_by_sample(found))
    (alone,) = [held_out(one, folds_by_sample(one)) for one in [fit(MODEL, images_of(TRUTH, 3), Spots(), free=PATHS)]]
    assert left.rms_percent == pytest.approx(alone.rms_percent, rel=1e-6)
    if curves:
        only = fit(TRUTH, [], Spots(), free=(), curves=spectra, predict_curves=predict)  # type: ignore[arg-type]  # likewise
        assert held_out(only, folds_by_sample(only)).rms_percent == pytest.approx(2.0, rel=0.2)


@pytest.mark.parametrize("prior_sd", [1e-3, 0.05, np.inf])
def test_a_fold_weighs_its_prior_against_what_is_left_to_see(prior_sd: float) -> None:
    """One sample hardly sees the parameter: without the other it is the weighted mean of prior and data."""
    random = np.random.default_rng(1)
    loud, faint = 1.0 + AXIS, 0.02 * (1.0 - AXIS**2)
    values = {"loud": noisy(random, 2.0 * loud), "faint": noisy(random, 2.0 * faint)}
    found = fit_of_lines(
        {"loud": {"t": loud}, "faint": {"t": faint}}, values, [Parameter("t", prior_mean=1.9, prior_sd=prior_sd)]
    )
    expected = {}
    for name, kept, shape in (("loud", "faint", faint), ("faint", "loud", loud)):
        by_data, by_prior = shape @ shape / SIGMA**2, 1.0 / prior_sd**2
        t = (shape @ values[kept] / SIGMA**2 + 1.9 * by_prior) / (by_data + by_prior)
        expected[name] = (values[name] - t * (loud if name == "loud" else faint)) / SIGMA
    left = held_out(found, folds_by_sample(found))
    np.testing.assert_allclose(left.residual, np.concatenate([expected["loud"], expected["faint"]]), atol=1e-6)
    assert left.density == pytest.approx(-0.5 * np.mean(left.residual**2), rel=1e-12)


def test_a_parameter_at_its_limit_stays_there_in_every_fold() -> None:
    """What the fit may not move a fold may not either: one sample alone would have it beyond."""
    random = np.random.default_rng(2)
    shape = 1.0 + AXIS
    values = {"one": noisy(random, 2.0 * shape), "other": noisy(random, 2.0 * shape)}
    found = fit_of_lines({name: {"t": shape} for name in values}, values, [Parameter("t", 0.0, 1.5)])
    assert found.at_limit == ("t",)
    left = held_out(found, folds_by_sample(found))
    np.testing.assert_allclose(left.residual * SIGMA, np.concatenate([*values.values()]) - 1.5 * np.tile(shape, 2))


def test_what_one_sample_alone_sees_is_fitted_where_it_is_left_out() -> None:
    """No other tells of it: what is left there is what a line leaves, and its noise, not its whole size."""
    random = np.random.default_rng(3)
    own, shared = np.cos(9.0 * AXIS), 1.0 + AXIS
    values = {"one": noisy(random, 2.0 * shared + 5.0 * own), "other": noisy(random, 2.0 * shared)}
    shapes = {"one": {"t": shared, "own": own}, "other": {"t": shared}}
    found = fit_of_lines(shapes, values, [Parameter("t"), Parameter("own")])
    left = held_out(found, folds_by_sample(found)).residual[: len(AXIS)] * SIGMA
    rest = values["one"] - shared * (shared @ values["other"]) / (shared @ shared)
    np.testing.assert_allclose(left, rest - own * (own @ rest) / (own @ own), atol=1e-6)


@pytest.mark.parametrize("prior_sd", [1e-6, 0.1, np.inf])
def test_what_is_fitted_where_it_is_left_out_has_its_prior(prior_sd: float) -> None:
    """Members of a group are drawn back to off in data left out, too: else noise would be taken for a lower error."""
    random = np.random.default_rng(8)
    own, shared = np.cos(9.0 * AXIS), 1.0 + AXIS
    values = {"one": noisy(random, 2.0 * shared + 0.3 * own), "other": noisy(random, 2.0 * shared)}
    shapes = {"one": {"t": shared, "own": own}, "other": {"t": shared}}
    priors = [Parameter("t"), Parameter("own", prior_mean=0.0, prior_sd=prior_sd)]
    left = held_out(found := fit_of_lines(shapes, values, priors), folds_by_sample(found)).residual[: len(AXIS)]
    rest = values["one"] - shared * (shared @ values["other"]) / (shared @ shared)
    size = (own @ rest / SIGMA**2) / (own @ own / SIGMA**2 + 1.0 / prior_sd**2)
    np.testing.assert_allclose(left * SIGMA, rest - size * own, atol=1e-6)


def test_gain_and_offset_of_a_left_out_image_are_its_own() -> None:
    """One image is a fifth brighter than its exposure says: left out, its error stays that of noise."""
    blanks = [blank(f"shot-{one.id}", one, SIDE) for one in (SINGLE, ARRAY, THIRD)]
    images = []
    for image, brighter in zip(measured(TRUTH, blanks, np.random.default_rng(4)), (1.0, 1.0, 1.2), strict=True):
        camera = image.camera.model_copy(update={"gain_mode": "exposure"})
        images.append(replace(image, camera=camera, signal_dn=brighter * image.signal_dn))
    found = fit(TRUTH, images, Spots(), free=())
    left = held_out(found, folds_by_sample(found))
    assert left.rms_percent == pytest.approx(noise_percent(found), rel=0.1)
    of_the_brighter = left.residual[-(SIDE**2) :]
    assert np.mean(of_the_brighter**2) < 1.5  # its noise is larger by a fifth, too


def test_a_fixed_pattern_counts_as_each_images_own_noise() -> None:
    """What is left is the rms of camera noise and pattern over the mean signal."""
    images = measured(TRUTH, [blank("one", SINGLE, SIDE, prnu=0.02)], np.random.default_rng(5))
    found = fit(TRUTH, images, Spots(), free=())
    left = held_out(found, folds_by_blocks(found))
    (signal,) = found.signals_dn
    variance = 36.0 + signal + (0.02 * signal) ** 2
    assert left.rms_percent == pytest.approx(100.0 * np.sqrt(np.mean(variance)) / np.mean(signal), rel=0.15)


def test_what_a_right_model_gains_scatters_as_is_said() -> None:
    """2,000 draws of noise y beside y + d: the gain is d^2 / 2 a value on average, its error |d|."""
    random = np.random.default_rng(6)
    d = 0.3 * random.standard_normal(80)

    def of(residual: Real) -> HeldOut:
        return HeldOut(residual, np.arange(80), 1.0)

    drawn = [change(of(y + d), of(y)) for y in random.standard_normal((2000, 80))]
    values = np.array([one.value for one in drawn])
    assert np.mean(values) == pytest.approx(d @ d / 160.0, rel=0.1)
    assert np.std(values) == pytest.approx(drawn[0].error, rel=0.05)
    back = change(of(np.zeros(80)), of(d))
    assert back.value == pytest.approx(-(d @ d) / 160.0)
    assert not back.falls
    with pytest.raises(ValueError, match="same folds"):
        change(of(d), replace(of(d), rows=np.arange(1, 81)))


@pytest.mark.parametrize(("share", "size"), [(0.3, 0.0), (0.3, 5.0), (0.5, 5.0)])
def test_the_noise_of_two_runs_of_monte_carlo_is_in_the_error(share: float, size: float) -> None:
    """Two models that differ by d of this size and about anchors of their own: the gain is that of d alone."""
    random, rows = np.random.default_rng(9), np.arange(2000)
    d = random.standard_normal(2000)
    d *= size / np.linalg.norm(d)
    drawn = [
        change(HeldOut(y + d + share * one, rows, 1.0), HeldOut(y + share * other, rows, 1.0))
        for y, one, other in random.standard_normal((1000, 3, 2000))
    ]
    values, told = np.array([one.value for one in drawn]), np.array([one.error for one in drawn])
    assert np.mean(values) == pytest.approx(size**2 / 4000.0, abs=4.0 * np.mean(told) / np.sqrt(1000.0))
    assert np.std(values) == pytest.approx(np.mean(told), rel=0.1)
    assert size or np.mean([one.falls for one in drawn]) < 0.05


def test_an_error_falls_where_it_falls_by_two_of_its_own() -> None:
    """Less is noise, and a rise is none."""
    assert [Change(value, 1.0).falls for value in (-3.0, 1.9, 2.1)] == [False, False, True]


@pytest.mark.parametrize("scope", ["global", "per_sample"])
def test_every_row_is_left_out_once(scope: str) -> None:
    """Samples in turn; for what each sample has its own of, halves: blocks of 16 pixels, side by side."""
    images = images_of(TRUTH, 3)
    found = fit(TRUTH, [*images, second(images[0])], Spots(), free=())
    folds = folds_of(found, scope)  # type: ignore[arg-type]  # one of two words
    rows = np.concatenate([part for _, part in folds])
    assert sorted(rows) == list(range(len(found.residual)))
    assert len({len(part) for _, part in folds}) == 2
    names = [name for name, _ in folds]
    assert names == (["single", "array", "third"] if scope == "global" else ["even blocks", "odd blocks"])
    if scope == "global":
        assert set(folds[0][1]) == {*range(1600), *range(4800, 6400)}
        return
    even = np.isin(np.arange(1600), folds[0][1]).reshape(40, 40)
    assert even[:BLOCK_PX, :BLOCK_PX].all()
    assert not even[:BLOCK_PX, BLOCK_PX : 2 * BLOCK_PX].any()
    assert not even[BLOCK_PX : 2 * BLOCK_PX, :BLOCK_PX].any()


def test_images_of_one_sample_have_no_folds() -> None:
    """Nothing is left to fit it by; a held-out error without folds is refused."""
    images = images_of(TRUTH, 3)[:1]
    found = fit(MODEL, [*images, second(images[0])], Spots(), free=(HALO,))
    assert folds_of(found) == []
    with pytest.raises(ValueError, match="without folds"):
        held_out(found, [])


def test_a_short_curve_is_halved() -> None:
    """Five values: three and two."""
    found = fit_of_lines({"a": {"t": np.ones(5)}}, {"a": np.arange(5.0)}, [Parameter("t")])
    assert [part.tolist() for _, part in folds_by_blocks(found)] == [[0, 1, 2], [3, 4]]


def second(image: MeasuredImage) -> MeasuredImage:
    """Another shot of the same."""
    return replace(image, shot=image.shot.model_copy(update={"id": "again"}))
