"""The lattice of chips is found in images of arrays, and nowhere else."""

from __future__ import annotations

import numpy as np
import pytest

from luxloop.errors import InputError
from tests.validation.datasets import photographed
from validation.dataset.lattice import Lattice, find_lattice

Real = np.ndarray


def scene(
    rows: int, columns: int, *, pitch_px: float = 25.0, height_px: float = 11.0, pixels: int = 128, dark: float = 0.5,
    turned_deg: float = 0.5, peak_dn: float = 2500.0, seed: int = 1,
) -> Real:  # fmt: skip
    """A noisy image of chips under a diffuser, dark centres where there is a DBR."""
    y, x = np.indices((pixels, pixels)) - (pixels - 1) / 2
    angle = np.radians(turned_deg)
    x, y = x * np.cos(angle) + y * np.sin(angle), y * np.cos(angle) - x * np.sin(angle)
    total = np.zeros((pixels, pixels))
    for i, j in np.ndindex(rows, columns):
        r2 = (y - (i - (rows - 1) / 2) * pitch_px) ** 2 + (x - (j - (columns - 1) / 2) * pitch_px) ** 2
        total += (1.0 - dark * np.exp(-4.0 * r2 / height_px**2)) / (1.0 + r2 / height_px**2) ** 2
        total += 0.1 * np.exp(-np.sqrt(r2) / (2.0 * height_px))
    return photographed(peak_dn * total / total.max(), seed).astype(float)


def found(image: Real) -> Lattice:
    """The lattice that is there."""
    lattice = find_lattice(image)
    assert lattice is not None
    return lattice


@pytest.mark.parametrize("peak_dn", [300.0, 2500.0])
@pytest.mark.parametrize(("pitch_px", "height_px"), [(25.0, 11.0), (18.75, 10.6), (22.0, 5.0)])
@pytest.mark.parametrize("dark", [0.0, 0.5])
def test_five_by_five_with_a_bright_middle(peak_dn: float, pitch_px: float, height_px: float, dark: float) -> None:
    """Pitch to 4 %, with and without a DBR, bright and dim; all rows and columns where chips stand well apart."""
    lattice = found(scene(5, 5, pitch_px=pitch_px, height_px=height_px, dark=dark, peak_dn=peak_dn))
    assert lattice.pitch_px == pytest.approx(pitch_px, rel=0.04)
    if pitch_px > 2.0 * height_px:
        assert (lattice.rows, lattice.columns) == (5, 5)


def test_rows_and_columns_are_told_apart() -> None:
    """Three chips along y, five along x, and turned over."""
    image = scene(3, 5, height_px=8.0)
    assert (found(image).rows, found(image).columns) == (3, 5)
    assert (found(image.T).rows, found(image.T).columns) == (5, 3)


def test_a_line_of_chips_has_a_pitch_along_it_only() -> None:
    """One row of five."""
    lattice = found(scene(1, 5, height_px=8.0))
    assert lattice.row_pitch_px is None
    assert lattice.column_pitch_px == pytest.approx(25.0, rel=0.04)


def test_dark_bands_and_a_dark_edge_do_not_disturb() -> None:
    """Rows at a third of the light, and a shaded side."""
    image = scene(5, 5)
    image[30:33] = 64.0 + 0.3 * (image[30:33] - 64.0)
    image[:, -6:] = 64.0 + 0.2 * (image[:, -6:] - 64.0)
    assert found(image).pitch_px == pytest.approx(25.0, rel=0.04)


def test_what_is_masked_is_not_looked_at() -> None:
    """Half a chip's worth of hot pixels behind the mask."""
    image, used = scene(5, 5), np.ones((128, 128), np.bool_)
    image[60:70, 20:28], used[60:70, 20:28] = 60_000.0, False
    lattice = find_lattice(image, used)
    assert lattice is not None
    assert lattice.pitch_px == pytest.approx(25.0, rel=0.04)


def test_a_large_image_gives_the_same_pitch() -> None:
    """It is binned first; the pitch is in its own pixels."""
    image = np.kron(scene(5, 5), np.ones((8, 8)))
    assert found(image).pitch_px == pytest.approx(200.0, rel=0.04)


@pytest.mark.parametrize("dark", [0.0, 0.6])
@pytest.mark.parametrize("seed", range(4))
def test_a_single_chip_and_noise_have_none(dark: float, seed: int) -> None:
    """Nothing has a neighbour both ways."""
    for image in (scene(1, 1, dark=dark, seed=seed), photographed(np.full((96, 96), 500.0), seed).astype(float)):
        lattice = find_lattice(image)
        assert lattice is None or None in (lattice.row_pitch_px, lattice.column_pitch_px)


def test_too_small_an_image_is_refused() -> None:
    """Below 16 x 16 pixels nothing can be said."""
    with pytest.raises(InputError, match="16 x 16"):
        find_lattice(np.ones((12, 40)))
    assert find_lattice(np.ones((40, 40))) is None
    for shape in ((16, 4096), (20, 4096), (4096, 20)):  # regression: it was binned to nothing
        find_lattice(np.random.default_rng(1).random(shape))
