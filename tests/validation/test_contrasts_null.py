"""The null is what fits of pure noise leave: p-values are uniform after the refit, a wrong noise model is caught."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import ks_2samp, kstest

from tests.validation.analytic import ARRAY, HALO, MODEL, PATHS, REACH, SIGMA, SINGLE, Spots, blank, measured, spots
from validation.contrasts.families import layout_of
from validation.contrasts.null import Null, Standard, Variances, null
from validation.contrasts.places import Picture
from validation.contrasts.structure import counted_p, families_moved, fit_layout, judged, structure
from validation.fit import fit
from validation.fit.least_squares import Parameter, basis, reduce
from validation.fit.whitening import variance_scales
from validation.prediction import Anchored, View

TRUTH = MODEL.with_value(SIGMA, 6.0).with_value(HALO, 0.7).with_value(REACH, 0.5)


def _blanks(prnu, side=24):
    return [blank(name, sample, side, prnu) for name, sample in (("a", SINGLE), ("b", ARRAY), ("c", SINGLE))]


def _fitted(seed, prnu=0.0, side=20, pretended=None, **more):
    images = measured(TRUTH, _blanks(prnu, side), np.random.default_rng(seed))
    if pretended is not None:
        images = [replace(image, prnu=pretended) for image in images]
    return fit(TRUTH, images, Spots(), **more)


@pytest.fixture(scope="module")
def fits():
    """300 fits of noise about one truth, with a fixed pattern in all images."""
    return [_fitted(seed, prnu=0.003) for seed in range(300)]


def test_p_values_are_uniform_after_refit(fits):
    """Kolmogorov and Smirnov find nothing in 300 p-values, of all shots and of one; about 5 % are below 5 %.

    One null serves all fits, so it has enough draws that its own scatter is none of theirs.
    """
    layout, projection = fit_layout(fits[0]), fits[0].basis
    variances = Variances.of(layout, projection)
    drawn = null(layout, projection, variances.weight, 5000)
    found = [judged(one.residual, layout, projection, variances, drawn) for one in fits]
    whole = np.array([one.p for one in found])
    assert kstest(whole, "uniform").pvalue > 0.01
    assert kstest([one.shots["b"].p for one in found], "uniform").pvalue > 0.01
    assert 0.01 <= np.mean(whole <= 0.05) <= 0.09


def test_errors_cover_the_truth(fits):
    """95 % intervals hold the truth in 92 to 97.5 % of the draws, three parameters each."""
    inside = [abs(one.value(path) - TRUTH.leaves()[path]) < 1.96 * one.error(path) for one in fits for path in PATHS]
    assert 0.92 < np.mean(inside) < 0.975


def test_fixed_pattern_taken_for_independent_noise_is_a_false_alarm():
    """The mutant: the same pattern in all images, but the fit is told there is none; most p-values are tiny."""
    told = [structure(_fitted(seed, 0.015), draws=500).p for seed in range(6)]
    not_told = [structure(_fitted(seed, 0.015, pretended=0.0), draws=500) for seed in range(6)]
    assert min(told) > 0.005
    assert np.median([one.p for one in not_told]) < 0.01
    assert "all images" in not_told[0].families[0].name


def test_variances_are_those_of_projected_noise():
    """The exact variance of every contrast is that of noise sent through the fit, priors included."""
    one = _fitted(1, side=12)
    layout, random = fit_layout(one), np.random.default_rng(2)
    basis = one.basis
    y = random.standard_normal((len(basis.data), 4000))
    u = random.standard_normal((len(basis.prior), 4000))
    left = y - basis.data @ (basis.data.T @ y + basis.prior.T @ u)
    drawn = layout.contrasts(layout.cells @ left).var(axis=1)
    variances = Variances.of(layout, basis).variance
    kept = variances > 0.01
    np.testing.assert_allclose(drawn[kept] / variances[kept], 1.0, atol=0.15)


def test_drawing_cells_is_drawing_pixels():
    """Energies drawn by cells have the mean and the spread of those of residuals drawn pixel by pixel."""
    one = _fitted(1, side=12)
    layout, projection = fit_layout(one), one.basis
    weight = Variances.of(layout, projection).weight
    drawn = null(layout, projection, weight, 4000, seed=3)
    random = np.random.default_rng(4)
    y = random.standard_normal((len(projection.data), 4000)) * np.exp(0.015 * random.standard_normal(4000))
    u = random.standard_normal((len(projection.prior), 4000))
    left = y - projection.data @ (projection.data.T @ y + projection.prior.T @ u)
    scale = variance_scales((left**2).sum(axis=0), projection.freedom)
    energies = layout.energies(layout.cells @ left, weight) / scale
    slow = drawn.of_families.z(layout.family_sums @ energies).max(axis=0)
    assert ks_2samp(slow, drawn.of_families.z(layout.family_sums @ drawn.energies).max(axis=0)).pvalue > 0.01
    peaks = layout.energies_and_peaks(layout.cells @ left, weight)[1] / scale
    assert min(ks_2samp(a, b).pvalue for a, b in zip(peaks, drawn.peaks, strict=True)) > 1e-4
    assert min(ks_2samp(a, b).pvalue for a, b in zip(energies, drawn.energies, strict=True)) > 1e-4
    both = np.maximum(slow, drawn.peak_z(peaks).max(axis=0))
    assert ks_2samp(both, drawn.largest).pvalue > 0.01


def test_peaks_are_nearly_normal_equivalents():
    """Of contrasts as many as counted, the peak's z is hardly above a normal one; the largest peaks stay finite."""
    one = _fitted(1, side=24)
    layout, projection = fit_layout(one), one.basis
    drawn = null(layout, projection, Variances.of(layout, projection).weight, 4000, seed=3)
    z = drawn.peak_z(drawn.peaks)
    assert 0.3 < np.mean(z > 1.645) / 0.05 < 1.3  # blocks hold one another: they count for fewer
    assert np.all(np.isfinite(drawn.peak_z(np.full(drawn.peaks.shape, 1e6, np.float32))))


def test_same_seed_same_null_and_another_seed_another():
    """A null is made by its seed alone, kept in memory and in a folder."""
    one = _fitted(1, side=12)
    layout, projection = fit_layout(one), one.basis
    weight = Variances.of(layout, projection).weight
    first, again = (null(layout, projection, weight, 50, seed=s).energies for s in (5, 5))
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, null(layout, projection, weight, 50, seed=6).energies)


def test_a_null_is_read_back_from_its_folder(tmp_path, monkeypatch):
    """What was drawn is written once; a later process reads it, bit for bit."""
    one = _fitted(2, side=12)
    layout, projection = fit_layout(one), one.basis
    weight = Variances.of(layout, projection).weight
    monkeypatch.setattr("validation.contrasts.null._REMEMBERED", {})
    first = null(layout, projection, weight, 40, cache=tmp_path).energies
    monkeypatch.setattr("validation.contrasts.null._REMEMBERED", {})
    monkeypatch.setattr("validation.contrasts.null._draw", lambda *_: pytest.fail("drawn again"))
    np.testing.assert_array_equal(null(layout, projection, weight, 40, cache=tmp_path).energies, first)
    assert [file.suffix for file in tmp_path.iterdir()] == [".npy"]


@pytest.mark.parametrize("damage", ["empty", "cut", "other", "no folder"])
def test_a_damaged_null_is_drawn_again(tmp_path, monkeypatch, damage):
    """What a power cut left, what is of another layout, and a folder that is a file: none ends a diagnosis."""
    one = _fitted(2, side=12)
    layout, projection = fit_layout(one), one.basis
    weight = Variances.of(layout, projection).weight
    cache = tmp_path / "nulls"
    monkeypatch.setattr("validation.contrasts.null._REMEMBERED", {})
    first = null(layout, projection, weight, 40, cache=cache).energies
    (file,) = cache.iterdir()
    whole = file.read_bytes()
    if damage == "other":
        np.save(file, np.zeros((2, 40), np.float32))
    elif damage == "no folder":
        file.unlink()
        cache.rmdir()
        cache.write_text("not a folder")
    else:
        file.write_bytes(b"" if damage == "empty" else whole[:-100])
    monkeypatch.setattr("validation.contrasts.null._REMEMBERED", {})
    np.testing.assert_array_equal(null(layout, projection, weight, 40, cache=cache).energies, first)
    assert damage == "no folder" or file.read_bytes() == whole


def test_old_nulls_go(tmp_path, monkeypatch):
    """A fit that is not made again never asks for its own."""
    monkeypatch.setattr("validation.contrasts.null._MOST_KEPT", 3)
    one = _fitted(2, side=12)
    layout, projection = fit_layout(one), one.basis
    weight = Variances.of(layout, projection).weight
    for seed in range(1, 6):
        null(layout, projection, weight, 20, seed=seed, cache=tmp_path)
    assert len(list(tmp_path.iterdir())) == 3


def test_p_counts_itself():
    """p = (1 + b)/(1 + B); none as large is printed as such."""
    assert counted_p(np.array([1.0, 2.0, 3.0]), 2.5) == (0.5, "0.5")
    assert counted_p(np.arange(99.0), 1000.0) == (0.01, "< 1/99")


def test_standardised_energies_are_nearly_normal():
    """Wilson and Hilferty bring chi2 of few and of many degrees of freedom to one scale."""
    random = np.random.default_rng(1)
    energies = np.array([random.chisquare(4, 20_000), 3.0 * random.chisquare(500, 20_000)])
    z = Standard.of(energies).z(energies)
    np.testing.assert_allclose(z.mean(axis=1), 0.0, atol=0.03)
    np.testing.assert_allclose(np.quantile(z, 0.99, axis=1), 2.326, atol=0.1)


def test_noise_of_the_monte_carlo_is_no_structure():
    """An error drawn from the groups' covariance is no alarm where the groups are known, else it is one."""
    view = View(ARRAY, 24, 24, 25.0, (11.5, 11.5))
    columns, rows = np.indices((24, 24))
    light = spots(TRUTH, view)[0]
    groups = np.array([0.02 * light * np.cos(0.35 * k * columns) * np.cos(0.2 * k * rows) for k in range(3, 11)])
    known, unknown = [], []
    for seed in range(12):
        random = np.random.default_rng(seed)
        images = measured(TRUTH, _blanks(0.0), random)
        hit = images[1].signal_dn + 300.0 * np.tensordot(random.standard_normal(8), groups, 1)
        images[1] = replace(images[1], signal_dn=hit)
        for p_values, noise in ((known, {"array": groups}), (unknown, {})):
            one = fit(TRUTH, images, Spots(noise), anchor_at=lambda model: Anchored(model, 1000))
            p_values.append(structure(one, draws=300).p)
    assert np.median(unknown) < 0.01
    assert kstest(known, "uniform").pvalue > 0.01


def test_a_known_error_is_weighed_against_each_family():
    """What the fit takes up moves no family; a bump moves blocks by the square of its size."""
    one = _fitted(1)
    layout, projection = fit_layout(one), one.basis
    weight = Variances.of(layout, projection).weight
    drawn: Null = null(layout, projection, weight, 300)
    absorbed = families_moved(layout, projection, drawn, weight, one.columns[0])
    assert max(absorbed.values()) < 1e-6 * np.sum(one.columns[0] ** 2)
    bump = np.zeros(len(one.residual))
    bump[20 * 5 + 3 : 20 * 5 + 7] = 1.0
    once, twice = (families_moved(layout, projection, drawn, weight, k * bump)["blocks of 4"] for k in (1.0, 2.0))
    assert twice == pytest.approx(4.0 * once, rel=1e-6)
    assert once > 0.01


def test_errors_of_priors_are_in_the_null():
    """A fit that its prior holds: parameters drawn from it and fitted again leave as much as the null says.

    Without them half of the energy of the block that the parameter fills would be called too much.
    """
    side, draws, sd = 16, 4000, 1.0 / 16.0
    y_um, x_um = np.indices((side, side)) * 25.0
    layout = layout_of([Picture("a", np.ones((side, side), bool), 25.0, x_um, y_um, np.zeros((1, 2)), 0)])
    column, random = np.ones(side**2), np.random.default_rng(5)
    reduced = reduce(column[None], 0.0 * column, (Parameter("level", prior_sd=sd),), np.zeros(1))
    taken = basis(column[None], reduced, np.ones(1, bool))
    assert taken.freedom == pytest.approx(side**2 - 0.5)
    weight = Variances.of(layout, taken).weight
    data = sd * random.standard_normal(draws) * column[:, None] + random.standard_normal((side**2, draws))
    left = data - column[:, None] * (column @ data) / (side**2 + 1.0 / sd**2)
    expected = layout.energies(layout.cells @ left, weight).mean(axis=1)
    found = null(layout, taken, weight, draws, seed=3).energies.mean(axis=1)
    np.testing.assert_allclose(found, expected, rtol=0.1)
    whole = layout.members.index(("blocks of 16", "a"))
    assert found[whole] == pytest.approx(1.0, abs=0.1)
