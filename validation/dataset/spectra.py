"""Spectra, ellipsometric curves and far fields as CSV: a header, a row per value, commas between, decimal points.

    wavelength_nm,aoi_deg,polarisation,value,sigma      R, T in [0, 1]; psi, delta in deg, their polarisation empty
    theta_deg,phi_deg,value,sigma                       a far field, its scale free

A table is read whole: every fault of every line is found, of very many the first; the reader raises the first of all.
Its rows come line by line, whatever their order in the file: wavelengths of one polarisation and angle, thetas of one
phi. What is left of a fit is summed over neighbours.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, islice
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from luxloop.errors import InputError
from luxloop.film import GRAZING_DEG, MAX_PLACES, MAX_VALUES
from validation.dataset.csv_lines import csv_lines
from validation.dataset.images import Real
from validation.dataset.manifest import FarFieldShot, SpectrumShot

SPECTRUM_COLUMNS = ("wavelength_nm", "aoi_deg", "polarisation", "value", "sigma")
FAR_FIELD_COLUMNS = ("theta_deg", "phi_deg", "value", "sigma")
LIMITS = {
    "wavelength_nm": (1.0, 1e6),
    "aoi_deg": (0.0, GRAZING_DEG),
    "theta_deg": (0.0, 90.0),
    "phi_deg": (-360.0, 360.0),
    "R": (0.0, 1.0),
    "T": (0.0, 1.0),
    "psi": (0.0, 90.0),
    "delta": (-180.0, 360.0),
}
BEYOND_UNITY = 0.05
"""R or T may pass 0 or 1 by this, or by 5 sigma: a measured one has noise and a reference."""
PERCENT = 1.5
"""A reflectance or transmittance with a larger value than this is taken for one in percent."""
MAX_ROWS = 1_000_000
MAX_FAULTS = 1000
"""So many of one file are told, and that there are more."""

Quantity = Literal["R", "T", "psi", "delta"]
Row = Mapping[str, str]
Faults = list[InputError]


@dataclass(frozen=True, eq=False)
class SpectrumTable:
    """The columns of a spectrum, one entry a row."""

    wavelength_nm: Real
    aoi_deg: Real
    polarisation: tuple[str, ...]  # s, p, u; empty for psi and delta
    value: Real
    sigma: Real


@dataclass(frozen=True, eq=False)
class FarFieldTable:
    """The columns of a far field, one entry a row."""

    theta_deg: Real
    phi_deg: Real
    value: Real
    sigma: Real


def read_spectrum(path: Path, shot: SpectrumShot) -> SpectrumTable:
    """The spectrum in a file; raises the first of its faults as an InputError."""
    table, faults = spectrum_and_faults(path, shot.file, shot.quantity)
    if table is None or faults:
        raise faults[0]
    return table


def read_far_field(path: Path, shot: FarFieldShot) -> FarFieldTable:
    """The far field in a file; raises the first of its faults as an InputError."""
    table, faults = far_field_and_faults(path, shot.file)
    if table is None or faults:
        raise faults[0]
    return table


def spectrum_and_faults(path: Path, name: str, quantity: Quantity) -> tuple[SpectrumTable | None, Faults]:
    """The spectrum in a file, None where its columns cannot be read, and everything that is wrong with it."""
    rows, of_form = _rows(path, name, SPECTRUM_COLUMNS)
    numbers = {column: _numbers(rows, column) for column in SPECTRUM_COLUMNS if column != "polarisation"}
    polarisation = tuple(row["polarisation"].strip() for _, row in rows)
    faults = _first(
        name,
        of_form,
        *(_no_numbers(rows, column, name) for column in numbers),
        _wrong_polarisation(rows, polarisation, quantity, name),
        _outside(rows, numbers, ("wavelength_nm", "aoi_deg"), name),
        _too_many_places(numbers, np.array(polarisation), name),
        _wrong_unit(rows, numbers["value"], numbers["sigma"], quantity, name),
        _duplicates(rows, ("wavelength_nm", "aoi_deg", "polarisation"), name),
    )
    if not rows or any(not np.isfinite(column).all() for column in numbers.values()):
        return None, faults
    order = np.lexsort((numbers["wavelength_nm"], numbers["aoi_deg"], np.array(polarisation)))
    ordered = {column: values[order] for column, values in numbers.items()}
    return SpectrumTable(polarisation=tuple(polarisation[at] for at in order), **ordered), faults


def far_field_and_faults(path: Path, name: str) -> tuple[FarFieldTable | None, Faults]:
    """The far field in a file, None where its columns cannot be read, and everything that is wrong with it."""
    rows, of_form = _rows(path, name, FAR_FIELD_COLUMNS)
    numbers = {column: _numbers(rows, column) for column in FAR_FIELD_COLUMNS}
    dark = InputError(f"{name}: value", "nothing above 0", "an intensity", "was a background subtracted?")
    faults = _first(
        name,
        of_form,
        *(_no_numbers(rows, column, name) for column in numbers),
        _outside(rows, numbers, ("theta_deg", "phi_deg"), name),
        _duplicates(rows, ("theta_deg", "phi_deg"), name),
        [dark] * bool(rows and not (numbers["value"] > 0.0).any()),
    )
    if not rows or any(not np.isfinite(column).all() for column in numbers.values()):
        return None, faults
    order = np.lexsort((numbers["theta_deg"], numbers["phi_deg"]))
    return FarFieldTable(**{column: values[order] for column, values in numbers.items()}), faults


def _first(name: str, *faults: Iterable[InputError]) -> Faults:
    """The first of all faults of a file; where there are more, one behind them says so."""
    first = list(islice(chain.from_iterable(faults), MAX_FAULTS + 1))
    if len(first) > MAX_FAULTS:
        first[-1] = InputError(f"{name}: faults", f"more than {MAX_FAULTS:,}", "none", "mend these, and check again")
    return first


def _rows(path: Path, name: str, columns: tuple[str, ...]) -> tuple[list[tuple[int, Row]], Faults]:
    """The rows of a CSV with their line numbers, and what is wrong with its form."""
    raw = path.read_bytes()
    faults: Faults = []
    if raw.startswith(b"\xef\xbb\xbf"):
        faults.append(
            InputError(f"{name}: line 1", "a byte order mark", "UTF-8 without one", "save as UTF-8, no BOM")
        )
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        value = raw[error.start : error.start + 8]
        return [], [*faults, InputError(f"{name}: format", value, "UTF-8 text", "save it as UTF-8")]
    header, _, _ = text.partition("\n")
    wanted = ",".join(columns)
    if [word.strip() for word in header.split(",")] != list(columns):
        mend = "columns are separated by commas" if ";" in header or "\t" in header else "the first line names them"
        return [], [*faults, InputError(f"{name}: line 1", header.strip(), wanted, mend)]
    rows: list[tuple[int, Row]] = []
    try:
        for line, cells in islice(csv_lines(text, name), 1, None):
            if not any(cell.strip() for cell in cells):
                continue
            if len(cells) != len(columns):
                faults.append(_wrong_count(f"{name}: line {line}", cells, columns))
                if len(faults) > MAX_FAULTS:
                    break
                continue
            if len(rows) == MAX_ROWS:
                raise InputError(f"{name}: rows", "more", f"at most {MAX_ROWS:,} rows", "thin it out")
            rows.append((line, dict(zip(columns, cells, strict=True))))
    except InputError as error:
        faults.append(error)
    if not rows and not faults:
        faults.append(InputError(f"{name}: rows", 0, "at least one row below the header"))
    return rows, faults


def _wrong_count(where: str, cells: Sequence[str], columns: Sequence[str]) -> InputError:
    comma = len(cells) > len(columns) or any(";" in cell for cell in cells)
    mend = "a decimal comma? write decimals with a point" if comma else "commas between the values"
    if any("\n" in cell for cell in cells):
        mend = "a quotation mark that is not closed"
    return InputError(where, ",".join(cells), f"{len(columns)} values: {','.join(columns)}", mend)


def _numbers(rows: Sequence[tuple[int, Row]], column: str) -> Real:
    """A column as numbers, NaN where it has none."""
    cells = (_number(row[column].strip()) for _, row in rows)
    return np.array([math.nan if isinstance(cell, str) else cell for cell in cells], np.float64)


def _no_numbers(rows: Sequence[tuple[int, Row]], column: str, name: str) -> Iterator[InputError]:
    """What is no finite number, or a sigma not above 0."""
    for line, row in rows:
        cell = row[column].strip()
        number = _number(cell)
        if isinstance(number, str):
            comma = re.fullmatch(r"[-+]?\d+,\d+", cell)
            mend = "a decimal comma: write a point" if comma else "remove the row, or fill it in"
            yield InputError(f"{name}: line {line}: {column}", cell, "a number", mend)
        elif not math.isfinite(number):
            yield InputError(f"{name}: line {line}: {column}", cell, "a finite number", "remove the row")
        elif column == "sigma" and number <= 0.0:
            mend = "give the standard deviation of the value; repeat the measurement to learn it"
            yield InputError(f"{name}: line {line}: sigma", number, "above 0", mend)


def _wrong_polarisation(
    rows: Sequence[tuple[int, Row]], polarisation: Sequence[str], quantity: Quantity, name: str
) -> Iterator[InputError]:
    """Polarisations that the quantity has not."""
    allowed = ("",) if quantity in ("psi", "delta") else ("s", "p", "u")
    for (line, _), one in zip(rows, polarisation, strict=True):
        if one not in allowed:
            say = "nothing" if allowed == ("",) else "s, p or u"
            yield InputError(f"{name}: line {line}: polarisation", one, f"{say} for {quantity}")


def _outside(
    rows: Sequence[tuple[int, Row]], numbers: Mapping[str, Real], columns: tuple[str, ...], name: str
) -> Iterator[InputError]:
    """Wavelengths and angles out of range."""
    for column in columns:
        low, high = LIMITS[column]
        beyond = numbers[column] >= high if column == "aoi_deg" else numbers[column] > high
        allowed = f"{low:g} to {'below ' if column == 'aoi_deg' else ''}{high:g}"
        for at in np.flatnonzero((numbers[column] < low) | beyond).tolist():
            yield InputError(f"{name}: line {rows[at][0]}: {column}", float(numbers[column][at]), allowed)
    wavelengths = numbers.get("wavelength_nm", np.zeros(0))
    if wavelengths.size and np.nanmax(wavelengths, initial=0.0) < 30.0:
        value = f"up to {np.nanmax(wavelengths):g}"
        yield InputError(f"{name}: wavelength_nm", value, "nanometres", "in um? multiply by 1000")


def _too_many_places(numbers: Mapping[str, Real], polarisation: NDArray[np.str_], name: str) -> Iterator[InputError]:
    """What no worker can be asked for: it predicts each polarisation at every wavelength under every angle."""
    for one in np.unique(polarisation):
        count = {
            column: np.unique(numbers[column][polarisation == one]).size for column in ("wavelength_nm", "aoi_deg")
        }
        wavelengths, angles = count.values()
        for column, places in count.items():
            if places > MAX_PLACES:
                yield InputError(f"{name}: {column}", places, f"at most {MAX_PLACES:,} different", "thin it out")
        if wavelengths * angles > MAX_VALUES:
            value, allowed = f"{wavelengths:,} x {angles:,}", f"wavelengths x angles up to {MAX_VALUES:,}"
            mend = "thin it out, or make several shots of it, each with fewer angles"
            yield InputError(f"{name}: rows", value, allowed, mend)


def _wrong_unit(
    rows: Sequence[tuple[int, Row]], value: Real, sigma: Real, quantity: Quantity, name: str
) -> Iterator[InputError]:
    """Values that the quantity cannot have; percent is told by name."""
    if not value.size or not np.isfinite(value).any():
        return
    most = float(np.nanmax(value))
    if quantity in ("R", "T"):
        if most > PERCENT:
            mend = f"{quantity} in percent? divide value and sigma by 100"
            yield InputError(f"{name}: value", f"up to {most:g}", f"{quantity} in [0, 1]", mend)
            return
        if (largest := float(np.nanmax(sigma, initial=0.0))) > 1.0:
            mend = "in percent? divide it by 100; remove rows that are not to be used"
            yield InputError(f"{name}: sigma", f"up to {largest:g}", f"at most 1, as {quantity} is", mend)
        beyond = np.maximum(BEYOND_UNITY, 5.0 * np.nan_to_num(sigma))
    else:
        beyond = np.zeros(value.size)
    low, high = LIMITS[quantity]
    for at in np.flatnonzero((value < low - beyond) | (value > high + beyond)).tolist():
        allowed = f"{quantity} in [{low:g}, {high:g}]" + ("" if quantity in ("R", "T") else " deg")
        yield InputError(f"{name}: line {rows[at][0]}: value", float(value[at]), allowed)


def _duplicates(rows: Sequence[tuple[int, Row]], columns: tuple[str, ...], name: str) -> Iterator[InputError]:
    """Rows that say the same place a second time."""
    first: dict[tuple[float | str, ...], int] = {}
    for line, row in rows:
        key = tuple(_number(row[column].strip()) for column in columns)
        if key in first:
            place = ", ".join(row[column].strip() for column in columns)
            mend = f"line {first[key]} has it already: average the two"
            yield InputError(f"{name}: line {line}: duplicate", place, "each place once", mend)
        first.setdefault(key, line)


def _number(cell: str) -> float | str:
    """A cell's number; the cell where it has none."""
    try:
        return float(cell)
    except ValueError:
        return cell
