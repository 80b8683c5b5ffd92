"""The manifest and the folder: read as specified, written so that reading gives the equal back, hashed, sealed."""

from __future__ import annotations

import hashlib
import subprocess
from pathlib import Path

import pytest

from luxloop.errors import InputError
from luxloop.model_file import find_model
from luxloop.words import parse
from tests.validation.datasets import MANIFEST, edit, write_dataset
from validation.dataset.folder import SUMS, read_dataset, write_sums
from validation.dataset.manifest import FilmLayer, Manifest, Sample
from validation.dataset.manifest_file import manifest_and_faults, parse_manifest, to_toml
from validation.prediction.images import module_of

FILM = """schema = "luxloop-dataset/1"
name = "a polymer on silicon"

[[films]]
id = "brush"
incident = "air"
exit = "Si"
layers = [
  { cauchy = [1.45, 0.005], thickness_nm = 30.0, free = { thickness_nm = [10, 60], a = [1.3, 1.6] } },
  { fixed = [1.46, 0.0], thickness_nm = 1.5 },
]

[[shots]]
id = "psi"
kind = "spectrum"
film = "brush"
quantity = "psi"
file = "psi.csv"
bandwidth_nm = 5.0
"""


def test_what_is_written_reads_back_as_the_equal() -> None:
    """Manifests with images, with films, with remarks."""
    for text in (MANIFEST, FILM):
        manifest = parse_manifest(text.encode())
        assert parse_manifest(to_toml(manifest).encode()) == manifest
    written = to_toml(parse_manifest(MANIFEST.encode()), {'shots["array"].exposure_ms': "check this"})
    assert "exposure_ms = 4.0  # check this\n" in written


def test_defaults_are_those_of_the_format() -> None:
    """One frame, a dark of as many, edge open, gain free, half a pitch beyond the outer chips."""
    manifest = parse_manifest(MANIFEST.encode())
    single, array = manifest.samples
    assert (single.half_um(), array.half_um()) == (2000.0, 1000.0)
    assert {single.edge, manifest.images()[0].frames_averaged} == {"open", 1}
    assert manifest.camera is not None
    assert (manifest.camera.gain_mode, manifest.camera.prnu_percent) == ("free", 0.0)
    assert array.design.dbr_pairs == 5.5


def test_a_spacing_that_is_the_gap_moves_the_edge_and_lets_chips_be_wide() -> None:
    """Half a pitch past the outer chips of S + W; what a model takes for the gap may be below the width."""
    single, array = parse_manifest(MANIFEST.encode()).samples
    assert (single.half_um("gap"), array.half_um("gap")) == (2000.0, 1100.0)
    assert array.model_copy(update={"module_half_um": 1234.0}).half_um("gap") == 1234.0
    wide = Sample.model_validate(array.model_dump() | {"width_um": 100.0, "spacing_um": 80.0})
    assert (wide.pitch_um("gap"), wide.half_um("gap")) == (180.0, 450.0)
    for reading, half_um in (("pitch", 1000.0), ("gap", 1100.0)):
        model = find_model("paper").with_value("environment.spacing_is", reading)
        assert module_of(model, array, lambda *_: None)["array"].half_um == half_um


def test_saturation_is_the_lower_of_full_scale_and_full_well() -> None:
    """0.98 of 4095 DN, or 64 DN + 0.97 of the full well."""
    camera = parse_manifest(MANIFEST.encode()).camera
    assert camera is not None
    assert camera.saturation_dn == pytest.approx(64.0 + 0.97 * 0.05 * 78_000)
    assert camera.model_copy(update={"full_well_e": 1e6}).saturation_dn == pytest.approx(0.98 * 4095)


def test_a_film_may_have_an_unknown_index_and_limits_for_a_fit() -> None:
    """Cauchy or fixed indices, and what a fit may move."""
    first, second = parse_manifest(FILM.encode()).films[0].layers
    assert (first.cauchy, first.free) == ((1.45, 0.005), {"thickness_nm": (10.0, 60.0), "a": (1.3, 1.6)})
    assert second.fixed == (1.46, 0.0)
    with pytest.raises(InputError, match="belong to cauchy"):
        parse(FilmLayer, {"material": "SiO2", "thickness_nm": 2.0, "free": {"a": (1.3, 1.6)}})
    with pytest.raises(InputError, match="exactly one"):
        parse(FilmLayer, {"thickness_nm": 2.0})


def test_images_need_a_camera_and_spectra_do_not() -> None:
    """The section may be missing where nothing is photographed."""
    assert parse_manifest(FILM.encode()).camera is None
    start, end = MANIFEST.index("[camera]"), MANIFEST.index("[[samples]]")
    manifest, faults = manifest_and_faults((MANIFEST[:start] + MANIFEST[end:]).encode())
    assert isinstance(manifest, Manifest)
    assert [fault.field for fault in faults] == ["dataset.toml: camera"]


def test_bytes_that_are_no_manifest_are_refused() -> None:
    """A BOM, another encoding, another schema, no TOML."""
    for raw, allowed in (
        (b"\xef\xbb\xbf" + MANIFEST.encode(), "UTF-8 without one"),
        (MANIFEST.replace('notes = ""', 'notes = "ä"').encode("latin-1"), "UTF-8 text"),
        (MANIFEST.replace("luxloop-dataset/1", "other").encode(), "luxloop-dataset/1"),
        (b"name = ", "TOML"),
    ):
        with pytest.raises(InputError) as refusal:
            parse_manifest(raw)
        assert refusal.value.allowed == allowed


def test_the_hash_is_of_the_manifest_and_of_all_files_it_names(tmp_path: Path) -> None:
    """It moves with a bit of a dark, with a word, and not with a file nobody names."""
    folder = write_dataset(tmp_path)
    first = read_dataset(folder).sha256
    (folder / "unnamed.txt").write_text("x")
    assert read_dataset(folder / "dataset.toml").sha256 == first
    edit(folder, 'notes = ""', 'notes = "x"')
    second = read_dataset(folder).sha256
    raw = bytearray((folder / "dark/dark.tif").read_bytes())
    raw[-1] ^= 1
    (folder / "dark/dark.tif").write_bytes(raw)
    write_sums(folder)
    assert len({first, second, read_dataset(folder).sha256}) == 3


def test_the_list_of_hashes_is_one_that_other_programs_read(tmp_path: Path) -> None:
    """`sha256sum --check` agrees; the list has every file but itself."""
    folder = write_dataset(tmp_path)
    lines = dict(line.split("  ")[::-1] for line in (folder / SUMS).read_text().splitlines())
    assert lines["dataset.toml"] == hashlib.sha256((folder / "dataset.toml").read_bytes()).hexdigest()
    assert len(lines) == sum(path.is_file() for path in folder.rglob("*")) - 1
    done = subprocess.run(["sha256sum", "--check", "--quiet", SUMS], cwd=folder, check=False)
    assert done.returncode == 0


def test_a_folder_that_is_none_is_refused(tmp_path: Path) -> None:
    """No folder; a folder without a manifest."""
    with pytest.raises(InputError, match=r"a folder with a dataset\.toml"):
        read_dataset(tmp_path / "nowhere")
    with pytest.raises(InputError, match=r"a folder with a dataset\.toml|a file in the folder"):
        read_dataset(tmp_path)
