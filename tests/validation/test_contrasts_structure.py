"""Structure that is put in is found, and found where it was put; nothing is found where only noise is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.validation.analytic import ARRAY, HALO, MODEL, REACH, SIGMA, SINGLE, Spots, blank, measured
from validation.contrasts import structure
from validation.contrasts.families import BLOCKS, layout_of
from validation.contrasts.places import Picture, chip_centres_um, from_nearest_um, module_coordinates_um
from validation.contrasts.structure import fit_layout
from validation.dataset.manifest import SpectrumShot
from validation.dataset.spectra import SPECTRUM_COLUMNS, read_spectrum
from validation.fit import CurveData, fit
from validation.prediction import Pose, PredictedCurve

TRUTH = MODEL.with_value(SIGMA, 6.0).with_value(HALO, 0.7).with_value(REACH, 0.5)
DRAWS = 400


def _images(seed=1):
    names = {"single-a": SINGLE, "single-b": SINGLE, "array-a": ARRAY}
    blanks = [blank(name, sample, prnu=0.002) for name, sample in names.items()]
    return measured(TRUTH, blanks, np.random.default_rng(seed))


def _with(images, number, extra_dn):
    changed = replace(images[number], signal_dn=images[number].signal_dn + extra_dn)
    return [*images[:number], changed, *images[number + 1 :]]


def _found(images):
    return structure(fit(TRUTH, images, Spots()), draws=DRAWS)


def _sd(image):
    return np.sqrt(image.variance_dn2(image.signal_dn))


def test_noise_alone_is_no_structure():
    """Without anything hidden p is ordinary, each shot has its own, and z goes with p."""
    found = _found(_images())
    assert found.p > 0.02
    assert set(found.shots) == {"single-a", "single-b", "array-a"}
    assert all(shot.chi2_per_pixel == pytest.approx(1.0, abs=0.2) for shot in found.shots.values())
    assert found.draws == DRAWS
    assert found.chi2 == pytest.approx(found.freedom, rel=0.15)


def test_a_ring_is_found_at_its_distance():
    """A ring 150-200 um from the chip of one image: p is as small as it gets, and the ring is named with its sign."""
    images = _images()
    x_um, y_um = module_coordinates_um(images[1], Pose())
    distance = np.hypot(x_um, y_um)
    found = _found(_with(images, 1, 1.5 * _sd(images[1]) * ((distance >= 150.0) & (distance < 200.0))))
    assert found.p_text == f"< 1/{DRAWS}"
    rings = [region for region in found.where if region.family == "distance from the chip"]
    assert rings[0].place == "150-200 um from the nearest chip, single-b"
    assert rings[0].z > 5.0
    assert found.shots["single-b"].p < 0.01
    assert found.shots["array-a"].p > 0.01
    assert found.families[0].energy > found.families[0].expected


def test_a_block_is_found_in_its_rows_and_columns():
    """A dark patch of 4 x 4 pixels on a block's place is the least likely region of all."""
    images = _images()
    patch = np.zeros((24, 24))
    patch[12:16, 4:8] = -2.5
    found = _found(_with(images, 2, patch * _sd(images[2])))
    assert found.where[0].place == "rows 12-15, columns 4-7, array-a"
    assert found.where[0].family == "blocks of 4"
    assert found.where[0].z < -5.0
    assert found.where[0].chance < 1e-6
    assert found.shots["array-a"].worst == found.where[0]


def test_one_hot_place_has_a_vote():
    """3 x 3 pixels among a thousand: no family stands out, the place alone does, and its image is the one."""
    blanks = [blank(name, sample, 96) for name, sample in {"single-b": SINGLE, "array-a": ARRAY}.items()]
    images = measured(TRUTH, blanks, np.random.default_rng(1))
    spot = np.zeros((96, 96))
    spot[60:63, 20:23] = 3.2
    found = _found(_with(images, 0, spot * _sd(images[0])))
    assert found.families[0].p > 0.01
    assert found.p < 0.01
    assert found.shots["single-b"].p < 0.01
    assert found.shots["array-a"].p > 0.01
    assert found.where[0].shot == "single-b"


def test_a_bad_image_does_not_excuse_another():
    """One image at several times its noise: the ring in another is seen as it was without."""
    images = _images()
    x_um, y_um = module_coordinates_um(images[1], Pose())
    distance = np.hypot(x_um, y_um)
    ringed = _with(images, 1, 1.5 * _sd(images[1]) * ((distance >= 150.0) & (distance < 200.0)))
    noise = np.random.default_rng(3).standard_normal((24, 24))
    both = _found(_with(ringed, 2, 5.0 * noise * _sd(images[2])))
    assert both.variance_scale == pytest.approx(np.exp(0.12))
    assert both.p_text == both.shots["single-b"].p_text == both.shots["array-a"].p_text == f"< 1/{DRAWS}"
    rings = [region for region in both.where if region.family == "distance from the chip"]
    assert any(region.place == "150-200 um from the nearest chip, single-b" for region in rings)


def test_a_plane_is_found_in_opposite_sectors():
    """Light that grows with x: the sectors about +x and -x stand out with opposite signs."""
    images = _images()
    x_um, _ = module_coordinates_um(images[0], Pose())
    found = _found(_with(images, 0, 1.0 * _sd(images[0]) * x_um / np.abs(x_um).max()))
    assert found.p < 0.01
    worst = next(region for region in found.where if region.family == "azimuth" and region.shot == "single-a")
    assert any(word in worst.words for word in ("azimuth 0-", "337.5-", "157.5-", "180-", "22.5-", "135-", "202.5-"))


def test_a_wave_is_found_at_its_frequency():
    """A weak wave over the whole image shows in the band of its frequency, 7.1 periods in 600 um: 12 per mm."""
    images = _images()
    y, x = np.indices((24, 24))
    wave = 1.2 * np.cos(2.0 * np.pi * 5.0 * (x + y) / 24.0)
    found = _found(_with(images, 2, wave * _sd(images[2])))
    assert found.p < 0.01
    assert found.families[0].name == "spatial frequency 9.17-14.2 per mm"
    waves = [region for region in found.where if region.family == "spatial frequency"]
    assert waves[0].shot == "array-a"


def test_bands_of_rows_are_found_in_their_image():
    """Pairs of rows, higher or lower by half a pixel's noise: the rows of that image are named."""
    images = _images()
    bands = np.repeat(0.5 * np.random.default_rng(5).choice([-1.0, 1.0], 12), 2)[:, None]
    found = _found(_with(images, 2, bands * _sd(images[2])))
    assert found.families[0].name == "rows of the camera"
    assert found.p < 0.01
    assert found.shots["array-a"].p < 0.01
    assert found.shots["single-b"].p > 0.01
    rows = [region for region in found.where if region.family == "rows of the camera"]
    assert rows[0].shot == "array-a"
    first, last = (int(number) for number in rows[0].words.removeprefix("rows ").split("-"))
    assert last == first + 1
    assert np.sign(rows[0].z) == bands[first, 0] / 0.5


def test_a_faint_column_of_the_camera_is_found_where_images_are_summed():
    """The same two columns a little brighter in every image: no image alone shows it as all together do."""
    images = _images()
    stripe = np.zeros((24, 24))
    stripe[:, 6:8] = 0.6
    for number in range(3):
        images = _with(images, number, stripe * _sd(images[number]))
    found = _found(images)
    assert found.where[0].family == "columns of the camera, all images"
    assert found.where[0].place == "columns 6-7, all images together"
    assert found.where[0].z > 4.0


def test_a_pattern_in_all_images_is_found_where_they_are_summed():
    """The same weak patch in every image: the summed block is named, in all images together."""
    images = _images()
    patch = np.zeros((24, 24))
    patch[16:24, 0:8] = 0.6
    for number in range(3):
        images = _with(images, number, patch * _sd(images[number]))
    found = _found(images)
    assert found.where[0].place == "rows 16-23, columns 0-7, all images together"
    assert found.where[0].family == "blocks of 8, all images"


def test_a_curve_has_structure_too():
    """A bump in a spectrum is found between its wavelengths."""
    axis = np.linspace(400.0, 500.0, 64)
    value = np.random.default_rng(1).standard_normal(64)
    value[32:40] += 3.0
    curve = CurveData("t", value, np.ones(64), axis=axis, axis_unit="nm")

    def predict(model, curves, paths, others):
        return [PredictedCurve(np.zeros(64), {})]

    found = structure(fit(TRUTH, [], Spots(), free=(), curves=[curve], predict_curves=predict), draws=DRAWS)
    assert found.p < 0.01
    assert found.where[0].place.startswith("450.794-461.905 nm")


def test_the_order_of_rows_in_a_file_decides_nothing(tmp_path):
    """A bend of opposite sign at two angles is as visible in a file with wavelength outermost, or in no order."""
    wave, aoi = (one.ravel() for one in np.meshgrid(np.linspace(400.0, 700.0, 301), [65.0, 75.0]))
    rng = np.random.default_rng(1)
    bend = 0.45 * np.sin(2.0 * np.pi * (wave - 400.0) / 150.0) * np.where(aoi < 70.0, 1.0, -1.0)
    psi = 45.0 + 0.1 * (bend + rng.standard_normal(len(wave)))

    def p_of(order):
        rows = [f"{wave[at]:.0f},{aoi[at]:.0f},,{psi[at]:.6f},0.1" for at in order]
        (tmp_path / "psi.csv").write_text("\n".join([",".join(SPECTRUM_COLUMNS), *rows]))
        table = read_spectrum(
            tmp_path / "psi.csv", SpectrumShot(id="psi", kind="spectrum", film="f", quantity="psi", file="psi.csv")
        )
        curve = CurveData("psi", table.value - 45.0, table.sigma, axis=table.wavelength_nm, axis_unit="nm")
        found = fit(TRUTH, [], Spots(), free=(), curves=[curve], predict_curves=lambda *_: [nothing])
        return structure(found, draws=DRAWS).p

    nothing = PredictedCurve(np.zeros(len(wave)), {})
    found = [p_of(order) for order in (np.arange(602), np.lexsort((aoi, wave)), rng.permutation(602))]
    assert found == [found[0]] * 3
    assert found[0] < 0.01


def test_a_curve_that_the_fit_takes_whole_has_no_place_and_is_no_fault():
    """One value and a scale of its own beside a spectrum: nothing is left of it to look at."""
    axis = np.linspace(400.0, 500.0, 64)
    noise = np.random.default_rng(1).standard_normal(64)
    curves = [
        CurveData("t", noise, np.ones(64), axis=axis, axis_unit="nm"),
        CurveData("one", np.ones(1), np.ones(1), False, True, axis=axis[:1], axis_unit="nm"),
    ]

    def predict(model, curves, paths, others):
        return [PredictedCurve(np.zeros(64), {}), PredictedCurve(np.ones(1), {})]

    found = structure(fit(TRUTH, [], Spots(), free=(), curves=curves, predict_curves=predict), draws=DRAWS)
    assert (found.shots["one"].worst.words, found.shots["one"].worst.z) == ("nowhere", 0.0)
    assert found.p > 0.01


def test_every_used_pixel_is_in_each_partition_once():
    """Blocks, rings and sectors each sum every used pixel of an image exactly once; masked ones nowhere."""
    used = np.random.default_rng(1).uniform(size=(13, 9)) > 0.2
    y, x = np.indices(used.shape) * 25.0
    picture = Picture("a", used, 25.0, x - 100.0, y - 100.0, np.array([[-50.0, 0.0], [50.0, 0.0]]), 0)
    layout = layout_of([picture])
    ones = np.ones((int(used.sum()), 1))
    sums = layout.contrasts(layout.cells @ ones)[:, 0]
    for group in layout.groups:
        assert sums[group.rows].sum() == used.sum(), group.family
    assert {f"blocks of {size}" for size in BLOCKS} < set(layout.families)
    assert "field radius" in layout.families


def test_power_of_all_bands_is_the_power_of_the_map():
    """Parseval: the bands and the mean hold all squares, for even and odd sizes."""
    for shape in ((16, 16), (17, 13)):
        used = np.ones(shape, dtype=bool)
        flat = np.zeros(shape)
        layout = layout_of([Picture("a", used, 25.0, flat, flat, np.zeros((1, 2)), 0)])
        residual = np.random.default_rng(1).standard_normal((used.size, 1))
        cells = layout.cells @ residual
        spectrum = layout.spectra[0]
        total = spectrum.power(cells).sum() + cells.sum() ** 2
        assert total == pytest.approx(spectrum.shape[0] * spectrum.shape[1] * np.sum(cells**2), rel=1e-5)


def test_places_follow_the_pose():
    """A module shifted by (row, column) and turned lies there: the chip's own place is at distance zero."""
    image = replace(blank("a", ARRAY), centre_px=(10.0, 12.0))
    pose = Pose((1.0, -2.0), 90.0)
    x_um, y_um = module_coordinates_um(image, pose)
    assert (x_um[11, 10], y_um[11, 10]) == pytest.approx((0.0, 0.0))
    assert (x_um[15, 10], y_um[15, 10]) == pytest.approx((100.0, 0.0))  # turned x towards y: +x shows along rows
    chips = chip_centres_um(ARRAY, TRUTH.environment)
    assert chips.tolist()[0] == [-300.0, -150.0]
    assert from_nearest_um(chips[:, 0], chips[:, 1], chips).max() == 0.0
    gap = TRUTH.with_value("environment.spacing_is", "gap").environment
    assert chip_centres_um(ARRAY, gap)[0].tolist() == [-340.0, -170.0]


def test_layout_follows_the_fit():
    """The layout of a fit has all of its shots and as many rows as its residual."""
    one = fit(TRUTH, _images(), Spots(), free=())
    layout = fit_layout(one)
    assert layout.shots == ("single-a", "single-b", "array-a")
    assert layout.cells.shape[1] == len(one.residual)
