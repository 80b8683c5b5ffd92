"""A folder of blind sets: what lies where, and files that are written whole or not at all.

FOLDER/blind.json            what was asked for, but for what is hidden; the sets by name and light, with what is
                             known of each before; the root
       model.toml            the model that the sets are made about, where it is none that luxloop ships
       sets/ID/              an ordinary data set, and seal.json: the hash of the answer
       answers/ID.json       salt and answer; nobody needs it before the score
       verdicts/ID.json      what the diagnosis said; ID.npz: the residuals that it left
       chain.json            where the chain of verdicts ends
       opened/ID.json        by which verdict the seal was opened
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from pydantic import Field

from luxloop import __version__
from luxloop.errors import InputError
from luxloop.journal.segment import sync_folder
from luxloop.model import Model
from luxloop.model_file import find_model
from luxloop.words import Name, Sha256, Words, parse, sha256_of

SCHEMA: Literal["luxloop-blind/1"] = "luxloop-blind/1"
INDEX, SETS, ANSWERS, VERDICTS, SEAL = "blind.json", "sets", "answers", "verdicts", "seal.json"
CHAIN, OPENED, MODEL = "chain.json", "opened", "model.toml"
WEAK, ASKED = "too-weak.json", "asked.json"
"""Beside the answers: kinds that do not show as strongly as was asked; what was asked for."""
LOCK = ".lock"
CHANGED = f"{INDEX} was changed: put back the one that was there"


class Entry(Words):
    """A set: its name, and that of its light. Sets of one light are the same scene, recorded several times."""

    id: Name
    light: Name
    priors: dict[str, float] = Field(
        default_factory=dict, description="What is known of this scene before: means of the model's priors, by path."
    )

    def known_before(self, model: Model) -> Model:
        """The model with this set's priors. Raises InputError for one that the model has not."""
        fit = dict(model.fit)
        for path, mean in self.priors.items():
            if path not in fit or fit[path].prior_sd is None:
                raise InputError(f"{self.id}: priors", path, "a parameter of the model that has a prior", CHANGED)
            own = fit[path].model_copy(update={"prior_mean": mean})
            if not own.lower <= mean <= own.upper:
                raise InputError(f"{self.id}: priors.{path}", mean, f"{own.lower:g} to {own.upper:g}", CHANGED)
            fit[path] = own
        return model.model_copy(update={"fit": fit})


class Index(Words):
    """What may be known of a folder before its seals are opened."""

    schema_: Literal["luxloop-blind/1"] = Field(SCHEMA, alias="schema")
    version: str = Field(__version__, description="Of luxloop, which made the sets.")
    model: str = Field("paper", description="The model that the verdicts begin with: a shipped one, or model.toml.")
    model_sha256: Sha256 | None = Field(None, description="Its hash.")
    plan: str = Field(description="Name of the samples' plan.")
    sets: tuple[Entry, ...] = Field(min_length=1, max_length=100_000)
    seals: dict[Name, Sha256] = Field(default_factory=dict, description="Of all sets, once all of them are made.")
    root: Sha256 | None = Field(None, description="The hash of the seals; none: not all sets are made.")

    def text(self) -> str:
        """As it is written."""
        return json.dumps(self.model_dump(mode="json", by_alias=True), indent=1) + "\n"


def read_index(folder: Path) -> Index:
    """What a folder of blind sets says of itself.

    Raises InputError for a folder that has none, and for sets that another version made: its verdicts and these are
    no sample of one thing.
    """
    path = folder / INDEX
    mend = "luxloop blind make FOLDER makes one"
    if "*" in str(folder):
        mend = "no folder has such a name: where records are missing, `python -m benchmarks.blind_records` adds some"
    data = read_json(path, "FOLDER", f"a folder with a {INDEX}", mend)
    of_this_version(data, str(path), "sets")
    return parse(Index, data, str(path))


def model_of(folder: Path, index: Index) -> Model:
    """The model that sets were made about. Raises InputError where it is gone or was changed."""
    found = find_model(folder / MODEL if index.model == MODEL else index.model)
    if index.model_sha256 not in (None, found.sha256):
        mend = "take the luxloop that made the sets, or put the file back"
        raise InputError(f"{folder.name}: model {index.model}", found.sha256, f"{index.model_sha256}", mend)
    return found


def hash_of_fit(model: Model) -> str:
    """The hash of all that a fit is told of a model's parameters: what is free, limits, priors."""
    return sha256_of({path: fit.model_dump(mode="json") for path, fit in model.fit.items()})


def of_this_version(data: Mapping[str, Any], field: str, what: str) -> None:
    """Raises InputError for what another version wrote."""
    if (data.get("schema"), data.get("version")) != (SCHEMA, __version__):
        found = f"{data.get('schema')}, luxloop {data.get('version')}"
        mend = "take the luxloop that made them, or make new ones"
        raise InputError(field, found, f"{what} of this version: {SCHEMA}, luxloop {__version__}", mend)


def read_json(path: Path, field: str, allowed: str, mend: str) -> dict[str, Any]:
    """A JSON object in a file. Raises InputError naming `field` where there is none."""
    name = f"{path.parent.name}/{path.name}"
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(field, f"{name} is not there", allowed, mend) from None
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(field, f"{name}: {error}", allowed, mend) from None
    if not isinstance(data, dict):
        raise InputError(field, f"{name} is no JSON object", allowed, mend)
    return data


def write_whole(path: Path, data: bytes | str | Mapping[str, Any]) -> None:
    """A file that is there with all its bytes or not at all, whatever kills the process."""
    if isinstance(data, Mapping):
        data = json.dumps(data, ensure_ascii=False)
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    with temporary.open("wb") as file:
        file.write(data if isinstance(data, bytes) else data.encode())
        file.flush()
        os.fsync(file.fileno())
    temporary.replace(path)
    sync_folder(path.parent)


def move_whole(temporary: Path, to: Path) -> None:
    """A folder of a set gets its name once all that is in it is there."""
    temporary.rename(to)
    sync_folder(to.parent)


def is_empty(folder: Path) -> bool:
    """Whether nothing lies in a folder but the lock of who works in it."""
    return folder.is_dir() and all(one.name == LOCK for one in folder.iterdir())
