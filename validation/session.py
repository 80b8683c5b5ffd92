"""A command of this room at work: the model file, the data set, the workers, and the run that keeps it on record.

with session(settings, subject, "compare") as at:
    ... at.predictor.images(...) ...
    at.record(document, residual_maps)

Every such command is a run of kind validation: its journal holds the model file, the manifest, the document that was
told, the map of residuals of every image, and all that the workers were asked (`validation.asked`).
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from luxloop import __version__
from luxloop.campaign import MAX_ATTACHMENT, Fidelity, Plan
from luxloop.client import Client
from luxloop.design import Bounds, Design
from luxloop.door import RunDoor
from luxloop.errors import InputError
from luxloop.failure import printable
from luxloop.model import Data, Model
from luxloop.model_file import SHIPPED, find_model, parse_toml, read_text, to_toml
from luxloop.settings import Settings, usable_cache
from validation.asked import COMMAND, Asking
from validation.cautions import faults_of
from validation.dataset.folder import Dataset, read_dataset
from validation.dataset.manifest_file import MANIFEST
from validation.effects.known import Known
from validation.model_versions import save, try_to_save
from validation.prediction import Predictor
from validation.sample_values import is_by_sample, refuse_strangers

if TYPE_CHECKING:
    from luxloop.bus.frame import Array

PATIENCE_S = 300.0
"""A worker that starts for the first time compiles its kernels."""
MOST_TASKS = 10_000
"""Whose ids stand with a step; the requests themselves have no such limit."""
DEFAULT_MODEL = "model.toml"
MODEL_START = "paper"
"""Of the shipped models the one that a model file begins with."""


@dataclass(frozen=True)
class Subject:
    """A model file and the measurements that it is compared with."""

    file: str
    model: Model
    dataset: Dataset
    text: str = ""
    """Of the file, as it was read; "": a shipped model."""

    def saved(self, model: Model, command: str, errors: Mapping[str, float]) -> int | None:
        """The model written to its file: the number of the version; None for a shipped one, which never changes.

        Raises InputError where somebody has edited the file since it was read.
        """
        if self.file in SHIPPED:
            return None
        path = Path(self.file)
        if not path.exists() or read_text(path) != self.text:
            mend = "it is as it was edited; look at it (luxloop model diff) and run this again"
            raise InputError("--model", self.file, "a file that nobody edits while a command runs on it", mend)
        return save(path, model, command, dict(errors)).number

    @property
    def with_data(self) -> Model:
        """The model with these data on record: their folder as seen from the model file, and their hash."""
        here = Path(self.file).resolve().parent
        return self.model.model_copy(
            update={"data": Data(path=_near(self.dataset.folder, here), sha256=self.dataset.sha256)}
        )


def refuse_unwritable(file: str) -> None:
    """Raises InputError where a model file could not be saved, before anything is computed; a shipped one is none."""
    if file not in SHIPPED:
        try_to_save(Path(file))


def subject_of(file: str, dataset: Path | None) -> Subject:
    """The model in a file (begun from the paper's where there is none) and its data: those given, or those on record.

    Raises InputError where neither names data, or the data on record have changed since.
    """
    path, given = Path(file), None if dataset is None else read_dataset(dataset)
    if file not in SHIPPED and not path.exists() and given is not None:
        if not path.absolute().parent.is_dir():
            raise InputError("--model", file, "a file in a folder that exists", f"make {path.parent} first")
        begun = find_model(MODEL_START).model_copy(update={"name": path.stem})
        save(path, begun, f"begun from {MODEL_START}")
        sys.stderr.write(f"luxloop: {file} did not exist: begun from the model {MODEL_START!r}\n")
    text = "" if file in SHIPPED else read_text(path)
    model = parse_toml(text, path.name) if text else find_model(file)
    if given is not None:
        return Subject(file, _of_these_samples(model, path.parent, given), given, text)
    if model.data is None:
        mend = "luxloop compare DATASET comes first"
        mend += f", with a --model file of your own: {file} ships, and keeps no data" if file in SHIPPED else ""
        raise InputError("--model", file, "a model that was compared with data", mend)
    found = read_dataset((path.parent / model.data.path).resolve())
    if found.sha256 != model.data.sha256:
        mend = "luxloop compare DATASET takes them as they are now"
        raise InputError("[data]", str(found.folder), f"data as they were compared, {model.data.sha256[:12]}", mend)
    return Subject(file, _of_these_samples(model, path.parent, found), found, text)


def _of_these_samples(model: Model, here: Path, dataset: Dataset) -> Model:
    """The model, without what it says of the samples of other data: another folder has other samples.

    Raises InputError for values of a sample that these data do not have.
    """
    if model.data is not None and (here / model.data.path).resolve() != dataset.folder.resolve() and model.samples:
        sys.stderr.write(f"luxloop: values by sample are of {model.data.path}, not of these data: left out\n")
        left = {path: one for path, one in model.fit.items() if not is_by_sample(model, path)}
        return model.model_copy(update={"samples": {}, "fit": left})
    refuse_strangers(model, [sample.id for sample in dataset.manifest.samples])
    return model


@dataclass
class Session:
    """A run of kind validation that is open."""

    subject: Subject
    command: str
    seed: int
    door: RunDoor
    asking: Asking
    predictor: Predictor
    faults: tuple[str, ...] = ()
    """Of the data, for the warnings of a document."""

    def record(self, document: Mapping[str, Any], residual_maps: Mapping[str, Array]) -> None:
        """Put a step on record with its maps (row, column) of residuals in standard deviations, 0 where unused."""
        of = {
            "model_sha256": self.subject.model.sha256, "dataset_sha256": self.subject.dataset.sha256,
            "seed": str(self.seed),
        }  # fmt: skip
        for asked in self.asking.records():
            self.door.note(validation={"command": COMMAND, "document": asked, **of})
        told = {"command": self.command, "tasks": tuple(self.asking.tasks)[:MOST_TASKS], "document": dict(document)}
        self.door.note(validation=told | of)
        for shot, image in residual_maps.items():
            rows = tuple(tuple(float(f"{value:.5g}") for value in row) for row in image)
            self.door.note(residual_maps={shot: rows})


@contextmanager
def session(
    settings: Settings, subject: Subject, command: str, *, seed: int = 1, local: bool = True, say: bool = True
) -> Iterator[Session]:
    """Workers that answer (a running set, else one of our own), and a run at their controller.

    Faults of the data are told first. Raises RemoteError where the controller refuses or cannot be reached.
    """
    usable_cache(settings)
    faults = tuple(faults_of(subject.dataset.folder))
    if say:
        sys.stderr.writelines(f"luxloop: {fault}\n" for fault in faults)
    name = f"{datetime.now(UTC):%Y%m%d-%H%M%S}-{command}-{os.getpid()}"
    with Client(settings, local=local, patience_s=PATIENCE_S) as client:
        facts = {
            "argv": [*map(printable, sys.argv[1:])], "version": __version__,
            "dataset_sha256": subject.dataset.sha256,
        }  # fmt: skip
        with RunDoor.begin(client, _plan(name, subject), facts, _attachments(subject)) as door:
            asking = Asking(client)
            if subject.model.effects:  # before anything is traced
                Known.ask(asking).refuse_unknown(subject.model)
            try:
                yield Session(subject, command, seed, door, asking, Predictor(asking), faults)
            except KeyboardInterrupt:
                sys.stderr.write(f"luxloop: {command} interrupted; its run so far is {door.begun.folder}\n")
                raise
            ended = door.end("told", complete=True)
    if say:
        sys.stderr.write(f"luxloop: on record in {ended.folder}, root {ended.root}\n")


def _plan(name: str, subject: Subject) -> Plan:
    """What the controller must know; nothing is designed, so the box is that of the samples."""
    samples = [sample.design for sample in subject.dataset.manifest.samples if sample.layout == "array"]
    bounds = _box(samples) if samples else Bounds.preset("paper-table3")
    fidelity = Fidelity(method="twin", histories=131_072)
    model = subject.model
    return Plan(
        run=name, kind="validation", model=subject.file, environment=model.environment, effects=model.effects,
        bounds=bounds, walk=fidelity, final=fidelity,
    )  # fmt: skip


def _box(designs: Sequence[Design]) -> Bounds:
    ends = [{name: pick(getattr(one, name) for one in designs) for name in Design.FIELDS} for pick in (min, max)]
    step = Design.from_vector((1.0, 1.0, 1.0, 1.0, 0.5))
    return Bounds(low=Design(**ends[0]), high=Design(**ends[1]), step=step)


def _attachments(subject: Subject) -> dict[str, str]:
    """The model file, and the manifest unless it is too long for an attachment: its hash is on record anyway."""
    manifest = (subject.dataset.folder / MANIFEST).read_text(encoding="utf-8-sig")
    files = {"model.toml": to_toml(subject.model), MANIFEST: manifest}
    return {name: text for name, text in files.items() if len(text) <= MAX_ATTACHMENT}


def _near(folder: Path, here: Path) -> str:
    """The folder as seen from `here` where it lies below or beside, else its whole path."""
    whole = folder.resolve()
    return str(os.path.relpath(whole, here)) if whole.is_relative_to(here.parent) else str(whole)
