"""Sealed answers: what is hidden in a set can be proved afterwards, and read by nobody who has only the hash.

    hash = SHA-256(salt | canonical answer)        salt: 32 random bytes; canonical: `luxloop.words.canonical`

The hash lies with the data and is copied into the verdict; salt and answer lie apart. An answer or data that were
changed after the verdict, or a verdict on other data, are found when the seal is opened.
"""

from __future__ import annotations

import hashlib
import secrets
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import Field

from luxloop import __version__
from luxloop.errors import InputError
from luxloop.words import Name, Plain, Sha256, Words, canonical, parse
from validation.blind_test.bound import mark_opened
from validation.blind_test.folders import (
    ANSWERS,
    CHANGED,
    SCHEMA,
    SEAL,
    SETS,
    Entry,
    of_this_version,
    read_json,
    write_whole,
)
from validation.dataset.folder import SUMS, read_dataset
from validation.dataset.manifest_file import MANIFEST

SALT_BYTES = 32


class Hiding(Words):
    """One thing that is hidden in a set."""

    kind: Name
    place: str
    amount: float
    unit: str
    seed: int
    right: tuple[str, ...] = Field(description="Effects of the catalogue that are the right answer; none: outside.")
    sigma: float = Field(description="Length of its whitened image, calibration and nuisances taken out.")
    rivals: dict[str, float] = Field(
        default_factory=dict, description="The same with an effect of the catalogue taken out, too, by its name."
    )


class Answer(Words):
    """All that a set hides."""

    id: Name
    hidden: tuple[Hiding, ...] = ()
    asked_sigma: float = Field(description="The strength that was asked for of each hidden thing.")
    sigma: float = Field(description="Projected length of all that is hidden together.")
    truth: Plain = Field(description="Surroundings and poses.")
    light: Name
    priors: dict[str, float] = Field(default_factory=dict, description="The set's own; none: the model's.")
    fit_sha256: Sha256 | None = Field(None, description="The hash of all that verdicts know before; none: not told.")
    seed: int
    histories: int
    dataset_sha256: Sha256
    follows: str = Field("", description="Seal of the set that this one has an image more than; none: of no other.")
    version: str = __version__
    seconds: float = Field(description="That it took to make, its share of the light included.")


def seal_of(answer: Answer | Mapping[str, Any], salt: bytes) -> str:
    """The hash, 64 hex digits, of an answer or of what a file has of it."""
    return hashlib.sha256(salt + canonical(answer)).hexdigest()


def seal(folder: Path, set_folder: Path, answer: Answer) -> str:
    """Writes the answer into the folder of blind sets, and its hash into that of the set; the hash."""
    salt = secrets.token_bytes(SALT_BYTES)
    sealed = seal_of(answer, salt)
    opening = {"schema": SCHEMA, "salt": salt.hex(), "answer": answer.model_dump(mode="json")}
    write_whole(folder / ANSWERS / f"{answer.id}.json", opening)
    write_whole(set_folder / SEAL, {"schema": SCHEMA, "version": answer.version, "sha256": sealed})
    return sealed


def seal_on(folder: Path, name: str) -> str:
    """The hash that lies with the data of a set. Raises InputError where there is none, or of another version."""
    path = folder / SETS / name / SEAL
    data = read_json(path, f"{name}: seal", "a set with a seal", "luxloop blind make writes it")
    of_this_version(data, f"{name}: seal", "a set")
    return str(data.get("sha256"))


def opened(folder: Path, name: str, verdict: dict[str, Any]) -> Answer:
    """The answer of a set, after its verdict is on record; that it was opened is put on record, too.

    Raises InputError: no answer, no salt, an answer that is not the one that was sealed, a seal, data or priors that
    are not those of the verdict, data that are there and were changed, a verdict made after the seal was opened.
    """
    path = folder / ANSWERS / f"{name}.json"
    data = read_json(path, f"{name}: answer", "the answer that was sealed", "it lies where the sets were made")
    salt = _salt(name, data.get("salt"))
    answer = parse(Answer, data.get("answer"), str(path))
    sealed, of_verdict = seal_on(folder, name), str(verdict.get("seal"))
    if (changed := seal_of(data["answer"], salt)) != sealed:  # as it stands there, whatever a later version adds
        mend = "answer or salt was changed after it was sealed: the set does not count"
        raise InputError(f"{name}: answer", changed, f"the answer whose seal is {sealed[:16]}...", mend)
    if of_verdict != sealed:
        mend = "the seal was changed after the verdict: the set does not count"
        raise InputError(f"{name}: seal", sealed, f"the seal on record, {of_verdict[:16]}...", mend)
    if answer.id != name or verdict.get("dataset_sha256") != answer.dataset_sha256:
        mend = "the verdict is on other data: the set does not count"
        found = verdict.get("dataset_sha256")
        raise InputError(f"{name}: data", found, f"the data that were sealed, {answer.dataset_sha256[:16]}...", mend)
    if verdict.get("fit_sha256") != answer.fit_sha256:
        mend = "the verdict was told other priors, or limits, than were sealed with the set: it does not count"
        raise InputError(f"{name}: priors", verdict.get("fit_sha256"), f"the hash {answer.fit_sha256}", mend)
    if has_data(folder, name):
        _check_data(folder, name, answer.dataset_sha256)
    mark_opened(folder, name, verdict)
    return answer


def refuse_other_entry(one: Entry, answer: Answer) -> None:
    """InputError where the index says another light of a set, or other priors, than were sealed."""
    for what, found, sealed in (("light", one.light, answer.light), ("priors", one.priors, answer.priors)):
        if found != sealed:
            raise InputError(f"{one.id}: {what}", found, f"the {what} that were sealed, {sealed}", CHANGED)


def has_data(folder: Path, name: str) -> bool:
    """Whether the data of a set lie beside its seal; records that are kept have none, and nothing to check."""
    return any((folder / SETS / name / each).exists() for each in (MANIFEST, SUMS, "images"))


def _check_data(folder: Path, name: str, sealed: str) -> None:
    """Raises InputError where the data of a set, read anew, are not those that were sealed."""
    mend = "the data were changed after they were sealed: the set does not count"
    try:
        found = read_dataset(folder / SETS / name).sha256
    except InputError as error:
        raise InputError(f"{name}: data", str(error), f"the data that were sealed, {sealed[:16]}...", mend) from None
    if found != sealed:
        raise InputError(f"{name}: data", found, f"the data that were sealed, {sealed[:16]}...", mend)


def _salt(name: str, text: Any) -> bytes:
    try:
        salt = bytes.fromhex(text if isinstance(text, str) else "")
    except ValueError:
        salt = b""
    if len(salt) != SALT_BYTES:
        mend = "without it nobody can prove the answer: the set does not count"
        raise InputError(f"{name}: salt", text, f"{SALT_BYTES} bytes in hex", mend)
    return salt
