"""Sealed sets that stay what they are: their seals, the table of their verdicts, and one verdict anew.

    luxloop blind make FIXED --plan tests/validation/blind_test/fixed/plan.toml --pixels 32 --histories 400000 \
        --seed 2026 --sets 8 --outside 2 --two 1 --nothing 2 --draws 2 --per-truth 6 \
        --kinds clipped_pupil,weak_chip,swapped_layers,lens_flare,stray_daylight,smear,coma
    luxloop blind diagnose FIXED --histories 1000000 --among vignetting,dead_chip,dbr_layer_order,ambient_gradient
    luxloop blind score FIXED --json > FIXED/score.json

Three images of 32 x 32 pixels, four effects to choose
from, a Monte Carlo as noisy as the camera: these verdicts say little of how good a diagnosis is. They say when it
changes, and that whatever is changed in a sealed set is found.
"""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from luxloop.errors import InputError
from luxloop.model_file import find_model
from tests.validation.blind_test.pretend import change, change_answer
from tests.validation.workers import Workers
from validation.blind_test import folders, seals
from validation.blind_test.folders import ANSWERS, INDEX, SETS, VERDICTS, read_index, read_json
from validation.blind_test.judging import Judge
from validation.blind_test.records import read_record
from validation.blind_test.scoring import score
from validation.comparing import Solver
from validation.dataset.folder import read_dataset
from validation.effects.known import Known
from validation.prediction import Predictor

FIXED = Path(__file__).parent / "fixed"
NAMES = sorted(path.stem for path in (FIXED / VERDICTS).glob("*.json"))
ANEW = ("set-4", "set-5")
"""Those that are diagnosed anew: layers swapped, nothing hidden."""

REDEFINED = {
    "held-out error falls with the true effect",
    "held-out error does not fall with another group's", "sets without a held-out fall with another group's",
    "diagnosis of six images in 60 s or less", "six images by the twin in 60 s or less",
    "six images by Monte Carlo in 30 min or less", "outside, sigma_rival >= 5: none_of_the_known",
    "outside, sigma_rival < 5: such a rival named",
}  # fmt: skip
"""Rows that are new, or count something else, since the score was put on record."""


@pytest.fixture
def fixed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of the folder, read as the release that made it: a later one refuses to add its verdicts to its own."""
    folder = Path(shutil.copytree(FIXED, tmp_path / "fixed"))
    made_by = read_json(folder / INDEX, "FOLDER", "an index", "")["version"]
    for module in (folders, seals):
        monkeypatch.setattr(module, "__version__", made_by)
    return folder


def recorded() -> dict[str, Any]:
    """The score as it was when the sets were made."""
    found: dict[str, Any] = json.loads((FIXED / "score.json").read_text(encoding="utf-8"))
    return found


def test_the_seals_open_and_the_table_is_the_recorded_one(fixed: Path) -> None:
    """Of all sets with a verdict: hits, counts, intervals, who was taken for whom, what was missed."""
    found, before = json.loads(json.dumps(score([fixed]))), recorded()
    assert found["sets"] == len(NAMES) == before["sets"]
    assert found["not_checked"] == 0
    rows, olds = ({row["quantity"]: row for row in one["table"]} for one in (found, before))
    assert rows.keys() - REDEFINED == olds.keys() - REDEFINED
    for quantity in olds.keys() - REDEFINED:
        row = rows[quantity]
        for name, value in olds[quantity].items():
            assert row[name] == (pytest.approx(value, rel=1e-9) if isinstance(value, float) else value)
    assert found["confusion"] == before["confusion"]
    told = ("id", "truth", "said", "verdict", "set", "missed", "sigma", "sigma_rival", "sentence")
    for one, old in zip(found["marks"], before["marks"], strict=True):
        assert {name: one[name] for name in told} == {name: old[name] for name in told}


@pytest.mark.parametrize("name", NAMES)
def test_whatever_is_changed_in_a_set_is_found(fixed: Path, name: str) -> None:
    """Its answer, its salt, an image that is changed or gone, the manifest: the error names the set."""
    kept = (fixed / ANSWERS / f"{name}.json").read_text()
    change_answer(fixed, name, hidden=[])
    if json.loads(kept)["answer"]["hidden"]:
        with pytest.raises(InputError, match="changed after it was sealed") as error:
            score([fixed])
        assert error.value.field == f"{name}: answer"
    (fixed / ANSWERS / f"{name}.json").write_text(kept)
    change_answer(fixed, name, seed=0)
    with pytest.raises(InputError, match="changed after it was sealed"):
        score([fixed])
    (fixed / ANSWERS / f"{name}.json").write_text(kept)
    change(fixed / ANSWERS / f"{name}.json", salt="00" * 32)
    with pytest.raises(InputError, match=f"{name}: answer"):
        score([fixed])
    (fixed / ANSWERS / f"{name}.json").write_text(kept)
    dataset = read_dataset(fixed / SETS / name)
    assert dataset.sha256 == json.loads(kept)["answer"]["dataset_sha256"]
    image = fixed / SETS / name / "images" / "bare.tif"
    data = bytearray(image.read_bytes())
    data[-1] ^= 1
    image.write_bytes(bytes(data))
    with pytest.raises(InputError, match=r"bare\.tif"):
        score([fixed])
    image.unlink()
    with pytest.raises(InputError, match="the data were changed") as error:
        score([fixed])
    assert error.value.field == f"{name}: data"
    data[-1] ^= 1
    image.write_bytes(bytes(data))
    with (fixed / SETS / name / "dataset.toml").open("a") as manifest:
        manifest.write("# more\n")
    with pytest.raises(InputError, match="the data were changed"):
        score([fixed])


def test_a_verdict_on_other_data_is_found(fixed: Path) -> None:
    """Its record names data that are not those of the answer."""
    name = NAMES[0]
    change(fixed / VERDICTS / f"{name}.json", dataset_sha256="0" * 64)
    with pytest.raises(InputError, match="the verdict is on other data"):
        score([fixed])


@pytest.mark.slow
@pytest.mark.parametrize("name", ANEW)
def test_a_set_diagnosed_anew_has_the_recorded_verdict(fixed: Path, tmp_path: Path, name: str) -> None:
    """By workers in this process: verdict, named effects, share explained."""
    before = read_record(fixed, name)
    (fixed / VERDICTS / f"{name}.json").unlink()
    workers = Workers(tmp_path / "blobs")
    solver = Solver(int(before["solver"]["histories"]), int(before["solver"]["seed"]))
    judge = Judge(
        fixed, find_model("paper"), Predictor(workers), Known.ask(workers), solver, None, tuple(before["among"])
    )
    index = read_index(fixed)
    (found,) = judge.verdicts(index.model_copy(update={"sets": tuple(one for one in index.sets if one.id == name)}))
    assert (found["id"], found["verdict"], found["set"]) == (name, before["verdict"], before["set"])
    assert [one["name"] for one in found["effects"][:1]] == [one["name"] for one in before["effects"][:1]]
    for best, old in zip(found["effects"][:1], before["effects"][:1], strict=True):
        assert best["explained_share"] == pytest.approx(old["explained_share"], abs=0.05)
    assert found["seal"] == before["seal"]
