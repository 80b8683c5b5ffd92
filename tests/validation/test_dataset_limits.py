"""Tables and files that no reader or prediction can take: each is told, none ends in a traceback."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from luxloop.errors import InputError
from luxloop.film import GRAZING_DEG, MAX_PLACES, MAX_VALUES, FilmMeasurementRequest
from luxloop.model import Model
from tests.validation.datasets import FAR_FIELD, MANIFEST, SPECTRUM, edit, put, write_dataset
from validation.dataset import spectra as tables
from validation.dataset.checks import Finding, check
from validation.dataset.folder import read_dataset, write_sums
from validation.dataset.images import read_tiff
from validation.dataset.manifest import FilmLayer, FilmSample
from validation.dataset.manifest_file import manifest_and_faults
from validation.dataset.sheet import read_sheet
from validation.dataset.simulation_plan import read_plan
from validation.measured import measured_images
from validation.prediction.spectra import predict, stack_of
from validation.prediction.words import Curve

HEADER = SPECTRUM.splitlines()[0]
FILM = FilmSample(id="film", layers=(FilmLayer(material="GaN", thickness_nm=5600.0),))
UNREADABLE = {
    "open quote": '"' + 131_100 * "x",
    "open quote over lines": '"' + 20_000 * "440,0,u\n",
    "bare CR": "440,0,u\r441,0,u",
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A data set with nothing wrong."""
    return write_dataset(tmp_path)


def only(folder: Path, text: str, file: str = "spectra/t.csv") -> Finding:
    """The one finding of a data set with this text for a table."""
    (folder / file).write_text(text, encoding="utf-8", newline="")
    write_sums(folder)
    (told,) = check(folder)
    assert told.file == file
    return told


def spectrum(wavelengths_nm: np.ndarray, angles_deg: np.ndarray) -> str:
    """A spectrum with a row for each pair of the two."""
    pairs = zip(wavelengths_nm.tolist(), angles_deg.tolist(), strict=True)
    return "\n".join([HEADER, *(f"{wave!r},{angle!r},u,0.5,0.01" for wave, angle in pairs)]) + "\n"


@pytest.mark.parametrize("case", UNREADABLE)
def test_rows_that_cannot_be_cut_into_cells_are_told(folder: Path, case: str) -> None:
    """At the line where they begin, of a spectrum, of a far field, and of an import's table."""
    for text, file in ((SPECTRUM, "spectra/t.csv"), (FAR_FIELD, "far/g.csv")):
        told = only(folder, text + UNREADABLE[case], file)
        assert told.field == f"line {text.count(chr(10)) + 1}"
        assert told.mend == "a quotation mark that is not closed, or line ends of two kinds"
        (folder / file).write_text(text, encoding="utf-8")
    (folder / "t.csv").write_text(f"file,sample,layout\n{UNREADABLE[case]}", newline="")
    with pytest.raises(InputError, match=r"t\.csv: line 2: .*not closed, or line ends of two kinds"):
        read_sheet(folder / "t.csv")


def test_a_header_with_two_kinds_of_line_ends_is_told(folder: Path) -> None:
    """A CR behind a column's name, or no other line end at all."""
    assert only(folder, SPECTRUM.replace("_nm,", "_nm\r,")).field == "line 1"
    (folder / "t.csv").write_text("file,sample\ra.tif,a\r", newline="")
    with pytest.raises(InputError, match=r"t\.csv: line 1: .*line ends of two kinds"):
        read_sheet(folder / "t.csv")


def test_rows_beyond_the_most_are_told(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """They were not read, and nobody knew."""
    monkeypatch.setattr(tables, "MAX_ROWS", 3)
    rows = SPECTRUM + "450,0,u,0.7,0.01\n"
    (folder / "spectra/t.csv").write_text(f"{rows}\n,,,,\n")
    write_sums(folder)
    assert check(folder) == []
    told = only(folder, f"{rows}455,0,u,0.7,0.01\n")
    assert (told.field, told.allowed, told.mend) == ("rows", "at most 3 rows", "thin it out")


BAD_LINES = {
    "cells": "x\n",
    "numbers": "x,x,u,0.5,0.01\n",
    "polarisation": "440,0,q,0.5,0.01\n",
    "angle": "440,120,u,0.5,0.01\n",
    "again": "440,0,u,0.5,0.01\n",
}


@pytest.mark.parametrize("kind", BAD_LINES)
def test_of_very_many_faults_the_first_are_told(folder: Path, kind: str) -> None:
    """A thousand of one file, and that there are more; the memory holds no more of them either."""
    path = folder / "spectra/t.csv"
    path.write_text(HEADER + "\n" + BAD_LINES[kind] * 3000)
    faults = tables.spectrum_and_faults(path, "t.csv", "R")[1]
    assert len(faults) == tables.MAX_FAULTS + 1 == 1001
    assert (faults[-1].field, faults[-1].value) == ("t.csv: faults", "more than 1,000")
    write_sums(folder)
    assert "faults" in [finding.field for finding in check(folder)]
    far = folder / "far.csv"
    far.write_text(FAR_FIELD.splitlines()[0] + "\n" + "95,0,1,0\n" * 3000)
    assert len(tables.far_field_and_faults(far, "far.csv")[1]) == tables.MAX_FAULTS + 1


MANY = np.linspace(400.0, 700.0, 10_001)
TOO_MUCH = {
    "grazing": (np.array([440.0]), np.array([90.0]), "line 2: aoi_deg"),
    "wavelengths": (MANY, 0.0 * MANY, "wavelength_nm"),
    "angles": (0.0 * MANY + 440.0, MANY / 10.0, "aoi_deg"),
    "grid": (MANY[:4000], MANY[:4000] / 10.0, "rows"),
}


@pytest.mark.parametrize("case", TOO_MUCH)
def test_a_spectrum_that_no_worker_predicts_is_told(folder: Path, case: str) -> None:
    """Where it is read; before, the comparison ended in a traceback."""
    wavelengths_nm, angles_deg, field = TOO_MUCH[case]
    assert only(folder, spectrum(wavelengths_nm, angles_deg)).field == field


def test_the_largest_spectrum_that_a_worker_predicts_is_read(folder: Path) -> None:
    """Of each polarisation, for which it is asked by itself."""
    s, p = (spectrum(MANY[at : at + 1000], MANY[at : at + 1000] / 10.0) for at in (0, 1000))
    (folder / "spectra/t.csv").write_text(s.replace(",u,", ",s,") + "".join(p.splitlines(True)[1:]).replace("u", "p"))
    write_sums(folder)
    assert check(folder) == []


def test_the_limits_of_tables_are_those_of_a_request() -> None:
    """To the last wavelength and angle."""

    def taken(wavelengths: int, angles: int, most_deg: float = tables.LIMITS["aoi_deg"][1] - 1e-9) -> bool:
        words: dict[str, Any] = {"stack": stack_of(FILM), "quantity": "R"}
        words["wavelength_nm"] = np.linspace(*tables.LIMITS["wavelength_nm"], wavelengths).tolist()
        words["aoi_deg"] = np.linspace(tables.LIMITS["aoi_deg"][0], most_deg, angles).tolist()
        try:
            FilmMeasurementRequest(**words)
        except ValueError:
            return False
        return True

    most, grid = MAX_PLACES, MAX_VALUES
    assert (tables.MAX_PLACES, tables.MAX_VALUES, tables.LIMITS["aoi_deg"][1]) == (most, grid, GRAZING_DEG)
    assert taken(most, grid // most)
    assert taken(grid // most, most)
    assert not taken(most + 1, 1)
    assert not taken(1, most + 1)
    assert not taken(grid // 1000 + 1, 1000)
    assert not taken(1, 2, tables.LIMITS["aoi_deg"][1])


def test_a_far_field_of_the_back_is_told(folder: Path) -> None:
    """Modules are predicted on their front side, 0 to 90 deg from the normal."""
    told = only(folder, FAR_FIELD.replace("60,0", "120,0"), "far/g.csv")
    assert (told.field, told.allowed) == ("line 4: theta_deg", "0 to 90")
    (folder / "far/g.csv").write_text(FAR_FIELD.replace("60,0", "90,0"))
    write_sums(folder)
    assert check(folder) == []


def curve(wavelengths_nm: np.ndarray, angles_deg: np.ndarray) -> Curve:
    """A curve with a row for each pair of the two."""
    return Curve(FILM, "R", wavelengths_nm, angles_deg, ["u"] * len(angles_deg))


def asked(requests: Sequence[FilmMeasurementRequest]) -> list[Any]:
    """Answers whose values are the angles; refuses what a worker would."""
    for one in requests:
        FilmMeasurementRequest.model_validate(one.model_dump())
    return [
        SimpleNamespace(arrays={"value": np.broadcast_to(one.aoi_deg, (len(one.wavelength_nm), len(one.aoi_deg)))})
        for one in requests
    ]


def test_a_curve_that_no_worker_predicts_is_bad_input() -> None:
    """Also where it comes from no table."""
    with pytest.raises(InputError, match="film: aoi_deg"):
        predict(Model(name="plain"), [curve(np.array([440.0]), np.array([90.0]))], (), asked)


def test_curves_are_asked_for_together_only_as_far_as_one_request_goes() -> None:
    """Two of one film and the same 2,000 wavelengths, under 400 angles each."""
    wavelengths_nm = np.linspace(400.0, 700.0, 2000)
    curves = [curve(wavelengths_nm, np.arange(2000) % 400 * 0.1 + start) for start in (0.0, 0.05)]
    sizes: list[int] = []

    def ask(requests: Sequence[FilmMeasurementRequest]) -> list[Any]:
        sizes.extend(len(one.aoi_deg) for one in requests)
        return asked(requests)

    found = predict(Model(name="plain"), curves, (), ask)
    assert sizes == [400, 400]
    for one, predicted in zip(curves, found, strict=True):
        np.testing.assert_array_equal(predicted.value, one.aoi_deg)


@pytest.mark.parametrize("pixels", [97, 3])
@pytest.mark.parametrize("kind", ["dark/dark", "flat/flat", "masks/mask"])
def test_another_size_than_the_images_is_refused_however_it_is_binned(folder: Path, kind: str, pixels: int) -> None:
    """By 4, 96 and 97 pixels both are 24 bins, and 3 pixels are none."""
    helpers = 'dark = "dark/dark.tif"\nflat = "flat/flat.tif"\nmask = "masks/mask.tif"'
    put(folder, f"{kind}.tif", np.full((pixels, pixels), 64, np.uint16))
    edit(folder, helpers, next(line for line in helpers.splitlines() if kind in line))
    told = rf"{kind}\.tif: size: got '{pixels} x {pixels} pixels', allowed: 96 x 96 pixels"
    with pytest.raises(InputError, match=told):
        measured_images(read_dataset(folder), 100.0)


def test_an_image_smaller_than_a_bin_is_refused(folder: Path) -> None:
    """Before its flat, as small, is binned."""
    for name in ("images/single", "flat/flat"):
        put(folder, f"{name}.tif", np.arange(9, dtype=np.uint16).reshape(3, 3) + np.uint16(64))
    edit(folder, 'dark = "dark/dark.tif"\nflat = "flat/flat.tif"\nmask = "masks/mask.tif"', 'flat = "flat/flat.tif"')
    with pytest.raises(InputError, match=r"images/single\.tif: size: .*at least 4 x 4 pixels"):
        measured_images(read_dataset(folder), 100.0)


ENDLESS = {
    "digits": "9" * 5000,
    "hex digits": "0x" + "f" * 5000,
    "brackets": "[" * 3000 + "]" * 3000,
}


@pytest.mark.parametrize("case", ENDLESS)
def test_a_value_without_end_is_told(tmp_path: Path, case: str) -> None:
    """Of a data set, and of a plan to simulate one: file, line, what a line may hold."""
    text, mend = MANIFEST.replace("bit_depth = 12", f"bit_depth = {ENDLESS[case]}"), "at most 4,300 digits; brackets"
    manifest, (fault,) = manifest_and_faults(text.encode())
    assert (manifest, fault.field) == (None, f"dataset.toml: line {text.split('bit_depth')[0].count(chr(10)) + 1}")
    assert mend in fault.mend
    (tmp_path / "plan.toml").write_text(f"name = {ENDLESS[case]}\n")
    with pytest.raises(InputError, match=rf"plan\.toml: line 1: got 'name = .*{mend}"):
        read_plan(tmp_path / "plan.toml")


@pytest.mark.parametrize("file", ["images/single.tif", "masks/mask.tif"])
def test_a_file_saved_turned_is_told(folder: Path, file: str) -> None:
    """Its tag says that its rows begin at the bottom; 1, as they lie, is as good as no tag."""
    values = np.asarray(read_tiff(folder / file, file, ("uint8", "uint16")).values)
    put(folder, file, values, extratags=[(274, "H", 1, 1, True)])
    assert check(folder) == []
    put(folder, file, values, extratags=[(274, "H", 1, 4, True)])
    told = next(one for one in check(folder) if one.file == file)
    assert (told.field, told.value) == ("orientation", "4")
    assert told.mend == "saved turned: save it upright, or strip the tag"
