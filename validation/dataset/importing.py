"""From a folder of a camera's files to a data set: images converted, turned, and described in `dataset.toml`.

What the user did not say and nobody can guess is asked for at once, in one error; what has a plausible value is
written with it, and a comment `check this` behind.
"""

from __future__ import annotations

import os
import re
import shutil
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import ValidationError

from luxloop.errors import InputError
from luxloop.files import whole
from luxloop.words import parse
from validation.dataset.folder import MAX_FILE_BYTES, write_sums
from validation.dataset.foreign import is_image, read_foreign
from validation.dataset.images import IMAGE_TYPES, MASK_TYPES, Pixels, write_tiff
from validation.dataset.manifest import CameraFacts, ImageShot, Manifest, Sample
from validation.dataset.manifest_file import MANIFEST, to_toml
from validation.dataset.sheet import DESIGN, FILES, SAMPLE, Row, Value
from validation.writing import written

ASKED_OF_CAMERA = ("pixel_um", "bit_depth", "gain_dn_per_e", "read_noise_e")
SINGLE_SPACING_UM = 400.0
CHECK = "check this"
HELPER = re.compile(r"(dark|flat|mask)", re.IGNORECASE)
"""How the names of files begin that hardly are images of a sample."""
FLIPPED = "Imported with --row0 top: row 0 of the files was the top of the module, so they were flipped."
KEPT = "Imported with --row0 bottom: row 0 of the files is at the lowest y; nothing was flipped."


@dataclass
class Order:
    """What is to be imported, and what the user said of it."""

    folder: Path
    rows: list[Row]  # from the table; without one, a row per image file
    common: dict[str, Value]  # what options say of all images
    camera: dict[str, Any]  # fields of CameraFacts
    name: str
    licence: str = ""
    listed: bool = False  # whether the rows are from a table
    row0: Literal["top", "bottom"] = "top"
    scale: float = 1.0  # DN per number in the file
    remarks: dict[str, str] = field(default_factory=dict)  # comments of dataset.toml by path

    def of(self, row: Row, name: str) -> Any:
        """What is said of an image, by its row or else by an option; None: nothing."""
        return row.get(name, self.common.get(name))


def image_files(folder: Path, but: Iterable[Path] = ()) -> list[str]:
    """The image files in a folder and those below it, by their path in it, without those `but`, and hidden ones."""
    if not folder.is_dir():
        raise InputError("FOLDER", str(folder), "a folder of image files")
    others = {os.path.realpath(path) for path in but}  # `resolve` would stop at links in a ring
    found = []
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder)
        hidden = any(part.startswith(".") for part in name.parts)
        if path.is_file() and is_image(path) and not hidden and os.path.realpath(path) not in others:
            found.append(name.as_posix())
    return found


def import_folder(order: Order, into: Path) -> Manifest:
    """Write the data set `into` a folder that does not exist yet, or is empty; returns its manifest.

    Raises InputError naming all that is missing, or the first file that cannot be read. Nothing is left behind then.
    """
    folder = Path(os.path.realpath(into))
    is_there = os.path.lexists(folder)
    if is_there and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError("--into", str(into), "a folder that does not exist, or is empty", "give another name")
    refuse_options(order)
    _refuse_missing(order)
    with written("--into", into, "name a folder where you may write"):
        folder.parent.mkdir(parents=True, exist_ok=True)
        part = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder if is_there else folder.parent))
    try:
        manifest = _written(order, part)
        write_sums(part)
        if is_there:  # somebody may be in it
            for one in sorted(part.iterdir(), key=lambda one: one.name == MANIFEST):
                one.replace(folder / one.name)
            part.rmdir()
        else:
            part.chmod(0o755)  # of the working folder only its owner may know
            part.replace(folder)
    except BaseException:
        shutil.rmtree(part, ignore_errors=True)
        raise
    return manifest


def refuse_options(order: Order) -> None:
    """InputError naming the first option that no data set may have, also where a table says otherwise for all."""
    given = {name: value for name, value in (order.common | order.camera).items() if value is not None}
    for words in (CameraFacts, Sample, ImageShot):
        try:
            words.model_validate({name: value for name, value in given.items() if name in words.model_fields})
        except ValidationError as error:
            for wrong in (one for one in error.errors() if one["loc"] and one["loc"][0] in given):
                name = str(wrong["loc"][0])
                allowed = wrong["msg"].removeprefix("Input should be ")
                mend = words.model_fields[name].description or ""
                raise InputError(option(name), wrong["input"], allowed, mend) from None


def _refuse_missing(order: Order) -> None:
    """InputError naming everything at once that was not said and has no plausible value."""
    wanted = []
    if not order.rows:
        raise InputError("FOLDER", str(order.folder), "image files: .tif, .pf, or matrices as .csv", "look inside")
    if missing := [name for name in ASKED_OF_CAMERA if order.camera.get(name) is None]:
        wanted.append(f"of the camera: {', '.join(map(option, missing))}")
    helpers = [str(row["file"]) for row in order.rows if HELPER.match(Path(str(row["file"])).name)]
    if helpers and not order.listed:
        wanted.append(f"--dark, --flat or --mask for {_some(helpers)}, or a --table of the images")
    by_missing: dict[str, list[str]] = {}
    for row in order.rows:
        names = [name for name in _needed(order, row) if order.of(row, name) is None]
        if names:
            by_missing.setdefault(", ".join(map(option, names)), []).append(str(row["file"]))
    for names_text, files in by_missing.items():
        wanted.append(f"of {_some(files)}: {names_text}")
    if wanted:
        mend = "give the options; for samples that differ: --write-table shots.csv, fill it in, --table shots.csv"
        raise InputError("import", "not everything was said", "; ".join(wanted), mend)


def _needed(order: Order, row: Row) -> tuple[str, ...]:
    single = order.of(row, "layout") == "single"
    return tuple(name for name in SAMPLE if not (single and name in ("rows", "columns", "spacing_um")))


def option(name: str) -> str:
    """The option that says a field."""
    return f"--{name.replace('_', '-')}"


def _some(names: list[str]) -> str:
    return ", ".join(names[:4]) + (f" and {len(names) - 4} more" if len(names) > 4 else "")


def _written(order: Order, folder: Path) -> Manifest:
    """The manifest of the data set whose files were written into `folder`."""
    camera, samples = _camera(order), _samples(order)
    written: dict[tuple[str, str], str] = {}  # darks, flats and masks, by kind and name in the user's folder
    shots = []
    for row, sample, id_ in zip(order.rows, samples, _ids(order.rows), strict=True):
        shot = {"id": id_, "kind": "image", "sample": sample["id"], "file": f"images/{id_}.tif"}
        write_tiff(folder / shot["file"], _image(order, str(row["file"])))
        for kind in FILES:
            if name := order.of(row, kind):
                key = (kind, str(name))
                if key not in written:
                    written[key] = f"{kind}/{_plain(Path(str(name)).stem)}-{len(written) + 1}.tif"
                    write_tiff(folder / written[key], _helper(order, *key, camera["black_level_dn"]))
                shot[kind] = written[key]
        shots.append(shot | dict(_exposure(order, row, id_)))
    notes = FLIPPED if order.row0 == "top" else KEPT
    if any(kind == "flat" for kind, _ in written):
        notes += " The black level was subtracted from flats of whole numbers."
    unique = list({sample["id"]: sample for sample in samples}.values())
    data = {"name": order.name, "licence": order.licence, "notes": notes, "camera": camera}
    manifest = parse(Manifest, {**data, "samples": unique, "shots": shots}, "import")
    with whole(folder / MANIFEST) as fresh:
        fresh.write_text(to_toml(manifest, order.remarks), encoding="utf-8")
    return manifest


def _camera(order: Order) -> dict[str, Any]:
    """The camera's facts, with a remark where they were not said."""
    camera = {name: value for name, value in order.camera.items() if value is not None}
    if "black_level_dn" not in camera:
        black_dn, full_dn = _black_level(order), 2.0 ** camera["bit_depth"] - 1.0
        if black_dn >= full_dn:
            value = f"{black_dn:g} DN, read from the dark, or the darkest 0.1 % of an image"
            mend = "are the images saturated? Is --bit-depth right? Else give it"
            raise InputError("--black-level-dn", value, f"below full scale, {full_dn:g} DN", mend)
        camera["black_level_dn"] = black_dn
        order.remarks["camera.black_level_dn"] = f"{CHECK}: read from the dark, or the darkest 0.1 % of an image"
    parse(CameraFacts, {"full_well_e": 1.0} | camera, "import: camera")  # before anything is computed with it
    if "full_well_e" not in camera:
        range_dn = 2.0 ** camera["bit_depth"] - 1.0 - camera["black_level_dn"]
        camera["full_well_e"] = range_dn / camera["gain_dn_per_e"]
        order.remarks["camera.full_well_e"] = f"{CHECK}: as if the pixel were full at full scale"
    return camera


def _exposure(order: Order, row: Row, id_: str) -> Iterator[tuple[str, Value]]:
    """Exposure and frames of an image and its dark, with a remark where they were not said."""
    guesses: dict[str, Value] = {"exposure_ms": 1.0, "frames_averaged": 1}
    if order.of(row, "dark"):
        guesses["dark_frames_averaged"] = _frames_of_dark(order, order.of(row, "dark"))
    for name, guess in guesses.items():
        value = order.of(row, name)
        if value is None:
            order.remarks[f'shots["{id_}"].{name}'] = CHECK
        yield name, guess if value is None else value


def _frames_of_dark(order: Order, dark: str) -> int:
    """A plausible count of frames in a dark: what another row says of it, or the least of its images' own."""
    rows = [row for row in order.rows if order.of(row, "dark") == dark]
    said = (order.of(row, "dark_frames_averaged") for row in rows)
    least = min(int(order.of(row, "frames_averaged") or 1) for row in rows)
    return next((int(count) for count in said if count is not None), least)


def _image(order: Order, name: str) -> Pixels:
    """An image of the folder in DN, row 0 at the lowest y."""
    values = read_foreign(_source(order, name), name)
    if order.scale != 1.0:
        values = np.asarray(values * np.float32(order.scale), np.float32)
    return values[::-1] if order.row0 == "top" else values


def _helper(order: Order, kind: str, name: str, black_dn: float) -> Pixels:
    """A dark, flat or mask, row 0 at the lowest y; a flat of whole numbers is raw: its black in DN is taken away."""
    values = read_foreign(_source(order, name), name, MASK_TYPES if kind == "mask" else IMAGE_TYPES)
    if kind == "mask":
        values = (values != 0).astype(np.uint8)
    elif kind == "flat" and values.dtype.kind == "u":
        values = np.asarray(values * np.float32(order.scale) - np.float32(black_dn), np.float32)
    elif kind == "dark" and order.scale != 1.0:
        values = np.asarray(values * np.float32(order.scale), np.float32)
    return values[::-1] if order.row0 == "top" else values


def _source(order: Order, name: str) -> Path:
    """A file of the folder, or where it is not there, of the working folder (as typed behind an option)."""
    path = order.folder / name
    path = path if path.is_file() else Path(name)
    if not path.is_file():
        raise InputError("file", name, f"a file in {order.folder}", "its name is spelt otherwise?")
    if path.stat().st_size > MAX_FILE_BYTES:
        size = f"{path.stat().st_size >> 20} MB"
        raise InputError(f"{name}: size", size, f"at most {MAX_FILE_BYTES >> 20} MB", "crop or bin the image")
    return path


def _black_level(order: Order) -> float:
    """A plausible black level in DN: the median of a dark, or of all images the darkest thousandth of the darkest."""
    dark = order.of(order.rows[0], "dark")
    if dark is not None:
        return float(np.median(read_foreign(_source(order, str(dark)), str(dark)) * order.scale))
    names = [str(row["file"]) for row in order.rows]
    darkest = [float(np.nanquantile(read_foreign(_source(order, name), name), 0.001)) for name in names]
    return max(0.0, min(darkest) * order.scale)


def _samples(order: Order) -> list[dict[str, Any]]:
    """The sample of each row; rows of one design share one, which is named after it unless the table names it."""
    of_design: dict[tuple[Any, ...], str] = {}
    samples = []
    for row in order.rows:
        fields = {name: order.of(row, name) for name in SAMPLE if order.of(row, name) is not None}
        single = fields["layout"] == "single"
        id_ = str(order.of(row, "sample") or "")
        if not id_:
            design = tuple(fields.items())
            id_ = of_design.setdefault(design, _sample_name(fields, of_design.values()))
        if single and "spacing_um" not in fields:
            fields["spacing_um"] = SINGLE_SPACING_UM
            order.remarks[f'samples["{id_}"].spacing_um'] = "a single has none; 1/16 of it is the compared pixel"
        samples.append({"id": id_, **fields})
    _refuse_two_designs(samples)
    return samples


def _sample_name(fields: Mapping[str, Any], taken: Iterable[str]) -> str:
    """A name for a design, such as array-5x5-5.5."""
    size = "" if fields["layout"] == "single" else f"-{fields['rows']}x{fields['columns']}"
    plain = f"{fields['layout']}{size}-{fields['dbr_pairs']:g}"
    among = set(taken)
    return next(name for name in (plain, *(f"{plain}-{n}" for n in range(2, 10_000))) if name not in among)


def _refuse_two_designs(samples: list[dict[str, Any]]) -> None:
    first: dict[str, dict[str, Any]] = {}
    for sample in samples:
        other = first.setdefault(sample["id"], sample)
        for name in ("layout", "rows", "columns", *DESIGN):
            if sample.get(name) != other.get(name):
                allowed = f"{other.get(name)}, as in an earlier row of sample {sample['id']}"
                raise InputError(f"table: {name}", sample.get(name), allowed, "give the other sample another name")


def _ids(rows: list[Row]) -> list[str]:
    """An id for each row, from its file's name; numbered where two are alike."""
    ids: list[str] = []
    for row in rows:
        plain = _plain(str(Path(str(row["file"])).with_suffix("")).replace("/", "-"))
        among = set(ids)
        ids.append(next(one for one in (plain, *(f"{plain}-{n}" for n in range(2, 10_000))) if one not in among))
    return ids


def _plain(text: str) -> str:
    """The text as a name: letters, digits, dots, hyphens; at most 80 of them."""
    return re.sub(r"[^A-Za-z0-9._-]+", "-", text).lstrip("._-")[:80] or "image"
