"""What may be wrong with the pixels of an image, its dark, flat and mask; and with what the manifest says of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from luxloop.errors import InputError
from validation.dataset.images import MASK_TYPES, Pixels, Real, TiffImage, binned_mean
from validation.dataset.lattice import Lattice, find_lattice
from validation.dataset.manifest import CameraFacts, ImageShot, Manifest, Sample
from validation.measured import PIXELS_PER_PITCH, in_whole_dn, rounding_dn2

PITCH_TOLERANCE, PITCH_TOLERANCE_OF_FEW = 0.12, 0.15
"""How far a pitch in the image may be from the manifest's; outer chips of a small array look nearer than they are."""
NOISE_RATIO = 2.5
"""How far the variance in the image may be from what the camera's numbers say, up or down."""
GAMMA_SLOPE = 0.2
"""Photon noise: d ln variance / d ln signal is near 1. A screen's gamma of 2.2 makes it -0.2."""

SLOPE_ERROR = 0.15
"""A slope known worse than this is not looked at."""
LEAST_SIGMA_DN = 0.5
"""Of a mean's noise: below it, rounding to whole numbers follows the signal and is no noise any more."""
NOISE_PX = 600
"""Noise is estimated from the middle of the image, at most so many pixels wide and high."""

Level = Literal["error", "warning"]
Load = Callable[[str, tuple[str, ...] | None], TiffImage | None]
"""The TIFF of that name and of these types, None where it cannot be read, which has been told already."""


@dataclass(frozen=True)
class Told:
    """A fault, and whether it is an error (the data set cannot be used like this) or a warning."""

    error: InputError
    level: Level = "error"


def image_faults(manifest: Manifest, shot: ImageShot, load: Load) -> Iterator[Told]:
    """Everything that is wrong with an image shot, file by file; what cannot be read is passed over."""
    camera, image = manifest.camera, load(shot.file, None)
    mask = load(shot.mask, MASK_TYPES) if shot.mask else None
    dark = load(shot.dark, None) if shot.dark else None
    flat = load(shot.flat, None) if shot.flat else None
    if camera is None or image is None:
        return
    raw = image.values
    yield from _of_size(raw, camera, manifest.sample(shot.sample), shot)
    fitting = True
    for name, other in ((shot.mask, mask), (shot.dark, dark), (shot.flat, flat)):
        if name and other is not None and other.values.shape != raw.shape:
            fitting = False
            yield Told(
                InputError(f"{name}: size", _size(other.values), f"{_size(raw)}, as {shot.file}", "crop alike")
            )
    yield from _of_place(shot, raw)
    if not fitting:
        return
    seen = np.ones(raw.shape, np.bool_) if mask is None else mask.values != 0
    if not seen.any():
        yield Told(InputError(f"{shot.mask}: values", "all 0", "some pixels not 0", "0 means: ignore the pixel"))
        return
    if flat is not None and shot.flat:
        yield from _of_flat(flat.values, seen, shot.flat)
    if dark is not None and shot.dark:
        yield from _of_dark(dark.values, raw, seen, shot)
    yield from _of_pixels(image, seen, camera, shot)
    usable = seen & np.isfinite(raw) & (raw < camera.saturation_dn)
    if usable.any() and np.ptp(raw[usable]) > 0:
        plain = _without_patterns(raw, dark, flat, camera.black_level_dn)
        rounding = rounding_dn2(in_whole_dn(raw), shot.frames_averaged)
        if dark is not None:
            rounding += rounding_dn2(in_whole_dn(dark.values), shot.dark_frames)
        yield from _of_noise(plain, usable, camera, shot, rounding)
        yield from _of_lattice(raw, usable, camera, manifest.sample(shot.sample), shot)


def _size(values: Pixels) -> str:
    return f"{values.shape[0]} x {values.shape[1]} pixels"


def _of_size(raw: Pixels, camera: CameraFacts, sample: Sample, shot: ImageShot) -> Iterator[Told]:
    """An image that is smaller than what it is compared at: its pixels are larger than `pixel_um` says."""
    least_um = sample.spacing_um / PIXELS_PER_PITCH
    if min(raw.shape) * camera.pixel_um * (1.0 + 1e-9) < least_um:
        value = f"{_size(raw)} of {camera.pixel_um:g} um"
        allowed = f"at least {least_um:g} um, 1/{PIXELS_PER_PITCH} of spacing_um"
        yield Told(InputError(f"{shot.file}: size", value, allowed, "is pixel_um right? In um, not in mm"))


def _of_place(shot: ImageShot, raw: Pixels) -> Iterator[Told]:
    """A first guess of the centre that is no place of the image."""
    if shot.centre_px is not None:
        ends = [size - 0.5 for size in raw.shape]
        if not all(-0.5 <= place <= end for place, end in zip(shot.centre_px, ends, strict=True)):
            allowed = f"(row, column) inside {_size(raw)}"
            yield Told(InputError(f"{shot.file}: centre_px", shot.centre_px, allowed, "in pixels of the raw file"))


def _of_flat(flat: Pixels, seen: NDArray[np.bool_], name: str) -> Iterator[Told]:
    bad = int(np.count_nonzero(~(np.isfinite(flat) & (flat > 0)) & seen))
    if bad:
        value = f"{bad} pixels that are 0, below, or NaN"
        yield Told(InputError(f"{name}: values", value, "above 0 where it is not masked", "mask them"))


def _of_dark(dark: Pixels, raw: Pixels, seen: NDArray[np.bool_], shot: ImageShot) -> Iterator[Told]:
    if bad := int(np.count_nonzero(~np.isfinite(dark) & seen)):
        yield Told(InputError(f"{shot.dark}: values", f"{bad} pixels NaN or infinite", "finite numbers", "mask them"))
        return
    means = [float(np.nanmean(image[seen], dtype=np.float64)) for image in (dark, raw)]
    if means[0] >= means[1]:
        value, allowed = f"mean {means[0]:.1f} DN", f"below {means[1]:.1f} DN, the mean of {shot.file}"
        yield Told(InputError(f"{shot.dark}: values", value, allowed, "are dark and image exchanged?"))


def _of_pixels(image: TiffImage, seen: NDArray[np.bool_], camera: CameraFacts, shot: ImageShot) -> Iterator[Told]:
    """Numbers that a raw image of this camera cannot have."""
    raw, where = image.values, f"{shot.file}: values"
    finite = np.isfinite(raw)
    if bad := int(np.count_nonzero(~finite & seen)):
        yield Told(InputError(where, f"{bad} pixels NaN or infinite", "finite numbers", "mask them"))
    values = raw[seen & finite]
    if not values.size:
        return
    least, most = float(values.min()), float(values.max())
    if most > camera.full_scale_dn:
        mend = f"is bit_depth {camera.bit_depth} right? Shifted up to fill 16 bits? Shift it back"
        yield Told(InputError(where, f"up to {most:g} DN", f"at most {camera.full_scale_dn:g} DN", mend))
    if least == most < camera.saturation_dn:
        yield Told(InputError(where, f"{least:g} DN everywhere", "an image", "a constant image shows nothing"))
        return
    if image.for_screens:
        mend = "values for a screen are gamma-encoded: export the raw image"
        yield Told(InputError(f"{shot.file}: profile", "a colour profile or transfer curve", "none", mend), "warning")
    yield from _of_steps(values, where)
    sigma_dn = np.sqrt(camera.dark_variance_dn2 / shot.frames_averaged)
    if rounding_dn2(in_whole_dn(raw), shot.frames_averaged) and sigma_dn < LEAST_SIGMA_DN:
        value = f"a mean of {shot.frames_averaged} frames in whole DN, its noise {sigma_dn:.2g} DN"
        mend = "rounding hides what averaging brought, and is no noise: save means as float32"
        yield Told(InputError(where, value, "a mean with fractions", mend), "warning")
    saturated = int(np.count_nonzero(values >= camera.saturation_dn))
    if saturated:
        value = f"{saturated} of {values.size} pixels ({_percent(saturated, values.size)}) saturated"
        allowed = f"below {camera.saturation_dn:.0f} DN"
        whole = saturated == values.size
        mend = "a shorter exposure" + ("" if whole else "; they are left out of every comparison")
        yield Told(InputError(where, value, allowed, mend), "error" if whole else "warning")
    darkest = float(np.quantile(values, 0.01))
    sigma = np.sqrt(camera.dark_variance_dn2)
    if shot.dark is None and darkest < camera.black_level_dn - 5.0 * sigma:
        mend = "is black_level_dn right?"
        allowed = f"from the black level {camera.black_level_dn:g} DN on"
        yield Told(InputError(where, f"1 % below {darkest:.1f} DN", allowed, mend), "warning")


def _percent(part: int, whole: int) -> str:
    return f"{100.0 * part / whole:.2g} %" if part < whole else "100 %"


def _of_steps(values: Pixels, where: str) -> Iterator[Told]:
    """Whole numbers that come in steps: eight bits stretched, or fewer bits shifted up."""
    if values.dtype.kind != "u":
        return
    levels = np.flatnonzero(np.bincount(values))
    step = int(np.gcd.reduce(np.diff(levels))) if levels.size > 2 else 1
    if step > 1:
        mend = "8 bits stretched to 16? Save the raw image" if step == 257 else "divide the values by the step"
        yield Told(InputError(where, f"in steps of {step} DN", "steps of 1 DN", mend))


def _without_patterns(raw: Pixels, dark: TiffImage | None, flat: TiffImage | None, black_dn: float) -> Pixels:
    """The raw image without what its dark and its flat know from pixel to pixel; its levels stay as they are."""
    if dark is not None:
        raw = np.asarray(raw, np.float32) - dark.values + np.float32(black_dn)
    if flat is not None:
        sensitivity = np.where(flat.values > 0, flat.values, 1).astype(np.float32)
        around = uniform_filter(sensitivity, 3, mode="nearest")
        raw = np.float32(black_dn) + (raw - np.float32(black_dn)) * (around / sensitivity)
    return raw


def _of_noise(
    raw: Pixels, usable: NDArray[np.bool_], camera: CameraFacts, shot: ImageShot, rounding: float
) -> Iterator[Told]:
    """Noise that grows with the signal in another way than the camera's numbers say; gamma shows so."""
    law = _noise_law(raw, usable, camera)
    if law is None:
        return
    signal, found, weight = law
    expected = (camera.gain_dn_per_e * signal + camera.dark_variance_dn2) / shot.frames_averaged + rounding
    if shot.dark is not None:
        expected += camera.dark_variance_dn2 / shot.dark_frames
    expected += (camera.prnu_percent / 100.0 * signal) ** 2
    x, (y, z) = np.log(signal), np.log((found, expected))
    centred = x - np.average(x, weights=weight**2)
    known = float(np.sum((weight * centred) ** 2))  # 1 / variance of the slope
    if known > SLOPE_ERROR**-2:
        slopes = [float(np.sum(weight**2 * centred * one)) / known for one in (y, z)]
        if slopes[1] > 0.6 and slopes[0] < GAMMA_SLOPE:
            value = f"noise variance goes as signal^{slopes[0]:.2f}"
            mend = "gamma-encoded, or denoised? Export the raw image"
            yield Told(InputError(f"{shot.file}: noise", value, f"signal^{slopes[1]:.2f}, linear in light", mend))
            return
    ratio = float(np.exp(np.average(y - z, weights=weight**2)))
    if not 1.0 / NOISE_RATIO <= ratio <= NOISE_RATIO:
        value, allowed = f"{ratio:.2g} times the expected variance", f"{1 / NOISE_RATIO:g} to {NOISE_RATIO:g} times"
        mend = "look at gain_dn_per_e, read_noise_e, frames_averaged; was it smoothed, resampled or compressed?"
        yield Told(InputError(f"{shot.file}: noise", value, allowed, mend), "warning")


def _noise_law(raw: Pixels, usable: NDArray[np.bool_], camera: CameraFacts) -> tuple[Real, Real, Real] | None:
    """Signal above black, variance of a pixel, and 1/error of its logarithm, at some levels of signal; None: too few.

    The variance comes from a difference among 3 x 3 neighbours that is zero for any sum of a function of the row and
    one of the column, and independent of their mean, the level; its median is not moved by the few pixels on an edge.
    """
    middle = tuple(slice(max(0, (size - NOISE_PX) // 2), (size + NOISE_PX) // 2) for size in raw.shape)
    x, usable = np.asarray(raw[middle], np.float32), usable[middle]
    across = x[:, :-2] - 2.0 * x[:, 1:-1] + x[:, 2:]
    squared = ((across[:-2] - 2.0 * across[1:-1] + across[2:]) / 6.0) ** 2
    rows, columns = squared.shape
    around = [(r, c) for r in range(3) for c in range(3)]
    inner = np.all([usable[r : r + rows, c : c + columns] for r, c in around], axis=0)
    level = np.mean([x[r : r + rows, c : c + columns] for r, c in around], axis=0) - camera.black_level_dn
    bright = inner & (level > 3.0 * np.sqrt(camera.dark_variance_dn2))
    signal, square = (part[bright].astype(np.float64) for part in (level, squared))
    if signal.size < 2000:
        return None
    least, most = np.quantile(signal, (0.001, 0.999)).tolist()
    edges = np.geomspace(least, most, 9)
    at = np.searchsorted(edges, signal)
    groups = [group for group in (np.flatnonzero(at == number) for number in range(1, 9)) if group.size > 100]
    if not groups or any(np.median(square[group]) <= 0.0 for group in groups):
        return None
    levels, medians = (np.array([np.median(part[group]) for group in groups]) for part in (signal, square))
    error = 2.4 / np.sqrt([group.size for group in groups])  # of the logarithm of the median of squares
    return levels, medians / 0.4549, 1.0 / error  # 0.4549: the median of the square of a normal number


def _of_lattice(
    raw: Pixels, usable: NDArray[np.bool_], camera: CameraFacts, sample: Sample, shot: ImageShot
) -> Iterator[Told]:
    """A pitch, or rows and columns, that contradict the array that the manifest says this is."""
    if sample.layout == "single" or min(raw.shape) < 16:
        return
    lattice = find_lattice(binned_mean(raw, 1), usable)
    expected_px = sample.spacing_um / camera.pixel_um
    both = sample.rows > 1 and sample.columns > 1
    if lattice is None or (both and None in (lattice.row_pitch_px, lattice.column_pitch_px)):
        if min(raw.shape) > 2.5 * expected_px > 15.0:
            value, allowed = "no lattice of chips seen", f"a pitch of {expected_px:.1f} px"
            mend = "the pitch could not be checked; is it the image of this sample?"
            yield Told(InputError(f"{shot.file}: lattice", value, allowed, mend), "warning")
        return
    yield from _of_pitch(lattice, expected_px, camera, sample, shot)
    swapped = (lattice.rows, lattice.columns) == (sample.columns, sample.rows)
    if swapped and sample.rows != sample.columns:
        value = f"{lattice.rows} rows (y) and {lattice.columns} columns (x) of chips"
        allowed = f"rows = {sample.rows}, columns = {sample.columns} as sample {sample.id} says"
        mend = "swapped axes? Exchange rows and columns, or transpose the image"
        yield Told(InputError(f"{shot.file}: lattice", value, allowed, mend))


def _of_pitch(
    lattice: Lattice, expected_px: float, camera: CameraFacts, sample: Sample, shot: ImageShot
) -> Iterator[Told]:
    """A pitch that is not the spacing; a warning where it is, as a model may take it, spacing and a chip's width."""
    many = max(lattice.rows, lattice.columns) >= 4
    tolerance = PITCH_TOLERANCE if many else PITCH_TOLERANCE_OF_FEW
    if abs(lattice.pitch_px / expected_px - 1.0) <= tolerance:
        return
    is_gap = abs(lattice.pitch_px * camera.pixel_um / sample.pitch_um("gap") - 1.0) <= tolerance
    fitting_um = sample.spacing_um / lattice.pitch_px
    value = f"chips {lattice.pitch_px:.1f} px apart"
    allowed = f"{expected_px:.1f} px: spacing_um {sample.spacing_um:g} / pixel_um {camera.pixel_um:g}"
    mend = f"pixel_um = {fitting_um:.3g} or spacing_um = {lattice.pitch_px * camera.pixel_um:.3g} would fit"
    pitches = [pitch for pitch in (lattice.row_pitch_px, lattice.column_pitch_px) if pitch is not None]
    sure = min(lattice.rows, lattice.columns) >= 3 and max(pitches) <= 1.1 * min(pitches)
    level: Level = "error" if sure or 1 in (sample.rows, sample.columns) else "warning"
    if is_gap:
        level, mend = "warning", f'{mend}; or the model says spacing_is = "gap", the gap between chips'
    yield Told(InputError(f"{shot.file}: pitch", value, allowed, mend), level)
