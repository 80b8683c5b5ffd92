"""What a fit gets of a data set: corrected and binned images with the terms of their noise; spectra; far fields.

    raw DN  --(minus dark or black level)/flat, mean over the bin-->  signal_dn
    variance of a bin = constant_dn2 + slope_dn * signal,  signal as *predicted*, never as measured

Noise of a raw pixel in DN^2, from the signal above black s: (K s + (K read_noise_e)^2 + 1/12) / frames_averaged
(EMVA 1288). A flat f divides signal by f, hence variance by f^2 (which leaves K s / f for a signal s after the flat);
the mean over b x b pixels divides it by b^2. A dark of n frames adds ((K read_noise_e)^2 + 1/12) / n / f^2, the same
pixel by pixel in all shots that use that dark: `dark_dn2` is that part.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cache, partial

import numpy as np
from numpy.typing import NDArray

from luxloop.errors import InputError
from validation.dataset.folder import Dataset
from validation.dataset.images import (
    IMAGE_TYPES,
    MASK_TYPES,
    Pixels,
    Real,
    binned_any,
    binned_mean,
    binned_place,
    read_tiff,
)
from validation.dataset.manifest import (
    CameraFacts,
    FarFieldShot,
    FilmSample,
    ImageShot,
    Manifest,
    Sample,
    SpectrumShot,
)
from validation.dataset.spectra import FarFieldTable, SpectrumTable, read_far_field, read_spectrum

PIXELS_PER_PITCH = 16
MOST_BINS = 100_000
"""Of an image: its residuals go on record as text, of which a message holds a megabyte."""
DARKER = 5.0
"""Standard errors that the mean of an image without any light may be below its black."""


@dataclass(frozen=True, eq=False)
class MeasuredImage:
    """An image as it is compared; arrays (row, column) of binned pixels, row 0 at the lowest y."""

    shot: ImageShot
    sample: Sample
    camera: CameraFacts
    signal_dn: Real  # above black, after the flat, mean over the bin
    used: NDArray[np.bool_]  # no pixel of the bin is masked or saturated
    constant_dn2: Real  # variance without light
    slope_dn: Real  # variance per signal
    dark_dn2: Real  # the part of constant_dn2 that all shots with the same dark share
    prnu: float  # rms of a binned pixel's fixed pattern, share of the signal, the same in all images of the camera
    binning: int
    pixel_um: float  # side of a binned pixel on the receiver
    centre_px: tuple[float, float]  # (row, column), first guess of the module's centre, in binned pixels
    saturated: int  # raw pixels
    masked: int  # raw pixels
    raw_pixels: int  # of the file, those that no whole bin holds included

    def variance_dn2(self, predicted_dn: Real) -> Real:
        """Variance (..., row, column) in DN^2 of the temporal noise for a predicted signal in DN; without PRNU."""
        return self.constant_dn2 + self.slope_dn * np.maximum(predicted_dn, 0.0)

    def noise_dn2(self, predicted_dn: Real) -> Real:
        """The same with the camera's pattern, as if it were each image's own."""
        return self.variance_dn2(predicted_dn) + (self.prnu * predicted_dn) ** 2

    def may_be_clipped(self, predicted_dn: Real) -> NDArray[np.bool_]:
        """Where noise may have decided whether a pixel counts: predicted mean + 3 sigma of a frame passes saturation.

        The mean of several frames hides a clipped one there. Of a single frame with saturated pixels those that noise
        made darker are left over there, and are too dark on average; nothing is flagged in one without.
        Takes the predicted signal (..., row, column) in DN. Within a bin the signal is taken for flat.
        """
        frames, camera = self.shot.frames_averaged, self.camera
        if frames == 1 and self.saturated == 0:
            return np.zeros(np.shape(predicted_dn), np.bool_)
        flat = camera.gain_dn_per_e / (frames * self.binning**2 * self.slope_dn)  # slope = K mean(1/f) / (n b^2)
        raw = np.maximum(predicted_dn, 0.0) * flat
        one_frame = np.sqrt(camera.gain_dn_per_e * raw + camera.dark_variance_dn2)
        return np.asarray(camera.black_level_dn + raw + 3.0 * one_frame >= camera.saturation_dn)


@dataclass(frozen=True, eq=False)
class MeasuredSpectrum:
    """A spectrum or an ellipsometric curve, row by row."""

    shot: SpectrumShot
    film: FilmSample
    table: SpectrumTable


@dataclass(frozen=True, eq=False)
class MeasuredFarField:
    """A goniometer curve, row by row; its scale is free."""

    shot: FarFieldShot
    sample: Sample
    table: FarFieldTable


def measured_images(dataset: Dataset, compare_pixel_um: float | None = None) -> list[MeasuredImage]:
    """The images of a data set, binned to about `compare_pixel_um` on the receiver (default: 1/16 of the pitch).

    All images get one binning, so that the camera's fixed pattern is the same in all: the largest whole factor whose
    bin is not above 1/16 of any sample's pitch (a single's: its spacing_um), and never below the camera's pixel.
    Files that several shots name are read once.

    Raises InputError for a file that cannot be read or does not fit, numbers that are not finite, a flat that is not
    above 0, and an image without a usable pixel or without light.
    """
    refuse_no_pixel(compare_pixel_um)
    camera, shots = dataset.manifest.camera, dataset.manifest.images()
    if camera is None or not shots:
        return []
    factor = binning(dataset, compare_pixel_um)
    correction = cache(partial(_correction, dataset, factor))
    images = []
    for shot in shots:
        raw = read_tiff(dataset.path(shot.file), shot.file).values
        if min(raw.shape) < factor:
            allowed, mend = f"at least {factor} x {factor} pixels, one bin", "is pixel_um right, in um?"
            raise InputError(f"{shot.file}: size", raw.shape, allowed, mend)
        _refuse_too_many_bins(raw.shape, factor, camera.pixel_um, shot.file)
        corrected_by = correction(raw.shape, shot.dark, shot.flat, shot.mask)
        images.append(_measured(dataset.manifest, shot, raw, corrected_by, factor))
        if images[-1].signal_dn.shape != images[0].signal_dn.shape:
            value, allowed = f"{raw.shape[0]} x {raw.shape[1]} pixels", f"as large as {shots[0].file}"
            raise InputError(f"{shot.file}: size", value, allowed, "crop them alike, or make two data sets")
    return images


def _refuse_too_many_bins(shape: tuple[int, ...], factor: int, pixel_um: float, file: str) -> None:
    """InputError for an image of more bins than a worker predicts at once and a record in the journal holds."""
    rows, columns = (size // factor for size in shape)
    if rows * columns > MOST_BINS:
        larger = math.ceil(math.sqrt(shape[0] * shape[1] / MOST_BINS)) * pixel_um
        mend = f"--pixel-um {larger:g} (compare, where, diagnose, ...), or crop the images"
        value = f"{rows} x {columns} bins of {factor * pixel_um:g} um"
        raise InputError(f"{file}: size", value, f"at most {MOST_BINS:,} bins in an image", mend)


def refuse_no_pixel(compare_pixel_um: float | None) -> None:
    """InputError for a size that no pixel has."""
    if compare_pixel_um is not None and not 0.0 < compare_pixel_um < math.inf:
        raise InputError("compare_pixel_um", compare_pixel_um, "above 0 um", "leave it out for 1/16 of the pitch")


def binning(dataset: Dataset, compare_pixel_um: float | None = None) -> int:
    """How many camera pixels make the side of a bin, see `measured_images`; InputError for a pixel of no size."""
    refuse_no_pixel(compare_pixel_um)
    camera, manifest = dataset.manifest.camera, dataset.manifest
    if camera is None:
        return 1
    pitches_um = [manifest.sample(shot.sample).spacing_um for shot in manifest.images()]
    wanted_um = compare_pixel_um or min(pitches_um) / PIXELS_PER_PITCH
    return max(1, math.floor(wanted_um / camera.pixel_um + 1e-9))


def measured_spectra(dataset: Dataset) -> list[MeasuredSpectrum]:
    """The spectra and ellipsometric curves of a data set; raises InputError for the first fault in a file."""
    manifest = dataset.manifest
    return [
        MeasuredSpectrum(shot, manifest.film(shot.film), read_spectrum(dataset.path(shot.file), shot))
        for shot in manifest.spectra()
    ]


def measured_far_fields(dataset: Dataset) -> list[MeasuredFarField]:
    """The goniometer curves of a data set; raises InputError for the first fault in a file."""
    manifest = dataset.manifest
    return [
        MeasuredFarField(shot, manifest.sample(shot.sample), read_far_field(dataset.path(shot.file), shot))
        for shot in manifest.far_fields()
    ]


@dataclass(frozen=True, eq=False)
class _Correction:
    """What a dark, a flat and a mask do to all images that name them."""

    ignored: NDArray[np.bool_] | None  # (row, column) of the raw file
    inverse: NDArray[np.float32] | None  # 1/flat of the raw file; none: 1
    inverse_mean: Real  # mean over the bin of 1/flat
    inverse_square: Real  # mean over the bin of 1/flat^2
    dark_dn: Real | None  # mean over the bin of dark/flat; none: the black level is subtracted
    dark_in_whole_dn: bool = False  # as its file has it

    def binned(self, raw: Pixels, factor: int) -> Real:
        """The mean over bins of raw/flat."""
        return binned_mean(raw if self.inverse is None else raw * self.inverse, factor)


def _correction(
    dataset: Dataset, factor: int, shape: tuple[int, ...], dark: str | None, flat: str | None, mask: str | None
) -> _Correction:
    """The correction of images of that shape by these files; where there is none its arrays are of shape (1, 1)."""
    read = partial(_of_shape, dataset, shape)
    ignored = None if mask is None else read(mask, MASK_TYPES) == 0
    inverse = None if flat is None else inverse_flat(read(flat), ignored, flat)
    one = np.ones((1, 1))
    mean, square = (one, one) if inverse is None else (binned_mean(inverse, factor), binned_mean(inverse**2, factor))
    correction = _Correction(ignored, inverse, mean, square, None)
    if dark is None:
        return correction
    whole = _finite(read(dark), np.zeros(shape, np.bool_) if ignored is None else ignored, dark)
    return replace(correction, dark_dn=correction.binned(whole, factor), dark_in_whole_dn=in_whole_dn(whole))


def in_whole_dn(values: Pixels) -> bool:
    """Whether a file has room for whole numbers only."""
    return values.dtype.kind in "ui"


def rounding_dn2(whole: bool, frames: int) -> float:
    """Variance of the rounding of a mean of frames that was saved in whole DN; 0 of one with fractions.

    That of each frame is in `CameraFacts.dark_variance_dn2`.
    """
    return 1.0 / 12.0 if whole and frames > 1 else 0.0


def inverse_flat(flat: Pixels, ignored: NDArray[np.bool_] | None, name: str) -> NDArray[np.float32]:
    """1/flat (row, column), the flat divided by its mean over the unmasked field first.

    Where it is masked and not above 0, 1 stands, so that a variance is finite there too. Raises InputError where the
    flat is not above 0 somewhere unmasked.
    """
    seen = np.ones(flat.shape, np.bool_) if ignored is None else ~ignored
    good = (flat > 0) & np.isfinite(flat)
    if bad := int(np.count_nonzero(seen & ~good)):
        raise InputError(
            f"{name}: values", f"{bad} pixels not above 0", "above 0 where it is not masked", "mask them"
        )
    mean = float(flat[seen].mean(dtype=np.float64)) if seen.any() else 1.0
    return np.divide(np.float32(mean), flat, out=np.ones(flat.shape, np.float32), where=good, dtype=np.float32)


def _measured(
    manifest: Manifest, shot: ImageShot, raw: Pixels, correction: _Correction, factor: int
) -> MeasuredImage:
    """One image, corrected and binned; see `measured_images`."""
    camera = manifest.camera
    assert camera is not None  # noqa: S101 checks of the manifest
    saturated = raw >= camera.saturation_dn
    ignored = correction.ignored
    unused = saturated if ignored is None else saturated | ignored
    used = ~binned_any(unused, factor)
    signal = correction.binned(_finite(raw, unused, shot.file), factor)
    if not used.any():
        value = f"{np.count_nonzero(saturated)} of {raw.size} pixels saturated, the others masked"
        raise InputError(f"{shot.file}: values", value, "a pixel to compare", "a shorter exposure, or another mask")
    if np.ptp(signal[used]) == 0.0:
        raise InputError(
            f"{shot.file}: values", f"{raw.flat[0]:g} DN everywhere", "an image", "a constant one shows nothing"
        )
    black = camera.black_level_dn * correction.inverse_mean if correction.dark_dn is None else correction.dark_dn
    bin_and_frames = factor**2 * shot.frames_averaged
    rounding = rounding_dn2(in_whole_dn(raw), shot.frames_averaged)
    of_image = (camera.dark_variance_dn2 / shot.frames_averaged + rounding) / factor**2
    of_dark = 0.0
    if shot.dark is not None:
        rounding = rounding_dn2(correction.dark_in_whole_dn, shot.dark_frames)
        of_dark = (camera.dark_variance_dn2 / shot.dark_frames + rounding) / factor**2
    like = np.ones(signal.shape)
    constant_dn2 = (of_image + of_dark) * correction.inverse_square * like
    signal = signal - black
    _refuse_without_light(shot, signal[used], constant_dn2[used])
    return MeasuredImage(
        shot=shot,
        sample=manifest.sample(shot.sample),
        camera=camera,
        signal_dn=signal,
        used=used,
        constant_dn2=constant_dn2,
        slope_dn=camera.gain_dn_per_e / bin_and_frames * correction.inverse_mean * like,
        dark_dn2=of_dark * correction.inverse_square * like,
        prnu=camera.prnu_percent / 100.0 / factor,
        binning=factor,
        pixel_um=camera.pixel_um * factor,
        centre_px=_centre(shot, raw, factor),
        saturated=int(np.count_nonzero(saturated if ignored is None else saturated & ~ignored)),
        masked=0 if ignored is None else int(np.count_nonzero(ignored)),
        raw_pixels=raw.size,
    )


def _refuse_without_light(shot: ImageShot, signal_dn: Real, variance_dn2: Real) -> None:
    """An image (pixel,) that is darker than its own black by more than noise."""
    mean = float(signal_dn.mean())
    if mean < -DARKER * math.sqrt(float(variance_dn2.mean()) / signal_dn.size):
        value, allowed = f"mean {mean:.1f} DN above black", f"above {shot.dark or 'black_level_dn'}"
        raise InputError(f"{shot.file}: values", value, allowed, "are dark and image exchanged?")


def _centre(shot: ImageShot, raw: Pixels, factor: int) -> tuple[float, float]:
    """The first guess of the module's centre in binned pixels: as given, or the image's centre."""
    (rows, columns), given = raw.shape, shot.centre_px
    row, column = given if given is not None else ((rows - 1) / 2, (columns - 1) / 2)
    return binned_place(row, rows, factor), binned_place(column, columns, factor)


def _finite(raw: Pixels, unused: NDArray[np.bool_], name: str) -> Pixels:
    """The pixels with 0 for what is not finite and not used; InputError where one of use is not finite."""
    if raw.dtype.kind != "f":
        return raw
    finite = np.isfinite(raw)
    if bad := int(np.count_nonzero(~finite & ~unused)):
        raise InputError(f"{name}: values", f"{bad} pixels NaN or infinite", "finite numbers", "mask them")
    return raw if finite.all() else np.where(finite, raw, 0)


def _of_shape(dataset: Dataset, shape: tuple[int, ...], name: str, types: tuple[str, ...] = IMAGE_TYPES) -> Pixels:
    """The dark, flat or mask of that name; InputError where it is not of the image's shape."""
    values = read_tiff(dataset.path(name), name, types).values
    if values.shape != shape:
        value, allowed = (f"{one[0]} x {one[1]} pixels" for one in (values.shape, shape))
        raise InputError(f"{name}: size", value, allowed, "dark, flat, mask and image must be of one size")
    return values
