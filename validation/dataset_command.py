"""`luxloop dataset check|import|show`: from a camera's files to data that can be compared with a model."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

if TYPE_CHECKING:
    from validation.dataset.checks import Finding
    from validation.dataset.folder import Dataset
    from validation.measured import MeasuredImage

WIDTH_WITHOUT_TERMINAL = 160  # a pipe has no width of its own; cells would be folded at 80

DatasetArgument = Annotated[Path, typer.Argument(metavar="DATASET", help="Folder of the data set.")]
JsonOption = Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")]


def check(
    dataset: DatasetArgument,
    seal: Annotated[
        bool, typer.Option("--seal", help="Write SHA256SUMS anew first: the files are meant so.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """List everything that is wrong with a data set; exit code 2 where anything is an error."""
    from validation.dataset.checks import check as findings_of
    from validation.dataset.folder import folder_of, manifest_bytes, write_sums

    if seal:
        manifest_bytes(folder_of(dataset))  # refuses a folder that is no data set
        write_sums(folder_of(dataset))
    findings = findings_of(dataset)
    _tell_findings(dataset, findings, as_json)
    wrong = any(finding.level == "error" for finding in findings)
    for note in () if as_json else _notes(folder_of(dataset), seal, wrong):
        typer.echo(note)
    if wrong:
        raise typer.Exit(2)


def _notes(folder: Path, sealed: bool, wrong: bool) -> Iterator[str]:
    """What is no finding: that sums were written, and that guesses of an import still stand."""
    from validation.dataset.importing import CHECK
    from validation.dataset.manifest_file import MANIFEST

    if sealed:
        yield "the files' sums are written anew" + ("; the errors stay: the data cannot be used so" if wrong else "")
    file = folder / MANIFEST
    lines = file.read_text(encoding="utf-8", errors="replace").splitlines() if file.is_file() else []
    if guesses := sum(CHECK in line for line in lines):
        yield f"{guesses} lines of {MANIFEST} still say '{CHECK}', guesses of the import: correct them, take it away"


def _tell_findings(folder: Path, findings: list[Finding], as_json: bool, **more: Any) -> None:
    errors = sum(finding.level == "error" for finding in findings)
    counts = {"errors": errors, "warnings": len(findings) - errors}
    if as_json:
        told = {"dataset": str(folder), **more, **counts, "findings": [finding.as_object() for finding in findings]}
        typer.echo(json.dumps(told, ensure_ascii=False))
        return
    for finding in findings:
        typer.echo(f"{finding.level}: {finding}")
    summary = ", ".join(f"{count} {word if count != 1 else word[:-1]}" for word, count in counts.items())
    typer.echo(f"{folder}: {summary}" if findings else f"{folder}: nothing wrong")


def import_(
    folder: Annotated[Path, typer.Argument(help="Folder of the camera's files: TIFF, LMK .pf, matrices as .csv.")],
    into: Annotated[Path | None, typer.Option(help="The data set to write; it must not exist yet.")] = None,
    table: Annotated[Path | None, typer.Option(help="CSV: a row per image, its sample, exposure, dark ...")] = None,
    write_table: Annotated[Path | None, typer.Option(help="Write that table to fill in, and end.")] = None,
    row0: Annotated[
        Literal["top", "bottom"], typer.Option(help="Where row 0 of the files is on the module.")
    ] = "top",
    pixel_um: Annotated[float | None, typer.Option(help="Side of a pixel as seen on the receiver.")] = None,
    bit_depth: Annotated[int | None, typer.Option(help="Bits of the raw numbers, 9 to 16.")] = None,
    gain_dn_per_e: Annotated[float | None, typer.Option(help="K of EMVA 1288.")] = None,
    read_noise_e: Annotated[float | None, typer.Option(help="Temporal dark noise, rms.")] = None,
    full_well_e: Annotated[float | None, typer.Option(help="Default: full scale.")] = None,
    black_level_dn: Annotated[float | None, typer.Option(help="Default: from the dark, or the image.")] = None,
    prnu_percent: Annotated[float | None, typer.Option(help="Fixed pattern left after the flat, rms.")] = None,
    layout: Annotated[Literal["single", "array"] | None, typer.Option(help="Of all samples.")] = None,
    rows: Annotated[int | None, typer.Option(help="Chips along y, of an array.")] = None,
    columns: Annotated[int | None, typer.Option(help="Chips along x, of an array.")] = None,
    distance_um: Annotated[float | None, typer.Option(help="D, substrate to receiver.")] = None,
    width_um: Annotated[float | None, typer.Option(help="W, side of a chip.")] = None,
    spacing_um: Annotated[float | None, typer.Option(help="S, pitch of the chips.")] = None,
    thickness_um: Annotated[float | None, typer.Option(help="T, height of a chip.")] = None,
    dbr_pairs: Annotated[float | None, typer.Option(help="Pairs of the DBR, in halves.")] = None,
    exposure_ms: Annotated[float | None, typer.Option(help="Of all images.")] = None,
    frames_averaged: Annotated[int | None, typer.Option(help="Frames in each image.")] = None,
    dark: Annotated[str | None, typer.Option(help="Dark image of all images.")] = None,
    dark_frames_averaged: Annotated[int | None, typer.Option(help="Frames in each dark.")] = None,
    flat: Annotated[str | None, typer.Option(help="Flat image of all images.")] = None,
    mask: Annotated[str | None, typer.Option(help="Mask of all images; 0: ignore the pixel.")] = None,
    scale: Annotated[float, typer.Option(help="DN per number in the files (luminance in cd/m2, say).")] = 1.0,
    name: Annotated[str | None, typer.Option(help="Of the data set.")] = None,
    licence: Annotated[str, typer.Option(help="Under which others may use it.")] = "",
    as_json: JsonOption = False,
) -> None:
    """Make a data set of a folder of camera files. What is missing is asked for, all at once."""
    from luxloop.errors import InputError
    from validation.dataset.checks import check as findings_of
    from validation.dataset.importing import Order, image_files, import_folder
    from validation.dataset.sheet import Row, read_sheet, write_sheet

    said = {
        "layout": layout, "rows": rows, "columns": columns, "distance_um": distance_um, "width_um": width_um,
        "spacing_um": spacing_um, "thickness_um": thickness_um, "dbr_pairs": dbr_pairs, "exposure_ms": exposure_ms,
        "frames_averaged": frames_averaged, "dark_frames_averaged": dark_frames_averaged,
        "dark": dark, "flat": flat, "mask": mask,
    }  # fmt: skip
    common = {key: value for key, value in said.items() if value is not None}
    camera = {
        "pixel_um": pixel_um, "bit_depth": bit_depth, "gain_dn_per_e": gain_dn_per_e, "read_noise_e": read_noise_e,
        "full_well_e": full_well_e, "black_level_dn": black_level_dn, "prnu_percent": prnu_percent,
    }  # fmt: skip
    helpers = [place / one for one in (dark, flat, mask) if one for place in (folder, Path())]
    files = image_files(folder, [*helpers, *([table] if table else [])])
    if write_table is not None:
        write_sheet(write_table, files, common)
        told = {"table": str(write_table), "files": files}
        words = (
            f"{write_table}: {len(files)} images; fill in sample, layout (single, or array with rows and columns),"
            " the design, the exposure; what is the same in all rows may be an option instead"
            f"\nnext: luxloop dataset import {folder} --into DATA --table {write_table}"
        )
        typer.echo(json.dumps(told) if as_json else words)
        return
    if into is None:
        raise InputError("--into", None, "the folder of the data set to write")
    if not 0.0 < scale < 1e9:
        raise InputError("--scale", scale, "above 0")
    rows_of_table: list[Row] = read_sheet(table) if table else [{"file": file} for file in files]
    title = name or os.path.basename(os.path.realpath(into))
    order = Order(folder, rows_of_table, common, camera, title, licence, table is not None, row0, scale)
    manifest = import_folder(order, into)
    findings = findings_of(into)
    to_check = sorted(order.remarks)
    if not as_json:
        images, samples = (
            f"{len(some)} {word}{'s' * (len(some) != 1)}"
            for some, word in ((manifest.shots, "image"), (manifest.samples, "sample"))
        )
        typer.echo(f"{into}: {images} of {samples}, --row0 {row0}")
        for path in to_check:
            typer.echo(f"check this in {into / 'dataset.toml'}: {path}  # {order.remarks[path]}")
    more = {"images": len(manifest.shots), "samples": len(manifest.samples), "row0": row0, "to_check": to_check}
    _tell_findings(into, findings, as_json, **more)
    if any(finding.level == "error" for finding in findings):
        raise typer.Exit(2)


def show(dataset: DatasetArgument, as_json: JsonOption = False) -> None:
    """Show what is in a data set: camera, samples, shots, what is saturated or masked, signal to noise."""
    from validation.dataset.folder import read_dataset
    from validation.measured import measured_far_fields, measured_images, measured_spectra

    data = read_dataset(dataset)
    images = [_image_facts(image) for image in measured_images(data)]
    spectra = [
        {"shot": one.shot.id, "film": one.film.id, "quantity": one.shot.quantity, "rows": one.table.value.size}
        for one in measured_spectra(data)
    ]
    far_fields = [
        {"shot": one.shot.id, "sample": one.sample.id, "rows": one.table.value.size}
        for one in measured_far_fields(data)
    ]
    shots = {"images": images, "spectra": spectra, "far_fields": far_fields}
    if as_json:
        told = {"dataset": str(dataset), "sha256": data.sha256, **data.manifest.model_dump(mode="json"), **shots}
        typer.echo(json.dumps(told, ensure_ascii=False))
        return
    _print_show(data, shots)


def _image_facts(image: MeasuredImage) -> dict[str, Any]:
    """The row of an image: counts of raw pixels, and signal to noise where it is brightest and at its median."""
    import numpy as np

    signal = image.signal_dn[image.used]
    noise = np.sqrt(image.variance_dn2(image.signal_dn))[image.used]
    bright = signal >= np.quantile(signal, 0.99)
    return {
        "shot": image.shot.id,
        "sample": image.sample.id,
        "exposure_ms": image.shot.exposure_ms,
        "frames": image.shot.frames_averaged,
        "binning": image.binning,
        "pixels": list(image.used.shape),
        "pixel_um": image.pixel_um,
        "saturated_percent": 100.0 * image.saturated / image.raw_pixels,
        "masked_percent": 100.0 * image.masked / image.raw_pixels,
        "peak_dn": float(np.median(signal[bright])),
        "snr_bright": float(np.median(signal[bright] / noise[bright])),
        "snr_median": float(np.median(signal / noise)),
    }


def _print_show(data: Dataset, shots: dict[str, list[dict[str, Any]]]) -> None:
    from rich.console import Console

    from luxloop.units import unit_of

    console = Console()
    wide = console.is_terminal or os.environ.get("COLUMNS", "").isdigit()
    console = console if wide else Console(width=WIDTH_WITHOUT_TERMINAL)
    manifest = data.manifest
    print_ = console.print
    print_(f"{manifest.name}  ({manifest.licence or 'no licence stated'})  {data.sha256[:12]}", markup=False)
    if manifest.notes:
        print_(manifest.notes, markup=False)
    if manifest.camera is not None:
        facts = manifest.camera.model_dump(exclude_none=True).items()
        print_("camera: " + ", ".join(f"{key} {value} {unit_of(key)}".rstrip() for key, value in facts), markup=False)
    for one in manifest.samples:
        size = f"array {one.rows} x {one.columns}" if one.layout == "array" else "single"
        print_(f"sample {one.id}: {size}, {one.design}", markup=False)
    for film in manifest.films:
        print_(f"film {film.id}: {film.incident}, {len(film.layers)} layers, {film.exit}", markup=False)
    for rows in shots.values():
        if rows:
            print_(_table(rows))


def _table(rows: Iterable[dict[str, Any]]) -> Any:
    from rich.table import Table
    from rich.text import Text

    rows = list(rows)
    table = Table(*rows[0], box=None, pad_edge=False)
    for row in rows:
        table.add_row(*(Text(_cell(value)) for value in row.values()))
    return table


def _cell(value: Any) -> str:
    if isinstance(value, list):
        return " x ".join(map(str, value))
    return f"{value:.3g}" if isinstance(value, float) else str(value)
