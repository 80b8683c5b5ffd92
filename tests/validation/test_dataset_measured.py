"""What a fit gets of a data set: dark, flat, mask, binning and noise, held against simulation and closed forms."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from luxloop.errors import InputError
from tests.validation.datasets import (
    BLACK_DN,
    FAR_FIELD,
    GAIN,
    PEAK_DN,
    PIXELS,
    READ_NOISE_E,
    SPECTRUM,
    edit,
    light,
    photographed,
    put,
)
from tests.validation.datasets import write_dataset as whole_dataset
from validation.dataset.folder import read_dataset
from validation.measured import MeasuredImage, binning, measured_far_fields, measured_images, measured_spectra

BIN_UM = 48.0
"""Two camera pixels."""

WAFER = Path(__file__).parents[2] / "examples" / "wafer"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A data set: one shot with dark, flat and mask, one without."""
    return whole_dataset(tmp_path)


def images(folder: Path, compare_pixel_um: float | None = None) -> dict[str, MeasuredImage]:
    """The images by their shot."""
    return {image.shot.id: image for image in measured_images(read_dataset(folder), compare_pixel_um)}


def test_without_dark_and_flat_the_black_level_is_subtracted(folder: Path) -> None:
    """The mean over each bin of what the camera wrote, less 64 DN."""
    import tifffile

    raw = tifffile.imread(folder / "images/array.tif").astype(float)
    bins = raw.reshape(48, 2, 48, 2).mean(axis=(1, 3)) - BLACK_DN
    image = images(folder, BIN_UM)["array"]
    np.testing.assert_allclose(image.signal_dn, bins, rtol=1e-12)
    assert (image.binning, image.pixel_um, image.centre_px) == (2, 48.0, (23.5, 23.5))
    assert image.used.all()


def test_a_mean_that_was_rounded_to_whole_numbers_has_that_noise_too(folder: Path) -> None:
    """Frames round each by itself, a mean in whole DN once more; one with fractions does not."""
    import tifffile

    edit(folder, "exposure_ms = 4.0", "exposure_ms = 4.0\nframes_averaged = 64")
    of_frames = ((GAIN * READ_NOISE_E) ** 2 + 1.0 / 12.0) / 64.0
    whole = images(folder, BIN_UM)["array"].constant_dn2
    put(folder, "images/array.tif", tifffile.imread(folder / "images/array.tif").astype(np.float32))
    fractions = images(folder, BIN_UM)["array"].constant_dn2
    np.testing.assert_allclose(whole, (of_frames + 1.0 / 12.0) / 4.0)
    np.testing.assert_allclose(fractions, of_frames / 4.0)


def test_more_bins_than_a_record_holds_are_refused_before_anything_is_fitted(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With the size of bin that would do."""
    monkeypatch.setattr("validation.measured.MOST_BINS", 1000)
    with pytest.raises(InputError, match=r"48 x 48 bins of 48 um.*at most 1,000 bins.*--pixel-um 96"):
        images(folder, BIN_UM)
    assert images(folder, 96.0)["array"].signal_dn.size <= 1000


def test_a_dark_replaces_the_black_level_and_a_flat_of_mean_one_divides(folder: Path) -> None:
    """(raw - dark) / (flat / mean of flat), the mean over the unmasked field."""
    rng = np.random.default_rng(5)
    raw, dark = (rng.uniform(low, low + 300.0, (PIXELS, PIXELS)).astype(np.float32) for low in (900.0, 60.0))
    flat = rng.uniform(500.0, 1500.0, (PIXELS, PIXELS)).astype(np.float32)
    mask = np.ones((PIXELS, PIXELS), np.uint8)
    mask[:, :30], flat[:, :30] = 0, 0.0
    for name, values in (("images/single", raw), ("dark/dark", dark), ("flat/flat", flat), ("masks/mask", mask)):
        put(folder, f"{name}.tif", values)
    image = images(folder, 24.0)["single"]
    expected = (raw - dark)[:, 30:] / (flat[:, 30:] / flat[:, 30:].mean(dtype=float))
    np.testing.assert_allclose(image.signal_dn[:, 30:], expected, rtol=2e-5)
    assert np.array_equal(image.used, mask > 0)
    assert image.masked == 30 * PIXELS
    assert np.isfinite(image.signal_dn).all()


def drawn(flat: np.ndarray, frames: int, dark_frames: int, signal_dn: float, seed: int) -> tuple[np.ndarray, ...]:
    """An image and its dark as float32: a flat signal through a flat field, frames averaged, no rounding."""
    rng = np.random.default_rng(seed)
    images = []
    for mean, count in ((signal_dn * flat, frames), (0.0 * flat, dark_frames)):
        read_e = rng.normal(0.0, READ_NOISE_E / np.sqrt(count), flat.shape)
        electrons = rng.poisson(mean / GAIN * count) / count + read_e
        rounding = rng.uniform(-0.5, 0.5, flat.shape) / np.sqrt(count)
        images.append((BLACK_DN + GAIN * electrons + rounding).astype(np.float32))
    return tuple(images)


@pytest.mark.parametrize("signal_dn", [0.0, 800.0])
def test_the_stated_variance_is_that_of_simulated_frames(folder: Path, signal_dn: float) -> None:
    """Photons, read noise, rounding, frames, the dark's own frames, a flat, binning: all in, to 3 %."""
    flat = np.linspace(0.5, 1.5, PIXELS)[None, :] * np.ones((PIXELS, 1))
    put(folder, "flat/flat.tif", flat.astype(np.float32))
    put(folder, "masks/mask.tif", np.ones((PIXELS, PIXELS), np.uint8))
    edit(folder, "exposure_ms = 8.0", "exposure_ms = 8.0\nframes_averaged = 4\ndark_frames_averaged = 2")
    signals = []
    for seed in range(20):
        raw, dark = drawn(flat, 4, 2, signal_dn, seed)
        put(folder, "images/single.tif", raw)
        put(folder, "dark/dark.tif", dark)
        image = images(folder, BIN_UM)["single"]
        signals.append(image.signal_dn)
    deviation = (np.array(signals) - signal_dn) / np.sqrt(image.variance_dn2(np.full(image.used.shape, signal_dn)))
    assert np.mean(deviation**2) == pytest.approx(1.0, abs=5.0 * np.sqrt(2.0 / deviation.size) + 0.005)
    by_column = np.mean(deviation**2, axis=(0, 1))
    assert np.abs(by_column - 1.0).max() < 5.0 * np.sqrt(2.0 / (deviation.size / by_column.size))


def test_what_two_shots_share_of_a_dark_is_their_covariance(folder: Path) -> None:
    """The noise of a dark that two shots name is common to them: its variance is the mean product."""
    text = (folder / "dataset.toml").read_text()
    other = text[text.index('[[shots]]\nid = "single"') : text.index('[[shots]]\nid = "array"')]
    edit(folder, '[[shots]]\nid = "array"', other.replace('"single"', '"again"') + '[[shots]]\nid = "array"')
    flat = np.full((PIXELS, PIXELS), 1.0)
    products = []
    for seed in range(20):
        raw, dark = drawn(flat, 1, 1, 0.0, seed)
        put(folder, "images/single.tif", raw)
        put(folder, "dark/dark.tif", dark)
        both = images(folder, BIN_UM)
        products.append((BLACK_DN - binned(dark)) ** 2)
        np.testing.assert_array_equal(both["single"].signal_dn, both["again"].signal_dn)
    share = both["single"].dark_dn2.mean()
    assert np.mean(products) == pytest.approx(share, rel=5.0 * np.sqrt(2.0 / np.size(products)))
    assert share == pytest.approx(both["single"].constant_dn2.mean() / 2.0)


def binned(values: np.ndarray) -> np.ndarray:
    """The mean over 2 x 2 pixels."""
    return np.asarray(values.reshape(48, 2, 48, 2).mean(axis=(1, 3)))


def test_variance_terms_are_the_formula(folder: Path) -> None:
    """K s + (K read)^2 + 1/12, over 16 frames and 4 pixels; a bin's PRNU is half a pixel's."""
    edit(folder, "exposure_ms = 4.0", "exposure_ms = 4.0\nframes_averaged = 16")
    edit(folder, "black_level_dn = 64.0", "black_level_dn = 64.0\nprnu_percent = 0.3")
    image = images(folder, BIN_UM)["array"]
    assert image.slope_dn[0, 0] == pytest.approx(GAIN / 64.0)
    of_frames = (GAIN * READ_NOISE_E) ** 2 + 1.0 / 12.0
    assert image.constant_dn2[0, 0] == pytest.approx((of_frames / 16.0 + 1.0 / 12.0) / 4.0)  # a mean in whole DN
    assert image.prnu == pytest.approx(0.0015)
    assert not image.dark_dn2.any()


def test_a_bin_with_one_saturated_pixel_is_unused_and_counted(folder: Path) -> None:
    """Tested on the raw file: from 0.97 of the full well or 0.98 of full scale on."""
    raw = photographed(PEAK_DN * light(3, 5), 2)
    limit = min(0.98 * 4095, BLACK_DN + 0.97 * GAIN * 78_000)
    raw[10, 11], raw[20, 21] = int(np.ceil(limit)), int(np.floor(limit - 1e-9))
    put(folder, "images/array.tif", raw)
    image = images(folder, BIN_UM)["array"]
    assert image.saturated == 1
    assert np.argwhere(~image.used).tolist() == [[5, 5]]


def test_averaged_frames_are_masked_by_the_predicted_mean(folder: Path) -> None:
    """Where mean + 3 sigma of one frame passes the limit, some may have been clipped."""
    limit = min(0.98 * 4095, BLACK_DN + 0.97 * GAIN * 78_000) - BLACK_DN
    sigma = np.sqrt(GAIN * limit + (GAIN * READ_NOISE_E) ** 2 + 1.0 / 12.0)
    predicted = np.full((48, 48), limit - 4.0 * sigma)
    predicted[3, 4] = limit - 2.5 * sigma
    assert not images(folder, BIN_UM)["array"].may_be_clipped(predicted).any()
    edit(folder, "exposure_ms = 4.0", "exposure_ms = 4.0\nframes_averaged = 16")
    assert np.argwhere(images(folder, BIN_UM)["array"].may_be_clipped(predicted)).tolist() == [[3, 4]]


def test_a_single_frame_with_saturated_pixels_is_masked_by_the_prediction(folder: Path) -> None:
    """Of 103 pixels at the limit noise keeps 43, which are 0.9 sigma too dark on average."""
    limit = min(0.98 * 4095, BLACK_DN + 0.97 * GAIN * 78_000) - BLACK_DN
    sigma = np.sqrt(GAIN * limit)
    bright = light(3, 5)
    bright[10:20, 10:20] = 1.0
    raw = photographed(np.where(bright == 1.0, limit, 0.5 * limit * bright), 2)
    put(folder, "images/array.tif", raw)
    image = images(folder, 1.0)["array"]
    assert image.saturated > 0
    predicted = np.where(bright == 1.0, limit, 0.5 * limit * bright)
    kept = image.used & (bright == 1.0)
    assert (image.signal_dn[kept] - limit).mean() < -0.8 * sigma
    assert not (image.used & ~image.may_be_clipped(predicted) & (bright == 1.0)).any()
    assert not image.may_be_clipped(predicted)[bright < 1.0].any()


def test_the_flat_of_a_pixel_counts_for_its_clipping(folder: Path) -> None:
    """Behind a flat of 0.5 the raw signal is half of the corrected one."""
    flat = np.ones((PIXELS, PIXELS), np.float32)
    flat[:, ::2] = 1.0
    flat[:48] = 0.5
    put(folder, "flat/flat.tif", flat)
    edit(folder, "exposure_ms = 8.0", "exposure_ms = 8.0\nframes_averaged = 16")
    image = images(folder, BIN_UM)["single"]
    clipped = image.may_be_clipped(np.full(image.used.shape, 3800.0))
    assert not clipped[3:24].any()
    assert clipped[24:].all()


def test_binning_is_whole_and_common_and_not_below_the_camera(folder: Path) -> None:
    """400 um / 16 = 25 um: one pixel of 24 um; finer cameras bin, the smallest pitch decides for all."""
    assert binning(read_dataset(folder)) == 1
    assert binning(read_dataset(folder), 100.0) == 4
    assert binning(read_dataset(folder), 1.0) == 1
    edit(folder, "pixel_um = 24.0", "pixel_um = 5.0")
    assert binning(read_dataset(folder)) == 5
    edit(folder, "spacing_um = 400.0", "spacing_um = 240.0")
    assert binning(read_dataset(folder)) == 3
    assert {image.binning for image in measured_images(read_dataset(folder))} == {3}
    for none in (-1.0, 0.0, float("nan")):
        with pytest.raises(InputError, match="above 0 um"):
            binning(read_dataset(folder), none)
    with pytest.raises(InputError, match="above 0 um"):  # also of spectra, which have no pixels
        measured_images(read_dataset(WAFER), float("nan"))


def test_pixels_left_over_are_cut_at_both_ends_and_the_centre_follows(folder: Path) -> None:
    """96 pixels by 7 are 13 bins and 5 left over: 2 before, 3 behind; a spot stays where its centre says."""
    spot = np.zeros((PIXELS, PIXELS), np.float32)
    spot[54, 40] = 49.0
    put(folder, "images/array.tif", spot + np.float32(BLACK_DN))
    edit(folder, "exposure_ms = 4.0", "exposure_ms = 4.0\ncentre_px = [54, 40]")
    image = images(folder, 7 * 24.0)["array"]
    assert image.signal_dn.shape == (13, 13)
    assert np.argwhere(image.signal_dn > 0.5).tolist() == [[7, 5]]
    assert image.centre_px == pytest.approx((7.0, 5.0))
    assert image.signal_dn[7, 5] == pytest.approx(1.0)


def test_numbers_that_are_not_finite_matter_only_where_they_are_used(folder: Path) -> None:
    """A NaN behind the mask is nothing; elsewhere it is refused."""
    raw = photographed(PEAK_DN * light(), 1).astype(np.float32)
    raw[2, 3] = np.nan
    put(folder, "images/single.tif", raw)
    assert np.isfinite(images(folder)["single"].signal_dn).all()
    raw[40, 40] = np.inf
    put(folder, "images/single.tif", raw)
    assert images(folder)["single"].saturated == 1
    raw[40, 41] = np.nan
    put(folder, "images/single.tif", raw)
    with pytest.raises(InputError, match="1 pixels NaN"):
        images(folder)


def test_a_constant_image_is_refused(folder: Path) -> None:
    """It fits any model: gain 0 and its level as the offset."""
    put(folder, "images/single.tif", np.full((PIXELS, PIXELS), 1000, np.uint16))
    with pytest.raises(InputError, match=r"1000 DN everywhere.*a constant one shows nothing"):
        images(folder)


@pytest.mark.parametrize(
    ("name", "size"), [("dark/dark.tif", 95), ("flat/flat.tif", 95), ("masks/mask.tif", 90), ("images/array.tif", 90)]
)
def test_sizes_that_differ_are_refused(folder: Path, name: str, size: int) -> None:
    """By the name of a file, with both sizes."""
    put(folder, name, np.full((size, size), 70, np.uint16) + np.eye(size, dtype=np.uint16))
    with pytest.raises(InputError, match=re.compile("size: got .* x .* pixels.*allowed", re.DOTALL)):
        images(folder)


def test_an_image_darker_than_its_dark_is_refused(folder: Path) -> None:
    """Exchanged by mistake, they would be fitted with a gain of 0 and an offset; noise about black is no fault."""
    import tifffile

    put(folder, "dark/dark.tif", tifffile.imread(folder / "images/single.tif") + np.uint16(5))
    with pytest.raises(InputError, match=r"images/single.tif: values.*above dark/dark.tif.*exchanged"):
        images(folder)


def test_an_image_without_a_usable_pixel_is_refused(folder: Path) -> None:
    """All of it saturated."""
    put(folder, "images/array.tif", np.full((PIXELS, PIXELS), 4095, np.uint16))
    with pytest.raises(InputError, match="shorter exposure"):
        images(folder)


def test_spectra_and_far_fields_come_as_columns(folder: Path) -> None:
    """Numbers as written, with the film and the sample they are of."""
    data = read_dataset(folder)
    (spectrum,), (far_field,) = measured_spectra(data), measured_far_fields(data)
    assert (spectrum.film.id, far_field.sample.id) == ("film", "one")
    assert spectrum.table.polarisation == ("u", "u")
    np.testing.assert_array_equal(spectrum.table.value, [0.71, 0.72])
    np.testing.assert_array_equal(far_field.table.theta_deg, [0.0, 30.0, 60.0])


def test_rows_in_any_order_come_as_lines(folder: Path) -> None:
    """Wavelengths of one angle and polarisation, angles of one plane, follow each other as they grow."""
    rows = ["445,0,u,0.1,0.01", "440,30,s,0.2,0.01", "440,0,u,0.3,0.01", "445,30,s,0.4,0.01", "440,10,s,0.5,0.01"]
    edit(folder, SPECTRUM.partition("\n")[2], "\n".join(rows), "spectra/t.csv")
    edit(folder, FAR_FIELD.partition("\n")[2], "30,90,3,1\n60,0,2,1\n0,90,4,1\n30,0,1,1\n", "far/g.csv")
    data = read_dataset(folder)
    (spectrum,), (far_field,) = measured_spectra(data), measured_far_fields(data)
    np.testing.assert_array_equal(spectrum.table.value, [0.5, 0.2, 0.4, 0.3, 0.1])
    assert spectrum.table.polarisation == ("s", "s", "s", "u", "u")
    np.testing.assert_array_equal(far_field.table.value, [1.0, 2.0, 4.0, 3.0])


def test_a_dark_that_is_no_number_is_refused_unless_it_is_masked(folder: Path) -> None:
    """As an image is; where it is masked it says nothing, in other images of the camera either."""
    dark = np.full((PIXELS, PIXELS), BLACK_DN, np.float32)
    dark[10, 11] = np.nan
    put(folder, "dark/nan.tif", dark)
    edit(folder, "exposure_ms = 4.0", 'exposure_ms = 4.0\ndark = "dark/nan.tif"')
    with pytest.raises(InputError, match=r"dark/nan.tif: values: got '1 pixels NaN or infinite'"):
        images(folder, BIN_UM)
    mask = np.ones((PIXELS, PIXELS), np.uint8)
    mask[10, 11] = 0
    put(folder, "masks/mask.tif", mask)
    edit(folder, 'dark = "dark/nan.tif"', 'dark = "dark/nan.tif"\nmask = "masks/mask.tif"')
    image = images(folder, BIN_UM)["array"]
    assert np.isfinite(image.signal_dn).all()
    assert not image.used[5, 5]
