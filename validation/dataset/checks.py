"""Everything that is wrong with a data set, each fault with file, field, value, what is allowed, and the mend."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from importlib.metadata import entry_points
from itertools import product
from pathlib import Path

from luxloop.errors import InputError, shortened, shown
from validation.dataset.folder import (
    SUMS,
    changed,
    confined,
    files_of,
    folder_of,
    manifest_bytes,
    named_files,
    read_sums,
    sha256_of_file,
)
from validation.dataset.image_checks import Level, image_faults
from validation.dataset.images import IMAGE_TYPES, TiffImage, read_tiff
from validation.dataset.manifest import Manifest
from validation.dataset.manifest_file import MANIFEST, manifest_and_faults
from validation.dataset.spectra import far_field_and_faults, spectrum_and_faults

MOST_OF_A_KIND = 5
"""So many faults of one kind are listed for a file; a column in percent would fill the screen."""


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong."""

    level: Level
    file: str
    field: str
    value: str
    allowed: str
    mend: str

    def as_object(self) -> dict[str, str]:
        """The same for JSON."""
        return asdict(self)

    def __str__(self) -> str:
        text = f"{self.file}: {self.field}: got {self.value}, allowed: {self.allowed}"
        return text + (f"; {self.mend}" if self.mend else "")


def check(path: str | Path) -> list[Finding]:
    """Everything that is wrong with the data set in a folder, errors first; nothing where it is as it should be.

    Raises InputError only where there is no such folder. Where the manifest has a fault, its files are not looked at.
    """
    folder = folder_of(path)
    try:
        manifest, faults = manifest_and_faults(manifest_bytes(folder))
    except InputError as error:
        return [_finding(error)]
    found = [_finding(fault) for fault in faults]
    if manifest is not None and not faults:
        found += [*_of_samples(manifest), *_of_films(manifest), *_of_files(folder, manifest)]
    return sorted(_few_of_a_kind(found), key=lambda finding: finding.level)


def _of_samples(manifest: Manifest) -> Iterator[Finding]:
    """Chips that overlap, but for a model that takes the spacing for the gap between them."""
    for one in manifest.samples:
        if one.layout == "array" and one.width_um >= one.spacing_um:
            allowed = f"below spacing_um, {one.spacing_um:g} um, where a model's spacing_is is not gap"
            mend = "chips overlap: correct width_um or spacing_um"
            field = f'{MANIFEST}: samples["{one.id}"].width_um'
            yield _finding(InputError(field, one.width_um, allowed, mend), "warning")


def _of_films(manifest: Manifest) -> Iterator[Finding]:
    """Materials of films that no worker has a table of; the one who has the tables says so."""
    tables = [point.load() for point in entry_points(group="luxloop.materials")] if manifest.films else []
    for film in manifest.films:
        layers = {f"layers.{number}.material": layer.material for number, layer in enumerate(film.layers)}
        named = {"incident": film.incident, "exit": film.exit, **layers}
        for (field, name), known in product(named.items(), tables):
            try:
                if name is not None:
                    known(name)
            except InputError as error:
                where = f'{MANIFEST}: films["{film.id}"].{field}'
                yield _finding(InputError(where, error.value, error.allowed, error.mend))


def _of_files(folder: Path, manifest: Manifest) -> Iterator[Finding]:
    """What is wrong with the files that a manifest names, and with SHA256SUMS."""
    there: dict[str, Path] = {}
    for field, name in named_files(manifest).items():
        try:
            there[name] = confined(folder, name, field)
        except InputError as error:
            yield _finding(error)
    yield from _of_sums(folder, set(there))
    yield from _of_images(manifest, there)
    for spectrum in manifest.spectra():
        if spectrum.file in there:
            yield from map(_finding, spectrum_and_faults(there[spectrum.file], spectrum.file, spectrum.quantity)[1])
    for far_field in manifest.far_fields():
        if far_field.file in there:
            yield from map(_finding, far_field_and_faults(there[far_field.file], far_field.file)[1])


def _of_images(manifest: Manifest, there: dict[str, Path]) -> Iterator[Finding]:
    """What is wrong with the images, their darks, flats and masks; a file that many shots name is told of once."""
    unreadable: list[Finding] = []

    @lru_cache(maxsize=8)  # darks, flats and masks come again, images do not
    def load(name: str, types: tuple[str, ...] | None) -> TiffImage | None:
        if name not in there:
            return None
        try:
            return read_tiff(there[name], name, types or IMAGE_TYPES)
        except InputError as error:
            unreadable.append(_finding(error))
            return None

    first: tuple[str, tuple[int, ...]] | None = None
    for shot in manifest.images():
        image = load(shot.file, None)
        if image is not None:
            first = first or (shot.file, image.values.shape)
            if image.values.shape != first[1]:
                value, allowed = (f"{rows} x {columns} pixels" for rows, columns in (image.values.shape, first[1]))
                mend = "one camera, one size: crop them alike, or make two data sets"
                yield _finding(InputError(f"{shot.file}: size", value, f"{allowed}, as {first[0]}", mend))
        for told in image_faults(manifest, shot, load):
            yield _finding(told.error, told.level)
    yield from unreadable


def _of_sums(folder: Path, named: set[str]) -> Iterator[Finding]:
    """Files whose hash is not the one in SHA256SUMS, that are not listed, or not there."""
    seal = "luxloop dataset check --seal writes it"
    if not (folder / SUMS).is_file():
        yield _finding(InputError(SUMS, None, "the hashes of all files", seal), "warning")
        return
    try:
        stated = read_sums(folder)
    except InputError as error:
        yield _finding(error)
        return
    present = files_of(folder)
    for name in sorted(stated.keys() - present.keys() - named):
        yield _finding(InputError(f"{SUMS}: {name}", None, "the file", "restore it, or: check --seal"))
    for name, path in sorted(present.items()):
        if name not in stated:
            yield _finding(InputError(f"{SUMS}: {name}", None, "the hash of every file", seal), "warning")
        elif (found := sha256_of_file(path)) != stated[name]:
            own_words = name == MANIFEST  # edited by hand, most likely; what it says is checked besides
            yield _finding(changed(name, found, stated[name]), "warning" if own_words else "error")


def _finding(error: InputError, level: Level = "error") -> Finding:
    """A fault whose field is "FILE: where" as a finding."""
    file, separator, field = error.field.partition(": ")
    value = shortened(error.value, 200) if isinstance(error.value, str) else shown(error.value, 200)
    return Finding(level, file, field if separator else "(whole)", value, error.allowed, error.mend)


def _few_of_a_kind(findings: Iterable[Finding]) -> Iterator[Finding]:
    """The findings, each once, and of one kind in a file only the first few; the last says how many more."""
    kinds: dict[tuple[str, str, str], list[Finding]] = {}
    for finding in dict.fromkeys(findings):
        kind = finding.field.rpartition(": ")[2] if finding.field.startswith("line ") else finding.field
        kinds.setdefault((finding.file, kind, finding.allowed), []).append(finding)
    for group in kinds.values():
        yield from group[: MOST_OF_A_KIND - 1]
        rest = group[MOST_OF_A_KIND - 1 :]
        more = f"{len(rest) - 1} more like this" if len(rest) > 1 else ""
        yield from (replace(one, mend="; ".join(filter(None, (one.mend, more)))) for one in rest[:1])
