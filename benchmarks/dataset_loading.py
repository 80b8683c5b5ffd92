"""Time and memory to load, check and show a data set of six camera images of 2048 x 2048 pixels.

    python benchmarks/dataset_loading.py

Warm files, one thread. Memory: the most that Python and numpy hold at a time (tracemalloc), in a run of its own.
"""

from __future__ import annotations

import os

os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"))

import tempfile
import time
import tracemalloc
from collections.abc import Callable
from pathlib import Path

import numpy as np
import tifffile

from validation.dataset.checks import check
from validation.dataset.folder import read_dataset, write_sums
from validation.measured import measured_images

PIXELS, PIXEL_UM, IMAGES = 2048, 1.5, 6
HEAD = """schema = "luxloop-dataset/1"
name = "six large images"
[camera]
pixel_um = 1.5
bit_depth = 12
gain_dn_per_e = 0.05
read_noise_e = 6.0
full_well_e = 78000
black_level_dn = 64.0
[[samples]]
id = "array"
layout = "array"
rows = 5
columns = 5
distance_um = 180.0
width_um = 40.0
spacing_um = 400.0
thickness_um = 20.0
dbr_pairs = 5.5
"""
SHOT = '[[shots]]\nid = "{0}"\nkind = "image"\nsample = "array"\nfile = "{0}.tif"\nexposure_ms = 8.0\n'
CORRECTED = 'dark = "dark.tif"\nflat = "flat.tif"\nmask = "mask.tif"\n'


def write(folder: Path, corrected: bool) -> None:
    """The data set, each image drawn anew; with `corrected` all have one dark, flat and mask."""
    rng = np.random.default_rng(1)
    at = (np.arange(PIXELS) - (PIXELS - 1) / 2) * PIXEL_UM
    light = np.zeros((PIXELS, PIXELS))
    for y, x in np.ndindex(5, 5):
        light += 1.0 / (1.0 + ((at[:, None] - 400 * (y - 2)) ** 2 + (at - 400 * (x - 2)) ** 2) / 170.0**2) ** 2
    signal = 3000.0 * light / light.max()
    for number in range(IMAGES):
        raw = rng.normal(64.0 + signal, np.sqrt(0.05 * signal + 0.17))
        tifffile.imwrite(folder / f"{number}.tif", np.round(raw).astype(np.uint16))
    tifffile.imwrite(folder / "dark.tif", np.round(rng.normal(64.0, 0.5, light.shape)).astype(np.uint16))
    tifffile.imwrite(folder / "flat.tif", (1.0 + 0.2 * light / light.max()).astype(np.float32))
    tifffile.imwrite(folder / "mask.tif", np.ones(light.shape, np.uint8))
    shots = (SHOT.format(number) + (CORRECTED if corrected else "") for number in range(IMAGES))
    (folder / "dataset.toml").write_text(HEAD + "".join(shots))
    write_sums(folder)


def measured(work: Callable[[Path], object], folder: Path) -> tuple[float, float]:
    """Best of three in s, and the memory it takes in MB."""
    times = []
    for _ in range(3):
        start = time.perf_counter()
        work(folder)
        times.append(time.perf_counter() - start)
    tracemalloc.start()
    work(folder)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    return min(times), most / 2**20


def load(folder: Path) -> object:
    """What `compare` loads, the hashes aside."""
    return measured_images(read_dataset(folder))


def hashes(folder: Path) -> object:
    """Manifest read, every file hashed."""
    return read_dataset(folder)


def main() -> None:
    """Print the table."""
    print(f"{IMAGES} images of {PIXELS} x {PIXELS} uint16, bins of 25 um = 16 x 16 pixels")
    for corrected in (False, True):
        with tempfile.TemporaryDirectory() as name:
            write(Path(name), corrected)
            for label, work in (("read and hash", hashes), ("read, hash, load, bin", load), ("check", check)):
                seconds, megabytes = measured(work, Path(name))
                kind = "dark, flat, mask" if corrected else "raw"
                print(f"{kind:18}{label:24}{seconds:8.2f} s {megabytes:8.0f} MB")


if __name__ == "__main__":
    main()
