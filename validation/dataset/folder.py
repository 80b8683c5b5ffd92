"""A data set as a folder: `dataset.toml`, the files it names, and `SHA256SUMS`, which lists them all.

Nothing outside the folder is ever opened for it: absolute paths, `..` and links that lead out are refused, and so are
files larger than 256 MB.
"""

from __future__ import annotations

import hashlib
import os
import re
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from luxloop.errors import InputError
from luxloop.files import whole
from luxloop.words import sha256_of
from validation.dataset.manifest import Manifest
from validation.dataset.manifest_file import MANIFEST, parse_manifest
from validation.writing import written

SUMS = "SHA256SUMS"
MAX_FILE_BYTES = 256 << 20
MAX_MANIFEST_BYTES = 4 << 20


@dataclass(frozen=True)
class Dataset:
    """A manifest and the folder it describes; `sha256` is of the manifest's bytes and those of all files it names."""

    folder: Path
    manifest: Manifest
    sha256: str

    def path(self, name: str) -> Path:
        """Where a file of the manifest lies; InputError where that is outside of the folder or no file."""
        return confined(self.folder, name, name)


def read_dataset(path: str | Path) -> Dataset:
    """The data set in a folder, every file it names read once for its hash.

    Raises InputError for the first fault of the manifest, a file that is missing, too large or outside of the folder,
    and a file whose hash is not the one in SHA256SUMS. What is in the files is not looked at: `checks.check` does.
    """
    folder = folder_of(path)
    raw = manifest_bytes(folder)
    manifest = parse_manifest(raw)
    hashes = {name: sha256_of_file(confined(folder, name, field)) for field, name in named_files(manifest).items()}
    stated = read_sums(folder)
    for name, found in hashes.items():
        if stated.get(name, found) != found:
            raise changed(name, found, stated[name])
    return Dataset(folder, manifest, whole_hash(raw, hashes))


def folder_of(path: str | Path) -> Path:
    """The folder of a data set, of which its folder or its `dataset.toml` is given."""
    path = Path(path)
    folder = path.parent if path.name == MANIFEST and not path.is_dir() else path
    if not folder.is_dir():
        raise InputError("DATASET", str(path), f"a folder with a {MANIFEST}", "luxloop dataset import makes one")
    return folder


def manifest_bytes(folder: Path) -> bytes:
    """What is in `dataset.toml`; InputError where it is missing or cannot be one."""
    if not os.path.lexists(folder / MANIFEST):
        raise InputError(MANIFEST, str(folder), f"a folder with a {MANIFEST}", "luxloop dataset import makes one")
    path = confined(folder, MANIFEST, MANIFEST)
    if path.stat().st_size > MAX_MANIFEST_BYTES:
        raise InputError(MANIFEST, f"{path.stat().st_size} bytes", f"at most {MAX_MANIFEST_BYTES} bytes")
    return path.read_bytes()


def named_files(manifest: Manifest) -> dict[str, str]:
    """The files of all shots, by where each is named first: `dataset.toml: shots["a"].dark` -> its path."""
    first: dict[str, str] = {}
    for shot in manifest.shots:
        for field, name in shot.files().items():
            first.setdefault(name, f'{MANIFEST}: shots["{shot.id}"].{field}')
    return {field: name for name, field in first.items()}


def confined(folder: Path, name: str, field: str) -> Path:
    """The file `name` of the folder, as a path that exists, is a file, is inside, and is not too large.

    Raises InputError naming `field`: a path that leaves the folder, by itself or through a link; no file; too large.
    """
    parts = PurePosixPath(name).parts
    if name.startswith("/") or ".." in parts or "\\" in name or "\0" in name or re.match(r"[A-Za-z]:", name):
        raise InputError(field, name, "a path inside the folder, with /", "copy the file into the folder")
    # `resolve` would stop at links in a ring
    root, path = (Path(os.path.realpath(one)) for one in (folder, folder / name))
    if not path.is_relative_to(root):
        raise InputError(field, name, "a path inside the folder", "a link leads out of it: copy the file instead")
    if not path.is_file():
        mend = "its name is spelt otherwise?" if not path.exists() else "this is no file"
        raise InputError(field, name, "a file in the folder", mend)
    if path.stat().st_size > MAX_FILE_BYTES:
        size = f"{path.stat().st_size >> 20} MB"
        raise InputError(field, f"{name}: {size}", f"at most {MAX_FILE_BYTES >> 20} MB", "crop or bin the image")
    return path


def sha256_of_file(path: Path) -> str:
    """SHA-256 of a file's bytes, in hex."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def whole_hash(raw_manifest: bytes, hashes: dict[str, str]) -> str:
    """The hash of a data set from its manifest's bytes and the hash of each file it names."""
    return sha256_of({**hashes, MANIFEST: hashlib.sha256(raw_manifest).hexdigest()})


def changed(name: str, found: str, stated: str) -> InputError:
    """The fault of a file that is not the one whose hash stands in SHA256SUMS."""
    mend = "restore the file; if the change was meant: luxloop dataset check --seal"
    return InputError(f"{SUMS}: {name}", found, stated, mend)


def read_sums(folder: Path) -> dict[str, str]:
    """The hashes that SHA256SUMS states by file, none where there is no such file; InputError where it is damaged."""
    if not (folder / SUMS).exists():
        return {}
    sums: dict[str, str] = {}
    text = confined(folder, SUMS, SUMS).read_text(encoding="utf-8", errors="replace")
    for number, line in enumerate(text.splitlines(), 1):
        found = re.fullmatch(r"([0-9a-f]{64}) [ *](.+)", line)
        if found is None:
            raise InputError(f"{SUMS}: line {number}", line, "64 hex digits, two blanks, a file", "check --seal")
        sums[found[2].removeprefix("./")] = found[1]
    return sums


def write_sums(folder: Path) -> Path:
    """Write SHA256SUMS, which lists every file of the folder but itself and hidden ones; returns its path.

    `sha256sum --check SHA256SUMS` in the folder verifies it without luxloop.
    """
    lines = [f"{sha256_of_file(path)}  {name}\n" for name, path in sorted(files_of(folder).items())]
    with written(SUMS, folder, "copy the data set to where you may write"), whole(folder / SUMS) as fresh:
        fresh.write_text("".join(lines), encoding="utf-8")
    return folder / SUMS


def files_of(folder: Path) -> dict[str, Path]:
    """Every file of the folder by its path in it; without SHA256SUMS, hidden files, and links that lead out."""
    found = {}
    for path in folder.rglob("*"):
        name = path.relative_to(folder).as_posix()
        hidden = any(part.startswith(".") for part in PurePosixPath(name).parts)
        inside = Path(os.path.realpath(path)).is_relative_to(os.path.realpath(folder))
        if path.is_file() and inside and not hidden and name != SUMS:
            found[name] = path
    return found
