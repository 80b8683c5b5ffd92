"""The image that a verdict asked for, taken of the same truth: a folder of sets with one image more.

Whoever has the answers plays the laboratory: a set whose verdict could not tell effects apart gets the image that was
proposed, with what is hidden in it; the images that it had stay as they are. The further set has a seal of its own.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from luxloop.errors import InputError
from luxloop.words import parse, sha256_of
from validation import blind
from validation.blind_test.alone import alone, refuse_busy
from validation.blind_test.bound import chain_of, check_root, close, refuse_gone
from validation.blind_test.folders import (
    INDEX,
    MODEL,
    SETS,
    Entry,
    Index,
    is_empty,
    model_of,
    move_whole,
    read_index,
    write_whole,
)
from validation.blind_test.records import read_record, record_path
from validation.blind_test.scenes import Lights, mean_of
from validation.blind_test.seals import Answer, opened, refuse_other_entry, seal
from validation.blind_test.truths import Truth, camera_of, sample_of, truth_of
from validation.dataset.folder import Dataset, read_dataset, write_sums
from validation.dataset.images import read_tiff, write_tiff
from validation.dataset.manifest import ImageShot, Sample
from validation.dataset.manifest_file import MANIFEST
from validation.dataset.manifest_file import to_toml as manifest_text
from validation.dataset.simulated_images import expected_images, views_of
from validation.dataset.simulation_plan import Plan
from validation.diagnose.next_measurement import EXPOSURES
from validation.diagnose.proposal import free_id


def measure(folder: Path, out: Path, heard: Callable[[int, int, str], None] = lambda *_: None) -> Index:
    """All further sets that are not there yet. `heard` is told how many of how many there are.

    OUT grows where further verdicts ask for an image. Raises InputError where none does, where a diagnosis works in
    FOLDER, where OUT has other sets, and as `seals.opened` does.
    """
    refuse_busy(folder)
    asked = _asked(folder, out)
    with alone(out, "measure", "OUT"):
        if asked.model == MODEL:
            write_whole(out / MODEL, (folder / MODEL).read_bytes())
        if not (out / INDEX).exists():  # else it stays as it was bound until all that is new is there
            write_whole(out / INDEX, asked.text())
        for number, one in enumerate(asked.sets):
            heard(number, len(asked.sets), one.id)
            if not (out / SETS / one.id).is_dir():
                _measure_one(folder, out, one, asked)
        heard(len(asked.sets), len(asked.sets), "done")
        return close(out, asked)


def _asked(folder: Path, out: Path) -> Index:
    """The sets whose verdicts propose an image: those that are in OUT, and others since."""
    whole = read_index(folder)
    check_root(folder, whole)
    chain_of(folder, whole)
    asking = [one for one in whole.sets if _proposal(folder, one.id) is not None]
    if not asking:
        mend = "only verdicts that cannot tell effects apart propose one (luxloop blind diagnose comes first)"
        raise InputError("FOLDER", str(folder), "verdicts that propose an image", mend)
    index = whole.model_copy(update={"sets": tuple(asking), "seals": {}, "root": None})
    if not (out / INDEX).exists():
        if out.exists() and not is_empty(out):
            raise InputError("OUT", str(out), "an empty folder, or one that is not there yet", "name another one")
        return index
    there = read_index(out)
    refuse_gone(out, there)
    is_of_these = all(one in index.sets for one in there.sets)
    if there.model_copy(update={"sets": index.sets, "seals": {}, "root": None}) != index or not is_of_these:
        raise InputError("OUT", str(out), "an empty folder, or one that the same command began", "name another one")
    return index.model_copy(update={"seals": there.seals, "root": there.root})


def _proposal(folder: Path, name: str) -> dict[str, Any] | None:
    """The image that the verdict on a set proposes."""
    if not record_path(folder, name).exists():
        return None
    found: dict[str, Any] | None = read_record(folder, name)["next_measurement"]
    return found


def _measure_one(folder: Path, out: Path, one: Entry, index: Index) -> None:
    record = read_record(folder, one.id)
    answer = opened(folder, one.id, record)
    refuse_other_entry(one, answer)
    dataset = read_dataset(folder / SETS / one.id)
    asked = record["next_measurement"]
    sample = parse(Sample, asked["sample"], "next_measurement.sample")
    is_there = sample.id in {each.id for each in dataset.manifest.samples}
    frames = int(asked.get("exposure_ratio", EXPOSURES if is_there else 1.0))  # older verdicts do not say
    count = len(dataset.manifest.shots)
    truth = truth_of(int(answer.truth["number"]), model_of(out, index), count + 1, answer.seed)
    image, exposure_ms = taken(truth, dataset, sample, answer, frames)
    temporary = out / SETS / f".{one.id}"
    shutil.rmtree(temporary, ignore_errors=True)
    shutil.copytree(dataset.folder / "images", temporary / "images")
    name = free_id(f"further-{sample.id}", [each.id for each in dataset.manifest.shots])
    shot = ImageShot(
        id=name, kind="image", sample=sample.id, file=f"images/{name}.tif",
        exposure_ms=exposure_ms, frames_averaged=frames,
    )  # fmt: skip
    write_tiff(temporary / shot.file, image.astype(np.uint16 if frames == 1 else np.float32))
    old = dataset.manifest
    samples = old.samples if is_there else (*old.samples, sample)
    manifest = old.model_copy(update={"samples": samples, "shots": (*old.shots, shot)})
    (temporary / MANIFEST).write_text(manifest_text(manifest), encoding="utf-8")
    write_sums(temporary)
    changed = {"dataset_sha256": read_dataset(temporary).sha256, "follows": record["seal"]}
    seal(out, temporary, answer.model_copy(update=changed))
    write_sums(temporary)
    move_whole(temporary, out / SETS / one.id)


def taken(truth: Truth, dataset: Dataset, sample: Sample, answer: Answer, frames: int) -> tuple[blind.Real, float]:
    """A further image (row, column) of a truth in raw DN, and its exposure in ms.

    Its peak is as high as that of the others. Raises InputError where the truth is not the one of the answer.
    """
    old, poses = dataset.manifest.images(), len(answer.truth["poses"])  # of the set's first images
    known = {"surroundings": truth.document()["surroundings"], "poses": truth.document()["poses"][:poses]}
    if any(answer.truth[name] != value for name, value in known.items()):
        mend = "the model that the sets were made with has changed"
        raise InputError(f"{answer.id}: answer", "another truth", "the truth that the answer names", mend)
    facts = dataset.manifest.camera
    if facts is None:
        raise ValueError(f"{answer.id}: images without a camera")
    pixels = read_tiff(dataset.path(old[0].file), old[0].file).values.shape[0]
    camera = camera_of(facts, pixels)
    hidden = [blind.Hidden(one.kind, one.amount, one.seed) for one in answer.hidden]
    alone = Truth(truth.number, truth.model, truth.poses[-1:], truth.seed)
    (light,) = mean_of(Lights(alone, [sample_of(sample)], camera, answer.histories).of(hidden))
    plan = Plan(camera=facts, samples=(sample,))
    (lit,) = expected_images(views_of(plan, 0, pixels, pixels), [light], facts)
    dn_per_ms = float(lit.signal_dn.max() / lit.irradiance_per_mm2.max()) / lit.exposure_ms
    number = len(old)  # what a camera draws for each image, it draws anew for this one
    signal = blind.signals([light] * (number + 1), [lit.exposure_ms] * (number + 1), dn_per_ms, camera, hidden)[-1]
    raw = blind.recorded([signal] * (number + frames), camera, hidden, noise_seed(answer, number))[number:]
    return np.mean(raw, axis=0), lit.exposure_ms


def noise_seed(answer: Answer, number: int) -> int:
    """Of the noise of a set's further image: its own, for sets may share a truth."""
    return int(sha256_of({"seed": answer.seed, "id": answer.id, "image": number})[:12], 16)
