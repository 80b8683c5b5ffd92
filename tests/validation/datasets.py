"""Small data sets for tests: two images with camera noise, a spectrum, a far field; right in every word and number.

The light is a closed formula, no model of the project's: Lambert spots above their chips, with a dark centre.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from validation.dataset.folder import write_sums
from validation.dataset.images import write_tiff

Real = NDArray[np.float64]

PIXELS, PIXEL_UM = 96, 24.0
GAIN, READ_NOISE_E, BLACK_DN, PEAK_DN = 0.05, 6.0, 64.0, 3000.0

MANIFEST = """schema = "luxloop-dataset/1"
name = "two images, a spectrum, a far field"
licence = "CC0-1.0"
notes = ""

[camera]
pixel_um = 24.0
bit_depth = 12
gain_dn_per_e = 0.05
read_noise_e = 6.0
full_well_e = 78000
black_level_dn = 64.0

[[samples]]
id = "one"
layout = "single"
distance_um = 180.0
width_um = 40.0
spacing_um = 400.0
thickness_um = 20.0
dbr_pairs = 5.5

[[samples]]
id = "many"
layout = "array"
rows = 3
columns = 5
distance_um = 180.0
width_um = 40.0
spacing_um = 400.0
thickness_um = 20.0
dbr_pairs = 5.5

[[films]]
id = "film"
layers = [{ material = "GaN", thickness_nm = 5600.0 }]

[[shots]]
id = "single"
kind = "image"
sample = "one"
file = "images/single.tif"
dark = "dark/dark.tif"
flat = "flat/flat.tif"
mask = "masks/mask.tif"
exposure_ms = 8.0

[[shots]]
id = "array"
kind = "image"
sample = "many"
file = "images/array.tif"
exposure_ms = 4.0

[[shots]]
id = "transmission"
kind = "spectrum"
film = "film"
quantity = "T"
file = "spectra/t.csv"

[[shots]]
id = "goniometer"
kind = "far_field"
sample = "one"
file = "far/g.csv"
"""
SPECTRUM = "wavelength_nm,aoi_deg,polarisation,value,sigma\n440,0,u,0.71,0.005\n445,0,u,0.72,0.005\n"
FAR_FIELD = "theta_deg,phi_deg,value,sigma\n0,0,1.0,0.01\n30,0,0.9,0.01\n60,0,0.5,0.01\n"


def light(rows: int = 1, columns: int = 1, pixels: int = PIXELS, pixel_um: float = PIXEL_UM) -> Real:
    """Light (row, column) of chips 400 um apart, 170 um below the receiver, at most 1."""
    at = (np.arange(pixels) - (pixels - 1) / 2) * pixel_um
    chips = [
        (400.0 * (i - (rows - 1) / 2), 400.0 * (j - (columns - 1) / 2)) for i in range(rows) for j in range(columns)
    ]
    total = np.zeros((pixels, pixels))
    for y, x in chips:
        r2 = ((at[:, None] - y) ** 2 + (at - x) ** 2) / 170.0**2
        total += (1.0 - 0.3 * np.exp(-4.0 * r2)) / (1.0 + r2) ** 2
    return np.asarray(total / total.max())


def photographed(signal_dn: Real, seed: int, frames: int = 1) -> NDArray[np.uint16]:
    """Raw numbers of a camera for an expected signal above black: photons, read noise, rounding; frames averaged."""
    rng = np.random.default_rng(seed)
    electrons = rng.poisson(signal_dn / GAIN * frames) / frames
    noise = rng.normal(0.0, READ_NOISE_E / np.sqrt(frames), signal_dn.shape)
    return np.clip(np.round(BLACK_DN + GAIN * (electrons + noise)), 0, 4095).astype(np.uint16)


def write_dataset(folder: Path) -> Path:
    """Write the data set into a folder; returns it."""
    write_tiff(folder / "images/single.tif", photographed(PEAK_DN * light(), 1))
    write_tiff(folder / "images/array.tif", photographed(PEAK_DN * light(3, 5), 2))
    write_tiff(folder / "dark/dark.tif", photographed(np.zeros((PIXELS, PIXELS)), 3))
    write_tiff(folder / "flat/flat.tif", np.full((PIXELS, PIXELS), 1000.0, np.float32))
    mask = np.ones((PIXELS, PIXELS), np.uint8)
    mask[:5, :7] = 0
    write_tiff(folder / "masks/mask.tif", mask)
    for name, text in (("dataset.toml", MANIFEST), ("spectra/t.csv", SPECTRUM), ("far/g.csv", FAR_FIELD)):
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_text(text, encoding="utf-8")
    write_sums(folder)
    return folder


def edit(folder: Path, old: str, new: str, file: str = "dataset.toml") -> None:
    """An edit of a text file by hand; the hashes are written anew."""
    text = (folder / file).read_text(encoding="utf-8")
    assert old in text
    (folder / file).write_text(text.replace(old, new, 1), encoding="utf-8")
    write_sums(folder)


def put(folder: Path, name: str, values: Any, **how: Any) -> None:
    """Another TIFF in the place of one, written by tifffile as it is told; the hashes are written anew."""
    import tifffile

    how.setdefault("photometric", "minisblack")
    tifffile.imwrite(folder / name, values, metadata=None, **how)
    write_sums(folder)
