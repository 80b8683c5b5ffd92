"""The image that a verdict asked for: of the same truth, in a set of its own, with the images that there were."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from luxloop.errors import InputError
from luxloop.model_file import find_model
from luxloop.words import sha256_of
from tests.validation.blind_test.pretend import answer, bound_folder_of, chained, change, hiding, record
from tests.validation.blind_test.test_blind_command import HISTORIES, PIXELS, PLAN
from validation.blind_test import further as further_module
from validation.blind_test.alone import alone
from validation.blind_test.folders import (
    ANSWERS,
    INDEX,
    OPENED,
    SETS,
    VERDICTS,
    hash_of_fit,
    model_of,
    read_index,
    write_whole,
)
from validation.blind_test.further import measure, noise_seed
from validation.blind_test.making import Asked, begin, make
from validation.blind_test.records import read_record
from validation.blind_test.seals import opened
from validation.blind_test.truths import Counts
from validation.dataset.folder import read_dataset
from validation.dataset.images import read_tiff
from validation.dataset.simulation_plan import read_plan


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Three sets; the verdicts on two of them propose an image: of a new sample, and of one once more."""
    (tmp_path / "plan.toml").write_text(PLAN)
    plan = read_plan(tmp_path / "plan.toml")
    asked = Asked(tmp_path / "sets", Counts(3, nothing=3, draws=3), 4, 20.0, plan, find_model("paper"), (), PIXELS,
                  HISTORIES)  # fmt: skip
    nobody: Any = None
    sets = {one.id: one for one in make(begin(asked), nobody, nobody).sets}
    mirror = plan.samples[1].model_dump(mode="json", exclude_defaults=True)
    for name, sample in (("set-1", mirror | {"id": "next", "distance_um": 60.0}), ("set-2", mirror), ("set-3", None)):
        proposal = None if sample is None else {"sample": sample}
        sealed = json.loads((asked.folder / SETS / name / "seal.json").read_text())["sha256"]
        data = read_dataset(asked.folder / SETS / name).sha256
        said = record("cannot_tell_apart", "vignetting", seal=sealed, dataset_sha256=data, next_measurement=proposal,
                      fit_sha256=hash_of_fit(sets[name].known_before(asked.model)))  # fmt: skip
        write_whole(asked.folder / VERDICTS / f"{name}.json", said)
    return chained(asked.folder, ("set-1", "set-2", "set-3"))


def test_a_further_image_is_of_the_same_truth(folder: Path, tmp_path: Path) -> None:
    """Old images byte for byte, a new one as bright; sealed anew, with the seal of the set that it follows."""
    out = tmp_path / "further"
    index = measure(folder, out)
    assert index.sets == read_index(folder).sets[:2]  # what was known of a scene before is as it was
    assert [one.id for one in index.sets] == ["set-1", "set-2"]
    for name, frames in (("set-1", 1), ("set-2", 4)):
        old, new = read_dataset(folder / SETS / name), read_dataset(out / SETS / name)
        assert new.manifest.shots[:2] == old.manifest.shots
        for shot in old.manifest.images():
            assert new.path(shot.file).read_bytes() == old.path(shot.file).read_bytes()
        shot = new.manifest.images()[2]
        assert shot.frames_averaged == frames
        image = read_tiff(new.path(shot.file), shot.file).values
        assert image.shape == (PIXELS, PIXELS)
        assert 0.75 < (float(image.max()) - 64.0) / 3800.0 < 0.95
        before = json.loads((folder / VERDICTS / f"{name}.json").read_text())
        sealed = json.loads((out / SETS / name / "seal.json").read_text())["sha256"]
        after = opened(out, name, {"seal": sealed, "dataset_sha256": new.sha256, "fit_sha256": before["fit_sha256"]})
        assert after.follows == before["seal"] != sealed
        assert after.truth == opened(folder, name, before).truth
    assert len({noise_seed(opened(folder, name, read_record(folder, name)), 2) for name in ("set-1", "set-2")}) == 2
    again = read_dataset(out / SETS / "set-2").manifest
    assert len(again.samples) == 2
    mirror, once_more = (
        read_tiff(out / SETS / "set-2" / file, file).values.astype(float)
        for file in ("images/mirror.tif", "images/further-mirror.tif")
    )
    assert np.corrcoef(mirror.ravel(), once_more.ravel())[0, 1] > 0.95  # the same image, but for its place


def test_a_repeat_is_one_frame_of_a_sample_that_is_there(folder: Path, tmp_path: Path) -> None:
    """It adds a shot and no sample; so many frames as the verdict says, none of them less."""
    said = json.loads((folder / VERDICTS / "set-2.json").read_text())["next_measurement"]
    for ratio, name in ((1.0, "once"), (4.0, "longer")):
        change(folder / VERDICTS / "set-2.json", next_measurement=said | {"exposure_ratio": ratio})
        chained(folder, ("set-1", "set-2", "set-3"))
        for opened_set in (folder / "opened").glob("*.json"):
            opened_set.unlink()  # the chain was written anew
        measure(folder, tmp_path / name)
        manifest = read_dataset(tmp_path / name / SETS / "set-2").manifest
        assert len(manifest.samples) == 2
        assert manifest.images()[2].frames_averaged == ratio


def test_further_images_of_one_truth_have_noise_of_their_own(folder: Path, tmp_path: Path) -> None:
    """Three sets of one light that ask for the same image: the frames shared their noise, bit for bit."""
    mirror = json.loads((folder / VERDICTS / "set-2.json").read_text())["next_measurement"]["sample"]
    for name in ("set-1", "set-2"):
        said = {"sample": mirror | {"id": "next", "distance_um": 60.0}}
        change(folder / VERDICTS / f"{name}.json", next_measurement=said)
    chained(folder, ("set-1", "set-2", "set-3"))
    measure(folder, tmp_path / "further")
    one, two = (
        read_tiff(tmp_path / "further" / SETS / name / "images/further-next.tif", name).values.astype(float)
        for name in ("set-1", "set-2")
    )
    assert not np.array_equal(one, two)
    assert np.corrcoef(one.ravel(), two.ravel())[0, 1] > 0.9


def test_the_truth_is_about_a_model_of_ones_own(tmp_path: Path) -> None:
    """Its copy lies in both folders: `measure` finds it where the file that it came from is gone."""
    (tmp_path / "plan.toml").write_text(PLAN)
    plan = read_plan(tmp_path / "plan.toml")
    model = find_model("clear_chip").with_value("environment.receiver.reflectance", 0.21)
    asked = Asked(tmp_path / "sets", Counts(1, nothing=1), 4, 20.0, plan, model, (), PIXELS, HISTORIES)
    nobody: Any = None
    index = make(begin(asked), nobody, nobody)
    sealed, data = index.seals["set-1"], read_dataset(asked.folder / SETS / "set-1").sha256
    asks = {"sample": plan.samples[1].model_dump(mode="json", exclude_defaults=True)}
    said = record("cannot_tell_apart", "vignetting", seal=sealed, dataset_sha256=data, next_measurement=asks,
                  fit_sha256=hash_of_fit(index.sets[0].known_before(model)))  # fmt: skip
    write_whole(asked.folder / VERDICTS / "set-1.json", said)
    chained(asked.folder, ["set-1"])
    further = measure(asked.folder, tmp_path / "further")
    assert model_of(tmp_path / "further", further) == model


def test_no_seal_is_opened_while_a_diagnosis_works(tmp_path: Path) -> None:
    """Sets of its truths have no verdict yet: `measure` waits, as `score` does."""
    asks = {"sample": {"id": "next"}}
    said = record("cannot_tell_apart", "vignetting", next_measurement=asks)
    folder = bound_folder_of(tmp_path / "sets", (answer("set-1", hiding("vignetting")), said))
    with alone(folder, "diagnose"), pytest.raises(InputError, match="a folder that nobody works in"):
        measure(folder, tmp_path / "out")
    assert not (folder / OPENED).exists()
    assert not (tmp_path / "out").exists()


def test_it_goes_on_and_refuses_other_sets(folder: Path, tmp_path: Path) -> None:
    """What is there stays, one more verdict adds a set; verdicts that ask for nothing and another truth are said."""
    out = tmp_path / "further"
    measure(folder, out)
    kept = (out / SETS / "set-1" / "seal.json").read_bytes()
    assert measure(folder, out) == measure(folder, out) == read_index(out)
    assert (out / SETS / "set-1" / "seal.json").read_bytes() == kept
    said = json.loads((folder / VERDICTS / "set-2.json").read_text())["next_measurement"]
    change(folder / VERDICTS / "set-3.json", next_measurement=said)
    chained(folder, ("set-1", "set-2", "set-3"))
    for name in ("set-1", "set-2"):
        (folder / "opened" / f"{name}.json").unlink()  # the chain was written anew
    grown = measure(folder, out)
    assert [one.id for one in grown.sets] == ["set-1", "set-2", "set-3"]
    assert grown.root == sha256_of(grown.seals) == sha256_of(read_index(out).seals)
    assert (out / SETS / "set-1" / "seal.json").read_bytes() == kept
    with pytest.raises(InputError, match="verdicts that propose an image"):
        measure(out, tmp_path / "nothing")
    index = json.loads((folder / INDEX).read_text())
    other = index | {"sets": [one | {"priors": {}} for one in index["sets"]]}
    (folder / INDEX).write_text(json.dumps(other))
    with pytest.raises(InputError, match=r"set-1: priors: .* the priors that were sealed"):
        measure(folder, tmp_path / "by-others")
    (folder / INDEX).write_text(json.dumps(index))
    path = folder / ANSWERS / "set-1.json"
    data = json.loads(path.read_text())
    data["answer"]["seed"] += 1
    path.write_text(json.dumps(data))
    with pytest.raises(InputError, match="changed after it was sealed"):
        measure(folder, tmp_path / "other")


def test_a_verdict_on_a_further_set_may_ask_for_one_more(folder: Path, tmp_path: Path) -> None:
    """The same truth, an image more, of a name that no shot has: it follows the set that asked for it."""
    first, second = tmp_path / "first", tmp_path / "second"
    measure(folder, first)
    before = read_record(folder, "set-2")
    sealed = json.loads((first / SETS / "set-2" / "seal.json").read_text())["sha256"]
    asks = before | {"seal": sealed, "dataset_sha256": read_dataset(first / SETS / "set-2").sha256}
    write_whole(first / VERDICTS / "set-2.json", asks)
    chained(first, ["set-2"])
    assert [one.id for one in measure(first, second).sets] == ["set-2"]
    manifest = read_dataset(second / SETS / "set-2").manifest
    assert [shot.id for shot in manifest.shots[2:]] == ["further-mirror", "further-mirror-2"]
    again = json.loads((second / ANSWERS / "set-2.json").read_text())["answer"]
    assert again["follows"] == sealed


def test_what_is_there_is_neither_mixed_nor_unbound(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another's folder is refused; killed while it grows, OUT is bound as it was, and the next time goes on."""
    other = tmp_path / "photos"
    other.mkdir()
    (other / "mine.txt").write_text("mine")
    with pytest.raises(InputError, match=r"OUT: got .*an empty folder"):
        measure(folder, other)
    out = tmp_path / "out"
    bound = measure(folder, out)
    said = json.loads((folder / VERDICTS / "set-2.json").read_text())["next_measurement"]
    change(folder / VERDICTS / "set-3.json", next_measurement=said)
    chained(folder, ("set-1", "set-2", "set-3"))
    for name in ("set-1", "set-2"):
        (folder / "opened" / f"{name}.json").unlink()  # the chain was written anew

    def killed(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(further_module, "taken", killed)
        with pytest.raises(KeyboardInterrupt):
            measure(folder, out)
    assert read_index(out) == bound
    assert len(measure(folder, out).sets) == 3
    shutil.rmtree(out / SETS / "set-1")
    with pytest.raises(InputError, match=r"set-1: data: .* a set that is on record"):
        measure(folder, out)
