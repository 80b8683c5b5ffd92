"""Everything that `dataset check` must catch: told with file, field, value, what is allowed, and the mend."""

from __future__ import annotations

import importlib.util
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import tifffile

from luxloop.errors import InputError
from tests.validation.datasets import (
    FAR_FIELD,
    MANIFEST,
    PEAK_DN,
    PIXELS,
    SPECTRUM,
    edit,
    light,
    photographed,
    put,
    write_dataset,
)
from validation.dataset.checks import Finding, check
from validation.dataset.folder import MAX_FILE_BYTES, SUMS, read_dataset

SINGLE, ARRAY = "images/single.tif", "images/array.tif"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A data set with nothing wrong."""
    return write_dataset(tmp_path)


def found(folder: Path, level: str = "error") -> list[Finding]:
    """The findings of that level."""
    return [finding for finding in check(folder) if finding.level == level]


def only(folder: Path, level: str = "error") -> Finding:
    """The one finding of that level; it has a value and what is allowed."""
    (finding,) = found(folder, level)
    assert finding.value
    assert finding.allowed
    return finding


def test_a_folder_without_a_manifest_is_told_by_its_name(tmp_path: Path) -> None:
    """Not by that of the file which is not there."""
    (finding,) = check(tmp_path)
    assert (finding.file, finding.value) == ("dataset.toml", str(tmp_path))
    assert "luxloop dataset import makes one" in finding.mend


def test_chips_that_overlap_are_told_by_their_width(folder: Path) -> None:
    """It had been the distance to the receiver. A warning: a model may take spacing_um for the gap between chips."""
    text = (folder / "dataset.toml").read_text(encoding="utf-8")
    head, mark, many = text.partition('id = "many"')
    (folder / "dataset.toml").write_text(head + mark + many.replace("spacing_um = 400.0", "spacing_um = 30.0", 1))
    finding = found(folder, "warning")[0]
    assert finding.field == 'samples["many"].width_um'
    assert (finding.value, finding.mend) == ("40.0", "chips overlap: correct width_um or spacing_um")
    assert "gap" in finding.allowed


def test_an_image_smaller_than_what_it_is_compared_at_asks_for_its_pixel(folder: Path) -> None:
    """A pixel of 0.024 um for 24 um; such an import had nothing wrong, and no comparison could be made."""
    edit(folder, "pixel_um = 24.0", "pixel_um = 0.024")
    fields = {(finding.file, finding.field): finding.mend for finding in found(folder)}
    assert "is pixel_um right?" in fields["images/single.tif", "size"]


def test_a_sigma_that_no_share_can_have_is_told(folder: Path) -> None:
    """Percent beside values that are shares: every model agreed with such data."""
    edit(folder, "440,0,u,0.71,0.005", "440,0,u,0.71,1000", "spectra/t.csv")
    finding = only(folder)
    assert (finding.file, finding.field, finding.value) == ("spectra/t.csv", "sigma", "up to 1000")
    assert "in percent" in finding.mend


def test_the_data_set_to_begin_with_has_nothing_wrong(folder: Path) -> None:
    """Otherwise what follows would show nothing."""
    assert check(folder) == []
    assert read_dataset(folder).manifest.name == "two images, a spectrum, a far field"


WORDS = {
    "unknown key": ("bit_depth = 12", "bit_depth = 12\nbitdepth = 12", "camera.bitdepth", "did you mean bit_depth?"),
    "missing key": ("exposure_ms = 8.0\n", "", 'shots["single"].exposure_ms', "the line is missing"),
    "number in quotes": ("width_um = 40.0", 'width_um = "40,0"', 'samples["one"].width_um', "decimal point"),
    "decimal comma": ("pixel_um = 24.0", "pixel_um = 24,0", "line 7", "write decimals with a point"),
    "duplicate sample": ('id = "many"', 'id = "one"', 'samples["one"].id', "rename one of the two"),
    "duplicate shot": ('id = "array"', 'id = "single"', 'shots["single"].id', "rename one of the two"),
    "unknown sample": ('sample = "many"', 'sample = "meny"', 'shots["array"].sample', "name one that is there"),
    "unknown film": ('film = "film"', 'film = "foil"', 'shots["transmission"].film', "[[films]]"),
    "zero exposure": ("exposure_ms = 8.0", "exposure_ms = 0", 'shots["single"].exposure_ms', ""),
    "no clearance": ("distance_um = 180.0", "distance_um = 24.9", 'samples["one"].distance_um', "below 25"),
    "half a half pair": ("dbr_pairs = 5.5", "dbr_pairs = 5.4", 'samples["one"].dbr_pairs', "nearest: 5.5"),
    "eight bits": ("bit_depth = 12", "bit_depth = 8", "camera.bit_depth", "8 bits are too coarse"),
    "no such kind": ('kind = "far_field"', 'kind = "farfield"', 'shots["goniometer"].kind', "what was measured"),
    "another schema": ("luxloop-dataset/1", "luxloop-dataset/2", "schema", "another luxloop"),
    "no toml": ("[camera]", "[camera", "line 6", ""),
    "two indices": ('material = "GaN"', 'material = "GaN", fixed = [2.4, 0.0]', 'layers[0].material', "e.g."),
    "limits beside": (
        'material = "GaN", thickness_nm = 5600.0',
        "cauchy = [1.5, 0.01], thickness_nm = 30.0, free = { thickness_nm = [31.0, 60.0] }",
        "layers[0].free.thickness_nm",
        "widen the limits",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", WORDS)
def test_a_wrong_word_of_the_manifest_is_told(folder: Path, case: str) -> None:
    """Its place, by ids where there are any, and the mend."""
    old, new, field, mend = WORDS[case]
    edit(folder, old, new)
    told = found(folder)[0]
    assert (told.file, told.field.endswith(field)) == ("dataset.toml", True), told
    assert mend in told.mend
    with pytest.raises(InputError):
        read_dataset(folder)


@pytest.mark.parametrize(
    ("one", "other", "value"),
    [
        ("dark_frames_averaged = 100", "dark_frames_averaged = 16", "16"),
        ("dark_frames_averaged = 100", "", "None"),
        ("", "frames_averaged = 4", "None"),
    ],
)
def test_a_dark_has_one_count_of_frames(folder: Path, one: str, other: str, value: str) -> None:
    """Said differently, or not said where it would be taken from images of different counts; told with the mend."""
    edit(folder, "exposure_ms = 8.0", f"exposure_ms = 8.0\n{one}")
    edit(folder, "exposure_ms = 4.0", f'exposure_ms = 4.0\ndark = "dark/dark.tif"\n{other}')
    (told,) = found(folder)
    assert (told.field, told.value) == ('shots["array"].dark_frames_averaged', value)
    assert "single" in told.allowed
    assert "in all shots that name it" in told.mend


def test_all_faults_of_a_manifest_are_listed(folder: Path) -> None:
    """Not only the first."""
    edit(folder, "exposure_ms = 8.0", "exposure_ms = -1")
    edit(folder, "distance_um = 180.0", "distance_um = 10.0")
    edit(folder, "bit_depth = 12", "bit_dept = 12")
    assert {finding.field for finding in found(folder)} == {
        "camera.bit_dept", "camera.bit_depth", 'samples["one"].distance_um', 'shots["single"].exposure_ms',
    }  # fmt: skip
    with pytest.raises(InputError, match="3 more wrong"):
        read_dataset(folder)


WAYS_OUT = ["/etc/passwd", "../outside.tif", "images/../../outside.tif", "C:/a.tif", "a\\\\b.tif"]


@pytest.mark.parametrize("way", WAYS_OUT)
def test_a_path_that_leaves_the_folder_is_refused(folder: Path, way: str) -> None:
    """Absolute, upwards, of another system."""
    edit(folder, 'file = "images/array.tif"', f'file = "{way}"')
    told = only(folder)
    assert told.field == 'shots["array"].file'
    assert "inside the folder" in told.allowed
    with pytest.raises(InputError, match="inside the folder"):
        read_dataset(folder)


def test_a_link_out_of_the_folder_is_refused(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    """Of a file, and of a folder on the way."""
    outside = tmp_path_factory.mktemp("outside")
    (folder / ARRAY).rename(outside / "array.tif")
    (folder / ARRAY).symlink_to(outside / "array.tif")
    assert "link" in next(one for one in found(folder) if one.file == "dataset.toml").mend
    (folder / ARRAY).unlink()
    (folder / "away").symlink_to(outside)
    edit(folder, 'file = "images/array.tif"', 'file = "away/array.tif"')
    assert "link" in only(folder).mend


def test_missing_files_are_told_each(folder: Path) -> None:
    """An image, a named dark, a spectrum."""
    for name in (ARRAY, "dark/dark.tif", "spectra/t.csv"):
        (folder / name).unlink()
    fields = {one.field for one in found(folder) if one.file == "dataset.toml"}
    assert fields == {'shots["array"].file', 'shots["single"].dark', 'shots["transmission"].file'}
    with pytest.raises(InputError, match="a file in the folder"):
        read_dataset(folder)


def test_a_file_that_is_too_large_is_not_read(folder: Path) -> None:
    """Its size is looked at first."""
    with (folder / ARRAY).open("r+b") as file:
        file.truncate(MAX_FILE_BYTES + 1)
    assert "at most 256 MB" in next(one for one in found(folder) if one.file == "dataset.toml").allowed


def test_wrong_hashes_are_told(folder: Path) -> None:
    """A changed file is an error, a file not listed and no list at all are warnings, a damaged list an error."""
    put_back = (folder / ARRAY).read_bytes()
    (folder / ARRAY).write_bytes(put_back[:-1] + bytes([put_back[-1] ^ 1]))
    assert (only(folder).file, only(folder).field) == (SUMS, ARRAY)
    with pytest.raises(InputError, match="--seal"):
        read_dataset(folder)
    (folder / ARRAY).write_bytes(put_back)
    (folder / "more.txt").write_text("x")
    assert only(folder, "warning").field == "more.txt"
    with (folder / SUMS).open("a") as sums:
        sums.write("not a hash\n")
    assert only(folder).field.startswith("line ")
    (folder / SUMS).unlink()
    assert only(folder, "warning").file == SUMS


def test_a_manifest_edited_by_hand_is_a_warning_until_it_is_sealed(folder: Path) -> None:
    """Its words are checked besides; the data still are what they were."""
    text = (folder / "dataset.toml").read_text()
    (folder / "dataset.toml").write_text(text.replace('notes = ""', 'notes = "edited"'))
    assert only(folder, "warning").field == "dataset.toml"
    assert read_dataset(folder).manifest.notes == "edited"


def grey(peak: float = PEAK_DN, seed: int = 1) -> np.ndarray:
    """The single's image again, otherwise exposed."""
    return photographed(peak * light(), seed)


def rgb(folder: Path) -> None:
    """Three channels."""
    put(folder, SINGLE, np.stack([grey()] * 3, axis=-1), photometric="rgb")


def pages(folder: Path) -> None:
    """Two pages."""
    put(folder, SINGLE, np.stack([grey(), grey()]))


def masked_nan() -> np.ndarray:
    """A NaN amid the image."""
    image = grey().astype(np.float32)
    image[40, 40] = np.nan
    return image


def zero_in_flat(folder: Path) -> None:
    """A dead pixel in the flat that is not masked."""
    flat = np.full((PIXELS, PIXELS), 1000.0, np.float32)
    flat[50, 50] = 0.0
    put(folder, "flat/flat.tif", flat)


def gamma() -> np.ndarray:
    """What a screen's image of it is: the photographed signal to the power of 1/2.2, to full scale."""
    linear = np.clip((photographed(PEAK_DN * light(3, 5), 2) - 64.0) / 4031.0, 0.0, None)
    return np.asarray(np.round(64.0 + 4031.0 * linear ** (1 / 2.2)), np.uint16)


IMAGES: dict[str, tuple[Callable[[Path], object], str, str, str]] = {
    "8 bit": (lambda f: put(f, SINGLE, (grey() // 16).astype(np.uint8)), SINGLE, "dtype", "8-bit"),
    "signed": (lambda f: put(f, SINGLE, grey().astype(np.int16)), SINGLE, "dtype", "signed"),
    "double": (lambda f: put(f, SINGLE, grey().astype(np.float64)), SINGLE, "dtype", "float32"),
    "colour": (rgb, SINGLE, "colour", "grey"),
    "pages": (pages, SINGLE, "pages", "average"),
    "no tiff": (lambda f: (f / SINGLE).write_bytes(b"P5 1 1 255 x"), SINGLE, "format", "TIFF"),
    "cut": (lambda f: (f / SINGLE).write_bytes((f / SINGLE).read_bytes()[:900]), SINGLE, "format", "again"),
    "white is 0": (lambda f: put(f, SINGLE, grey(), photometric="miniswhite"), SINGLE, "photometric", "invert"),
    "above bit depth": (lambda f: put(f, SINGLE, grey() + np.uint16(2000)), SINGLE, "values", "bit_depth"),
    "shifted up": (lambda f: put(f, SINGLE, grey(1000) * np.uint16(2)), SINGLE, "values", "divide"),
    "NaN": (lambda f: put(f, SINGLE, masked_nan()), SINGLE, "values", "mask them"),
    "constant": (lambda f: put(f, SINGLE, np.full((PIXELS, PIXELS), 900, np.uint16)), SINGLE, "values", "constant"),
    "all saturated": (lambda f: put(f, SINGLE, 4090 + grey() % np.uint16(5)), SINGLE, "values", "shorter exposure"),
    "only full scale": (lambda f: put(f, SINGLE, 0 * grey() + 4095), SINGLE, "values", "100 %) saturated"),
    "gamma": (lambda f: put(f, ARRAY, gamma()), ARRAY, "noise", "gamma"),
    "dark size": (lambda f: put(f, "dark/dark.tif", grey()[:-1]), "dark/dark.tif", "size", "crop"),
    "dark brighter": (lambda f: put(f, "dark/dark.tif", grey() + np.uint16(9)), "dark/dark.tif", "values", "exchang"),
    "flat zero": (zero_in_flat, "flat/flat.tif", "values", "mask them"),
    "mask size": (lambda f: put(f, "masks/mask.tif", np.ones((9, 9), np.uint8)), "masks/mask.tif", "size", "crop"),
    "mask all": (lambda f: put(f, "masks/mask.tif", np.zeros((96, 96), np.uint8)), "masks/mask.tif", "values", ""),
    "other size": (lambda f: put(f, ARRAY, grey()[:-2]), ARRAY, "size", "two data sets"),
}  # fmt: skip


@pytest.mark.parametrize("case", IMAGES)
def test_a_bad_image_is_told(folder: Path, case: str) -> None:
    """The file, what about it, and the mend."""
    spoil, file, field, mend = IMAGES[case]
    spoil(folder)
    told = [finding for finding in found(folder) if finding.file == file]
    assert [finding.field for finding in told][:1] == [field], check(folder)
    assert mend in str(told[0])


def test_lzw_without_its_codec_names_the_package(folder: Path) -> None:
    """A package that may be missing is named, with a way that needs none."""
    if importlib.util.find_spec("imagecodecs"):
        pytest.skip("the codec is installed")
    with tifffile.TiffFile(folder / SINGLE, mode="r+") as file:
        file.pages.first.tags["Compression"].overwrite(5)
    told = next(finding for finding in found(folder) if finding.file == SINGLE)
    assert (told.field, told.value) == ("compression", "LZW compression")
    assert "imagecodecs" in told.mend


def test_some_saturated_pixels_are_a_warning(folder: Path) -> None:
    """They are counted and left out."""
    put(folder, SINGLE, grey(4500.0))
    told = only(folder, "warning")
    assert told.file == SINGLE
    assert "saturated" in told.value


def test_a_centre_outside_of_the_image_is_told(folder: Path) -> None:
    """In pixels of the raw file."""
    edit(folder, "exposure_ms = 4.0", "exposure_ms = 4.0\ncentre_px = [48.0, 960.0]")
    assert only(folder).field == "centre_px"


def test_a_fixed_pattern_that_dark_and_flat_know_is_no_noise(folder: Path) -> None:
    """Pixels that differ by 4 % in sensitivity and 10 DN in the dark are warned of only where they are not told."""
    random = np.random.default_rng(4)
    flat = 1.0 + 0.04 * random.standard_normal((PIXELS, PIXELS))
    pattern = np.rint(10.0 * random.standard_normal((PIXELS, PIXELS)))
    many = photographed(PEAK_DN * light(3, 5) * flat, 2) + pattern
    put(folder, ARRAY, np.clip(many, 0, 4095).astype(np.uint16))
    put(folder, "dark/many.tif", (64.0 + pattern).astype(np.uint16))
    put(folder, "flat/many.tif", (1000.0 * flat).astype(np.float32))
    assert [finding.field for finding in found(folder, "warning")] == ["noise"]
    named = 'dark = "dark/many.tif"\ndark_frames_averaged = 100\nflat = "flat/many.tif"\nexposure_ms = 4.0'
    edit(folder, "exposure_ms = 4.0", named)
    assert not found(folder, "warning")
    assert not found(folder)


def test_a_mean_of_many_frames_in_whole_numbers_is_a_warning(folder: Path) -> None:
    """Where averaging left less noise than rounding hides; saved with fractions nothing is told."""
    edit(folder, "exposure_ms = 4.0", "exposure_ms = 4.0\nframes_averaged = 64")
    put(folder, ARRAY, photographed(PEAK_DN * light(3, 5), 2, frames=64))
    told = only(folder, "warning")
    assert "a mean of 64 frames in whole DN" in told.value
    assert "float32" in told.mend


def test_camera_numbers_that_contradict_the_noise_are_a_warning(folder: Path) -> None:
    """A gain ten times too large shows in the image itself."""
    edit(folder, "gain_dn_per_e = 0.05", "gain_dn_per_e = 0.5")
    assert {finding.field for finding in found(folder, "warning")} == {"noise"}


@pytest.mark.parametrize(
    ("old", "new"), [("pixel_um = 24.0", "pixel_um = 12.0"), ("spacing_um = 400.0", "spacing_um = 500.0")]
)
def test_a_pitch_that_contradicts_the_lattice_is_told(folder: Path, old: str, new: str) -> None:
    """By the value that would fit."""
    before, mark, after = MANIFEST.partition('id = "many"')
    text = f"{before}{mark}{after.replace(old, new)}" if old in after else MANIFEST.replace(old, new)
    (folder / "dataset.toml").write_text(text)
    told = [finding for finding in found(folder) if finding.field == "pitch"]
    assert [finding.file for finding in told] == [ARRAY]
    assert "pixel_um = 2" in told[0].mend or "pixel_um = 3" in told[0].mend


def test_a_spacing_may_be_the_gap_between_the_chips_of_the_lattice(folder: Path) -> None:
    """Chips of 120 um, 280 um apart: 400 um from centre to centre, as in the image. Only a model can say so."""
    before, mark, after = MANIFEST.partition('id = "many"')
    wide = after.replace("width_um = 40.0", "width_um = 120.0").replace("spacing_um = 400.0", "spacing_um = 280.0")
    (folder / "dataset.toml").write_text(before + mark + wide)
    assert found(folder) == []
    (told,) = (one for one in found(folder, "warning") if one.field == "pitch")
    assert 'spacing_is = "gap"' in told.mend


def test_a_scale_that_fits_the_gap_alone_is_told(folder: Path) -> None:
    """A fifth off with chips of 40 um: within reach of the other reading, so it may not pass in silence."""
    before, mark, after = MANIFEST.partition('id = "many"')
    (folder / "dataset.toml").write_text(before.replace("pixel_um = 24.0", "pixel_um = 28.8") + mark + after)
    assert "pitch" in {one.field for level in ("warning", "error") for one in found(folder, level)}


def test_swapped_axes_are_told(folder: Path) -> None:
    """Three rows and five columns, in an image of five rows and three columns."""
    put(folder, ARRAY, photographed(PEAK_DN * light(3, 5), 2).T)
    told = only(folder)
    assert (told.file, told.field) == (ARRAY, "lattice")
    assert "swapped axes?" in told.mend


ROW = "440,0,u,0.71,0.005"
BELOW = SPECTRUM[SPECTRUM.index("\n") :]
TABLES = {
    "percent": ("spectra/t.csv", ROW, "440,0,u,71,0.5", "value", "percent"),
    "above one": ("spectra/t.csv", ROW, "440,0,u,1.2,0.005", "line 2: value", ""),
    "negative": ("spectra/t.csv", ROW, "440,0,u,-0.2,0.005", "line 2: value", ""),
    "sigma 0": ("spectra/t.csv", ROW, "440,0,u,0.71,0", "line 2: sigma", "standard deviation"),
    "sigma below": ("spectra/t.csv", ROW, "440,0,u,0.71,-0.1", "line 2: sigma", "standard deviation"),
    "NaN": ("spectra/t.csv", ROW, "440,0,u,nan,0.005", "line 2: value", "remove the row"),
    "decimal comma": ("spectra/t.csv", ROW, "440,0,u,0,71,0,005", "line 2", "decimal comma"),
    "open quote": ("spectra/t.csv", ROW, '440,0,u,"0.71,0.005', "line 3", "not closed"),
    "quoted comma": ("spectra/t.csv", ROW, '440,0,u,"0,71",0.005', "line 2: value", "decimal comma"),
    "semicolons": ("spectra/t.csv", "wavelength_nm,aoi_deg", "wavelength_nm;aoi_deg", "line 1", "commas"),
    "BOM": ("spectra/t.csv", "wavelength_nm", "\ufeffwavelength_nm", "line 1", "no BOM"),
    "duplicate": ("spectra/t.csv", ROW, f"{ROW}\n440.0,0,u,0.7,0.01", "line 3: duplicate", "line 2 has it"),
    "polarisation": ("spectra/t.csv", ROW, "440,0,x,0.71,0.005", "line 2: polarisation", ""),
    "grazing": ("spectra/t.csv", ROW, "440,91,u,0.71,0.005", "line 2: aoi_deg", ""),
    "in um": ("spectra/t.csv", BELOW, "\n1.44,0,u,0.7,0.01\n", "wavelength_nm", "um"),
    "empty": ("spectra/t.csv", BELOW, "\n", "rows", ""),
    "far field sigma": ("far/g.csv", "0,0,1.0,0.01", "0,0,1.0,0", "line 2: sigma", "standard deviation"),
    "far field twice": ("far/g.csv", FAR_FIELD.splitlines()[2], "0,0,1,0.01", "line 3: duplicate", "line 2 has it"),
    "far field columns": ("far/g.csv", "theta_deg,phi_deg", "theta,phi", "line 1", "the first line names them"),
}  # fmt: skip


@pytest.mark.parametrize("case", TABLES)
def test_a_bad_table_is_told(folder: Path, case: str) -> None:
    """The line, the column, the mend; and reading it refuses it too."""
    file, old, new, field, mend = TABLES[case]
    edit(folder, old, new, file)
    told = found(folder)
    assert (told[0].file, told[0].field) == (file, field), told
    assert mend in told[0].mend
    assert "np." not in told[0].value


def test_many_faults_of_a_kind_are_counted_not_listed(folder: Path) -> None:
    """Ten rows without sigma would hide what else is wrong."""
    edit(folder, ROW, "\n".join(f"{400 + n},0,u,0.5,0" for n in range(10)), "spectra/t.csv")
    told = [finding for finding in found(folder) if finding.file == "spectra/t.csv"]
    assert len(told) == 5
    assert "5 more like this" in told[-1].mend


def test_psi_has_no_polarisation_and_stays_in_its_range(folder: Path) -> None:
    """Degrees, its column empty."""
    edit(folder, 'quantity = "T"', 'quantity = "psi"')
    assert {one.field for one in found(folder)} == {"line 2: polarisation", "line 3: polarisation"}
    edit(folder, SPECTRUM, "wavelength_nm,aoi_deg,polarisation,value,sigma\n440,60,,92,0.1\n", "spectra/t.csv")
    assert only(folder).field == "line 2: value"


def test_nothing_warns_on_the_way(folder: Path) -> None:
    """A check is quiet but for its findings, also where the image is dim."""
    put(folder, SINGLE, photographed(3.0 * light(), 4))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert all(finding.level == "warning" for finding in check(folder)), check(folder)
