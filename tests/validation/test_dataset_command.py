"""`luxloop dataset check|import|show`, called as the front door calls them."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
import typer
from typer.testing import CliRunner, Result

from luxloop.errors import InputError
from tests.validation.datasets import PEAK_DN, edit, light, photographed, write_dataset
from validation import dataset_command
from validation.dataset.folder import read_dataset
from validation.measured import measured_images

WAFER = Path(__file__).parents[2] / "examples" / "wafer"

CAMERA = ("--pixel-um", "24", "--bit-depth", "12", "--gain-dn-per-e", "0.05", "--read-noise-e", "6")
DESIGN = ("--distance-um", "180", "--width-um", "40", "--thickness-um", "20", "--dbr-pairs", "5.5")
LMK = b"Typ=Pic98::TPlane<float>\r\nLines=%d\r\nColumns=%d\r\nFirstLine=1\r\nFirstColumn=1\r\n\0"


def run(*argv: str | Path) -> Result:
    """The outcome of `luxloop dataset ARGV`."""
    app = typer.Typer(pretty_exceptions_enable=False)
    for command in (dataset_command.check, dataset_command.show):
        app.command()(command)
    app.command("import")(dataset_command.import_)
    return CliRunner().invoke(app, [str(one) for one in argv])


def told(*argv: str | Path, code: int = 0) -> dict[str, Any]:
    """The one JSON object on stdout."""
    result = run(*argv, "--json")
    assert result.exit_code == code, (result.output, result.exception)
    return dict(json.loads(result.stdout))


def refusal(*argv: str | Path) -> InputError:
    """The bad input that is told of."""
    result = run(*argv)
    assert isinstance(result.exception, InputError), result.output
    return result.exception


@pytest.fixture
def raw(tmp_path: Path) -> Path:
    """A folder as a camera leaves it: row 0 at the top, so the array's lowest y is its last row."""
    folder = tmp_path / "raw"
    (folder / "more").mkdir(parents=True)
    tifffile.imwrite(folder / "single.tif", photographed(PEAK_DN * light(), 1)[::-1])
    tifffile.imwrite(folder / "more" / "array 1.tif", lopsided()[::-1])
    return folder


def lopsided() -> np.ndarray:
    """An array's image, row 0 at the lowest y, brighter at high y."""
    return photographed(np.linspace(0.5, 1.0, 96)[:, None] * PEAK_DN * light(3, 5), 2)


def test_check_says_nothing_wrong_and_ends_with_0(tmp_path: Path) -> None:
    """And lists, and ends with 2, where something is."""
    folder = write_dataset(tmp_path)
    assert "nothing wrong" in run("check", folder).stdout
    assert told("check", folder) == {"dataset": str(folder), "errors": 0, "warnings": 0, "findings": []}
    edit(folder, "exposure_ms = 8.0", "exposure_ms = 0")
    (finding,) = told("check", folder, code=2)["findings"]
    assert set(finding) == {"level", "file", "field", "value", "allowed", "mend"}
    result = run("check", folder)
    assert "error: dataset.toml: shots" in result.stdout
    assert "1 error, 0 warnings" in result.stdout


def test_check_seals_what_was_changed_on_purpose(tmp_path: Path) -> None:
    """A warning before, nothing after."""
    folder = write_dataset(tmp_path)
    (folder / "readme.txt").write_text("hello")
    assert told("check", folder)["warnings"] == 1
    said = run("check", folder, "--seal").output
    assert "nothing wrong" in said
    assert "sums are written anew" in said
    assert told("check", folder)["warnings"] == 0


def test_check_seals_no_folder_that_is_no_data_set(tmp_path: Path) -> None:
    """A home folder would get the hashes of all that is in it: nothing is written."""
    (tmp_path / "letter.txt").write_text("mine")
    assert refusal("check", tmp_path, "--seal").field == "dataset.toml"
    assert [path.name for path in tmp_path.iterdir()] == ["letter.txt"]


def test_check_knows_the_tables_of_materials_and_says_that_a_seal_mends_nothing(tmp_path: Path) -> None:
    """A film of a misspelt material: an error by the place in the manifest, also after it was sealed."""
    folder = tmp_path / "wafer"
    shutil.copytree(WAFER, folder)
    manifest = folder / "dataset.toml"
    manifest.write_text(manifest.read_text().replace('"GaN"', '"GaNN"'))
    found = told("check", folder, "--seal", code=2)
    assert [one["field"] for one in found["findings"]] == ['films["wafer"].layers.0.material']
    assert "did you mean GaN?" in found["findings"][0]["mend"]
    assert "the errors stay" in run("check", folder, "--seal").output


def test_check_counts_the_guesses_that_still_stand(tmp_path: Path) -> None:
    """What an import guessed is no error, but it is told until somebody has looked."""
    folder = write_dataset(tmp_path)
    manifest = folder / "dataset.toml"
    manifest.write_text(manifest.read_text().replace("read_noise_e", "# check this: guessed\nread_noise_e", 1))
    assert "1 lines of dataset.toml still say 'check this'" in run("check", folder).output


def test_show_tells_camera_samples_and_shots(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Counts, shares and signal to noise; one row a shot."""
    monkeypatch.delenv("COLUMNS", raising=False)
    folder = write_dataset(tmp_path)
    shown = told("show", folder)
    single, array = shown["images"]
    assert single["masked_percent"] == pytest.approx(100.0 * 35 / 96**2)
    assert array["snr_bright"] == pytest.approx(np.sqrt(array["peak_dn"] / 0.05), rel=0.02)
    assert shown["sha256"] == read_dataset(folder).sha256
    text = run("show", folder).stdout
    for word in ("array 3 x 5", "gain_dn_per_e 0.05", "transmission", "goniometer"):
        assert word in text


def test_shares_of_an_image_are_of_all_its_pixels(tmp_path: Path) -> None:
    """96 pixels in bins of 5: the share was of the 95 that bins hold, while the count is of all."""
    folder = write_dataset(tmp_path)
    edit(folder, "pixel_um = 24.0", "pixel_um = 5.0")
    single, _ = told("show", folder)["images"]
    assert (single["binning"], single["pixels"]) == (5, [19, 19])
    assert single["masked_percent"] == pytest.approx(100.0 * 35 / 96**2)


def test_show_is_as_wide_as_columns_say(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also into a pipe."""
    folder = write_dataset(tmp_path)
    monkeypatch.setenv("COLUMNS", "60")
    assert max(map(len, run("show", folder).stdout.splitlines())) == 60


def test_import_asks_for_everything_that_is_missing_at_once(raw: Path, tmp_path: Path) -> None:
    """The camera's numbers and the samples' designs, by their options; nothing is written."""
    error = refusal("import", raw, "--into", tmp_path / "data", "--pixel-um", "24", "--layout", "array")
    for word in ("--bit-depth", "--gain-dn-per-e", "--read-noise-e", "--rows", "--distance-um", "--dbr-pairs"):
        assert word in error.allowed
    assert "--pixel-um" not in error.allowed
    assert "--write-table" in error.mend
    assert not (tmp_path / "data").exists()


def test_import_by_a_table_gives_a_data_set_with_nothing_wrong(raw: Path, tmp_path: Path) -> None:
    """The table is written, filled in, read; images are flipped, and that is on record; guesses say so."""
    table, data = tmp_path / "shots.csv", tmp_path / "data"
    assert told("import", raw, "--write-table", table, *DESIGN)["files"] == ["more/array 1.tif", "single.tif"]
    lines = table.read_text().splitlines()
    lines[1] = lines[1].replace("array 1.tif,,,,,180.0,40.0,,", "array 1.tif,,array,3,5,180.0,40.0,400,")
    lines[2] = lines[2].replace("single.tif,,,", "single.tif,,single,")
    table.write_text("\n".join(lines) + "\n")
    made = told("import", raw, "--into", data, "--table", table, *CAMERA)
    assert (made["images"], made["samples"], made["errors"], made["warnings"]) == (2, 2, 0, 0)
    assert "camera.black_level_dn" in made["to_check"]
    text = (data / "dataset.toml").read_text()
    assert "# check this" in text
    assert "were flipped" in text
    assert [sample.id for sample in read_dataset(data).manifest.samples] == ["array-3x5-5.5", "single-5.5"]
    assert np.array_equal(tifffile.imread(data / "images/more-array-1.tif"), lopsided())
    rows = measured_images(read_dataset(data))[0].signal_dn.mean(axis=1)
    assert rows[48:].sum() > rows[:48].sum()


def test_import_row0_bottom_keeps_the_rows(raw: Path, tmp_path: Path) -> None:
    """And says so in the notes."""
    (raw / "more" / "array 1.tif").unlink()
    result = run("import", raw, "--into", tmp_path / "d", "--row0", "bottom", "--layout", "single", *CAMERA, *DESIGN)
    assert result.exit_code == 0, (result.output, result.exception)
    stored = tifffile.imread(tmp_path / "d" / "images" / "single.tif")
    assert np.array_equal(stored, tifffile.imread(raw / "single.tif"))
    assert "nothing was flipped" in read_dataset(tmp_path / "d").manifest.notes


def test_import_turns_darks_flats_and_masks_too(raw: Path, tmp_path: Path) -> None:
    """All files of one shot lie the same way; a raw flat loses its black level, which comes from the dark."""
    (raw / "more" / "array 1.tif").unlink()
    ramp = np.linspace(0, 1000, 96, dtype=np.uint16)[:, None] + np.full((96, 96), 1064, np.uint16)
    mask = np.ones((96, 96), np.uint8)
    mask[:9] = 0
    tifffile.imwrite(raw / "dark.tif", np.full((96, 96), 60, np.uint16))
    tifffile.imwrite(raw / "flat.tif", ramp)
    tifffile.imwrite(raw / "mask.tif", mask)
    options = ("--layout", "single", *CAMERA, *DESIGN)
    assert (
        "--dark, --flat or --mask for dark.tif, flat.tif, mask.tif"
        in refusal("import", raw, "--into", tmp_path / "d", *options).allowed
    )
    helpers = ("--dark", "dark.tif", "--flat", "flat.tif", "--mask", "mask.tif", "--exposure-ms", "8")
    told("import", raw, "--into", tmp_path / "d", *options, *helpers)
    data = read_dataset(tmp_path / "d")
    shot = data.manifest.images()[0]
    assert data.manifest.camera is not None
    assert data.manifest.camera.black_level_dn == 60.0
    assert shot.flat is not None
    assert shot.mask is not None
    np.testing.assert_allclose(tifffile.imread(data.path(shot.flat)), ramp[::-1] - 60.0)
    assert not tifffile.imread(data.path(shot.mask))[-9:].any()


def test_import_asks_for_a_look_at_the_frames_of_a_dark(raw: Path, tmp_path: Path) -> None:
    """Unless an option or the table says them; what two images share has one guess, the least of their own counts."""
    tifffile.imwrite(raw / "dark.tif", np.full((96, 96), 64, np.uint16))
    table = tmp_path / "t.csv"
    table.write_text("file,frames_averaged,dark_frames_averaged\nmore/array 1.tif,4,\nsingle.tif,1,\n")
    options = ("--table", table, "--layout", "single", *CAMERA, *DESIGN, "--dark", "dark.tif")
    made = told("import", raw, "--into", tmp_path / "a", *options)
    assert made["errors"] == 0
    names = [f'shots["{shot}"].dark_frames_averaged' for shot in ("more-array-1", "single")]
    assert [path for path in made["to_check"] if path.endswith("dark_frames_averaged")] == names
    assert (tmp_path / "a" / "dataset.toml").read_text().count("dark_frames_averaged = 1  # check this") == 2
    made = told("import", raw, "--into", tmp_path / "b", *options, "--dark-frames-averaged", "100")
    assert not set(names) & set(made["to_check"])
    table.write_text("file,frames_averaged,dark_frames_averaged\nmore/array 1.tif,4,50\nsingle.tif,1,\n")
    made = told("import", raw, "--into", tmp_path / "c", *options)
    assert set(names) & set(made["to_check"]) == {names[1]}
    counts = {n: [shot.dark_frames for shot in read_dataset(tmp_path / n).manifest.images()] for n in "bc"}
    assert counts == {"b": [100, 100], "c": [50, 50]}


def test_import_scales_a_raw_flat_before_its_black_is_taken_away(raw: Path, tmp_path: Path) -> None:
    """12 bits shifted up to 16: its black of 1,024 in the file is 64 DN, as the images' is."""
    (raw / "more" / "array 1.tif").unlink()
    flat = np.linspace(1064, 2064, 96, dtype=np.uint16)[:, None] + np.zeros((96, 96), np.uint16)
    for name, values in (("single.tif", tifffile.imread(raw / "single.tif")), ("flat.tif", flat)):
        tifffile.imwrite(raw / name, values * np.uint16(16))
    options = ("--layout", "single", *CAMERA, *DESIGN, "--exposure-ms", "8", "--row0", "bottom")
    shifted = ("--scale", "0.0625", "--black-level-dn", "64", "--flat", "flat.tif")
    told("import", raw, "--into", tmp_path / "d", *options, *shifted)
    data = read_dataset(tmp_path / "d")
    name = data.manifest.images()[0].flat
    assert name is not None
    np.testing.assert_allclose(tifffile.imread(data.path(name)), flat - 64.0)


@pytest.mark.parametrize("kind", ["lmk", "lmk camera", "csv", "semicolons", "tabs"])
def test_import_reads_what_other_programs_write(tmp_path: Path, kind: str) -> None:
    """LMK luminance and camera images, matrices with points or decimal commas; a scale makes them DN."""
    values = photographed(PEAK_DN * light(), 1)
    (tmp_path / "raw").mkdir()
    if kind == "lmk":
        header = LMK % values.shape
        (tmp_path / "raw/a.pf").write_bytes(header + (values / 2.0).astype("<f4").tobytes())
    elif kind == "lmk camera":
        header = (LMK % values.shape).replace(b"<float>", b"<unsigned short>")
        (tmp_path / "raw/a.pf").write_bytes(header + (values // 2).astype("<u2").tobytes())
    else:
        mark = {"csv": ",", "semicolons": ";", "tabs": "\t"}[kind]
        lines = [mark.join(f"{value / 2:.1f}" for value in row) for row in values]
        text = "\n".join(lines) if mark == "," else "\n".join(lines).replace(".", ",")
        (tmp_path / "raw/a.csv").write_text(text + "\n")
    options = ("--layout", "single", "--scale", "2", "--row0", "bottom", *CAMERA, *DESIGN)
    result = run("import", tmp_path / "raw", "--into", tmp_path / "d", *options)
    assert result.exception is None or isinstance(result.exception, SystemExit)
    stored = tifffile.imread(tmp_path / "d/images/a.tif")
    assert stored.dtype == np.float32
    np.testing.assert_allclose(stored, values, atol=1.0 if kind == "lmk camera" else 0.0)


def test_import_reads_a_matrix_below_an_empty_line(tmp_path: Path) -> None:
    """What is between its numbers was looked for in that line."""
    (tmp_path / "raw").mkdir()
    rows = "".join(f"{row},5;{row}\n" for row in range(100, 140))
    (tmp_path / "raw/a.csv").write_text("\n  \n# 1.5 mm, cut\n" + rows)
    options = ("--layout", "single", "--row0", "bottom", *CAMERA, *DESIGN)
    run("import", tmp_path / "raw", "--into", tmp_path / "d", *options)
    assert tifffile.imread(tmp_path / "d/images/a.tif")[1].tolist() == [101.5, 101.0]


@pytest.mark.parametrize("into", [".", "../link"])
def test_import_into_an_empty_folder(raw: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, into: str) -> None:
    """The one that somebody is in, or a link to it: all work was done, and then it failed."""
    (tmp_path / "data").mkdir()
    (tmp_path / "link").symlink_to("data")
    monkeypatch.chdir(tmp_path / "data")
    told("import", raw, "--into", into, "--layout", "single", *CAMERA, *DESIGN)
    assert {path.name for path in Path().iterdir()} == {"dataset.toml", "SHA256SUMS", "images"}
    assert read_dataset(tmp_path / "data").manifest.name == "data"
    assert (tmp_path / "link").is_symlink()


def lmk_of(header: bytes, body: bytes) -> tuple[str, bytes]:
    """An LMK file."""
    return "a.pf", header + body


BAD_FILES = {
    "lmk colour": (
        *lmk_of((LMK % (2, 2)).replace(b"<float>", b"<Pic98::TRGBFloatPixel>"), b"\0" * 48),
        "one channel",
    ),
    "lmk cut": (*lmk_of(LMK % (4, 4), b"\0" * 60), "save it again"),
    "lmk without size": (*lmk_of((LMK % (4, 4)).replace(b"Lines=4", b"Lines="), b"\0" * 64), "save it again"),
    "not lmk": ("a.pf", b"hello", "LMK image"),
    "header in csv": ("a.csv", b"a,b\n1,2\n3,4\n", "header line"),
    "ragged csv": ("a.csv", b"1,2\n3\n", "different lengths"),
    "one line": ("a.csv", b"1,2,3\n", "one row a line"),
    "thousands": ("a.csv", b"1,234,567;1\n2;3\n", "marks between thousands"),
    "thousands and decimals": ("a.csv", b"1.234,5\t1\n2\t3\n", "marks between thousands"),
    "thousands elsewhere": ("a.csv", b"0.5;1\n2;1,234\n", "marks between thousands"),
}


@pytest.mark.parametrize("case", BAD_FILES)
def test_import_refuses_files_it_cannot_read_and_leaves_nothing(tmp_path: Path, case: str) -> None:
    """By the file's name; neither the data set nor a part of it is left."""
    name, content, mend = BAD_FILES[case]
    (tmp_path / "raw").mkdir()
    (tmp_path / "raw" / name).write_bytes(content)
    error = refusal("import", tmp_path / "raw", "--into", tmp_path / "d", "--layout", "single", *CAMERA, *DESIGN)
    assert error.field.startswith(name)
    assert mend in error.mend
    assert [path.name for path in tmp_path.iterdir()] == ["raw"]


@pytest.mark.parametrize(
    ("line", "field"),
    [("file,distance", "line 1"), ("distance_um\n1", "line 1"), ("file,rows\na.tif,2.5", "line 2: rows"),
     ("file,exposure_ms,exposure_ms\na.tif,8,2", "line 1"),
     ("file,width_um\na.tif,4,0", "line 2"), ('file;width_um\na.tif;"4,0"', "line 2: width_um")],
)  # fmt: skip
def test_a_bad_table_is_refused(raw: Path, tmp_path: Path, line: str, field: str) -> None:
    """Unknown columns, one twice, no files, no numbers, decimal commas."""
    (tmp_path / "t.csv").write_text(line + "\n")
    assert field in refusal("import", raw, "--into", tmp_path / "d", "--table", tmp_path / "t.csv").field


def test_an_open_quotation_mark_is_named(raw: Path, tmp_path: Path) -> None:
    """It takes the lines below into one cell: not a decimal comma."""
    (tmp_path / "t.csv").write_text('file,sample,width_um\na.tif,"a,4\nb.tif,b,4\n')
    refused = refusal("import", raw, "--into", tmp_path / "d", "--table", tmp_path / "t.csv")
    assert "not closed" in refused.mend


@pytest.mark.parametrize(("name", "value"), [("bit-depth", "1" + "0" * 400), ("gain-dn-per-e", "0")])
def test_import_refuses_a_camera_that_there_is_not(raw: Path, tmp_path: Path, name: str, value: str) -> None:
    """Before its full well is computed: that ended in a traceback."""
    camera = list(CAMERA)
    camera[camera.index(f"--{name}") + 1] = value
    said = ("--layout", "single", "--spacing-um", "400", "--exposure-ms", "4", *DESIGN)
    error = refusal("import", raw, "--into", tmp_path / "data", *camera, *said)
    assert error.field == f"--{name}"
    assert not (tmp_path / "data").exists()


@pytest.mark.parametrize(
    ("option", "value"),
    [("--exposure-ms", "-1"), ("--distance-um", "-1"), ("--distance-um", "nan"), ("--frames-averaged", "0"),
     ("--full-well-e", "inf"), ("--rows", "0")],
)  # fmt: skip
def test_options_are_looked_at_where_a_table_says_otherwise(
    raw: Path, tmp_path: Path, option: str, value: str
) -> None:
    """The table has that column, so the option is not used; it is refused by name all the same."""
    header = "file,layout,distance_um,width_um,thickness_um,dbr_pairs,exposure_ms,frames_averaged"
    (tmp_path / "t.csv").write_text(f"{header}\nsingle.tif,single,180,40,20,5.5,8,1\n")
    table = ("--table", tmp_path / "t.csv", *CAMERA)
    assert refusal("import", raw, "--into", tmp_path / "d", *table, option, value).field == option
    assert not (tmp_path / "d").exists()
    told("import", raw, "--into", tmp_path / "d", *table)


def test_a_place_where_no_data_set_can_be_made_is_told_by_its_option(raw: Path) -> None:
    """/proc takes no folder, not even of root; the working folder of the import is not named."""
    error = refusal("import", raw, "--into", "/proc/data", "--layout", "single", *CAMERA, *DESIGN)
    assert (error.field, error.value) == ("--into", "/proc/data")
    assert "name a folder where you may write" in error.mend


def test_a_saturated_image_lends_no_black_level(raw: Path, tmp_path: Path) -> None:
    """The option that would say it is named, and where the number came from."""
    (raw / "more" / "array 1.tif").unlink()
    tifffile.imwrite(raw / "single.tif", np.full((96, 96), 4095, np.uint16))
    error = refusal("import", raw, "--into", tmp_path / "d", "--layout", "single", *CAMERA, *DESIGN)
    assert error.field == "--black-level-dn"
    assert "4095 DN, read from the dark" in str(error.value)
    assert "are the images saturated?" in error.mend


def test_links_in_a_ring_are_told(raw: Path, tmp_path: Path) -> None:
    """As a table, as a picture, as a file of a data set."""
    ring = tmp_path / "ring.csv"
    ring.symlink_to(ring)
    assert refusal("import", raw, "--into", tmp_path / "data", "--table", ring, *CAMERA).field == "--table"
    (raw / "ring.tif").symlink_to("ring.tif")
    folder = write_dataset(tmp_path / "set")
    (folder / "images" / "single.tif").unlink()
    (folder / "images" / "single.tif").symlink_to("single.tif")
    assert refusal("show", folder).mend == "its name is spelt otherwise?"
    assert told("check", folder, code=2)["errors"] > 0


def test_import_never_writes_over_anything(raw: Path, tmp_path: Path) -> None:
    """A folder with something in it, a table that is there, a sample of two designs."""
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "x").write_text("x")
    assert refusal("import", raw, "--into", tmp_path / "full").field == "--into"
    assert refusal("import", raw, "--write-table", tmp_path / "full" / "x").field == "--write-table"
    (tmp_path / "t.csv").write_text("file,sample,width_um\nsingle.tif,a,40\nmore/array 1.tif,a,41\n")
    rest = ("--layout", "single", *CAMERA, "--distance-um", "180", "--thickness-um", "20", "--dbr-pairs", "0")
    assert refusal("import", raw, "--into", tmp_path / "d", "--table", tmp_path / "t.csv", *rest).field.endswith(
        "width_um"
    )
