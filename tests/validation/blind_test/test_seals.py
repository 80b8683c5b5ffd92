"""Seals: they hold what was hidden, and say so where anything was changed."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import pytest

from luxloop.errors import InputError
from luxloop.words import canonical
from tests.validation.blind_test.pretend import answer, change, change_answer, folder_of, hiding, record
from validation.blind_test import told
from validation.blind_test.folders import ANSWERS, INDEX, SEAL, SETS, VERDICTS, read_index
from validation.blind_test.marks import marked
from validation.blind_test.scoring import maps_of, score
from validation.blind_test.seals import seal_of

SET = answer("set-1", hiding("vignetting"))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A set with its verdict."""
    return folder_of(tmp_path / "blind", (SET, record("one_effect", "vignetting")))


def test_an_index_that_nests_without_end_is_told(folder: Path) -> None:
    """As any that is no JSON object."""
    (folder / INDEX).write_text("[" * 100_000)
    with pytest.raises(InputError, match="FOLDER: got"):
        read_index(folder)


def test_the_seal_is_the_hash_of_salt_and_canonical_answer(folder: Path) -> None:
    """Anyone can check it with a hash program; 32 bytes of salt, another one each time."""
    opening = json.loads((folder / ANSWERS / "set-1.json").read_text())
    salt = bytes.fromhex(opening["salt"])
    assert len(salt) == 32
    text = json.dumps(opening["answer"], sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    assert canonical(SET) == text.encode()
    sealed = json.loads((folder / SETS / "set-1" / SEAL).read_text())["sha256"]
    assert sealed == hashlib.sha256(salt + text.encode()).hexdigest() == seal_of(SET, salt)
    again = folder_of(folder.parent / "again", (SET, None))
    assert json.loads((again / ANSWERS / "set-1.json").read_text())["salt"] != opening["salt"]


def test_a_seal_that_was_not_touched_opens(folder: Path) -> None:
    """The answer comes back as it was sealed."""
    (one,) = marked([folder])
    assert one.answer == SET
    assert one.is_exact


def test_records_without_data_are_said_not_to_be_checked(folder: Path) -> None:
    """Nothing but the record lies there: it counts, and the score says what was not looked at."""
    found = score([folder])
    assert found["not_checked"] == 1
    assert "data of 1 sets are not there, only their records: not checked." in list(told.scored(found))


def test_a_changed_answer_is_found(folder: Path) -> None:
    """Another kind, written into the answer after the verdict."""
    hidden = [hiding("camera_psf").model_dump(mode="json")]
    change_answer(folder, "set-1", hidden=hidden)
    with pytest.raises(InputError, match="changed after it was sealed") as error:
        score([folder])
    assert error.value.field == "set-1: answer"


def test_an_answer_that_was_sealed_anew_is_found(folder: Path) -> None:
    """Answer, salt and seal fit together, but the seal is not the one that the verdict was put on record with."""
    verdict = (folder / VERDICTS / "set-1.json").read_bytes()
    folder_of(folder, (answer("set-1", hiding("camera_psf")), None))
    assert (folder / VERDICTS / "set-1.json").read_bytes() == verdict
    with pytest.raises(InputError, match="the seal was changed after the verdict"):
        score([folder])


def test_a_verdict_on_other_data_is_found(folder: Path) -> None:
    """The record names data that are not those of the answer."""
    change(folder / VERDICTS / "set-1.json", dataset_sha256="e" * 64)
    with pytest.raises(InputError, match="the verdict is on other data"):
        score([folder])


def test_a_verdict_by_other_priors_is_found(tmp_path: Path) -> None:
    """What a set was said to be known by before is sealed with it, and so is that nothing was."""
    own, other, none = {"fit_sha256": "a" * 64}, {"fit_sha256": "b" * 64}, {"fit_sha256": None}
    for sealed, told_of in ((own, none), (none, own), (own, other), (own, {}), (own, own), (none, none), (none, {})):
        path = tmp_path / f"{len(list(tmp_path.iterdir()))}"
        folder_of(path, (answer("set-1", **sealed), record("nothing_visible", **told_of)))
        if sealed["fit_sha256"] == told_of.get("fit_sha256"):
            assert score([path])["sets"] == 1
            continue
        with pytest.raises(InputError, match="told other priors, or limits, than were sealed") as error:
            score([path])
        assert error.value.field == "set-1: priors"


@pytest.mark.parametrize("changes", [{"light": "of-another"}, {"priors": {"environment.receiver.reflectance": 0.3}}])
def test_an_index_that_says_otherwise_than_the_answer_is_found(folder: Path, changes: dict[str, Any]) -> None:
    """Another light has other random numbers, other priors another verdict: both would be a choice."""
    index = json.loads((folder / INDEX).read_text())
    index["sets"][0] |= changes
    (folder / INDEX).write_text(json.dumps(index))
    with pytest.raises(InputError, match=r"blind\.json was changed") as error:
        score([folder])
    assert error.value.field == f"set-1: {next(iter(changes))}"


@pytest.mark.parametrize("salt", [None, "", "00", "no hex", 7])
def test_a_seal_without_its_salt(folder: Path, salt: object) -> None:
    """Nothing can be proved without it."""
    change(folder / ANSWERS / "set-1.json", salt=salt)
    with pytest.raises(InputError, match="nobody can prove the answer") as error:
        score([folder])
    assert error.value.field == "set-1: salt"


def test_an_answer_that_is_missing(folder: Path) -> None:
    """Its file is named."""
    (folder / ANSWERS / "set-1.json").unlink()
    with pytest.raises(InputError, match=r"answers/set-1\.json is not there"):
        score([folder])


def test_sets_of_another_version(folder: Path) -> None:
    """Neither their folder nor a set that was put into one of this version."""
    change(folder / SETS / "set-1" / SEAL, version="0.0.1")
    with pytest.raises(InputError, match=r"a set of this version.*0\.0\.1|0\.0\.1.*a set of this version"):
        score([folder])
    change(folder / INDEX, version="0.0.1")
    with pytest.raises(InputError, match="sets of this version"):
        read_index(folder)


@pytest.mark.parametrize("changes", [{"version": "0.0.1"}, {"schema": "luxloop-blind/0"}])
def test_verdicts_of_another_version(folder: Path, changes: dict[str, str]) -> None:
    """They are no sample of one thing with those of this one."""
    change(folder / VERDICTS / "set-1.json", **changes)
    with pytest.raises(InputError, match="a verdict of this version") as error:
        score([folder])
    assert error.value.field == "set-1: verdict"


@pytest.mark.parametrize("changes", [
    {"structure": None}, {"structure": {}}, {"set": []}, {"set": "vignetting"}, {"effects": [{"name": "vignetting"}]},
    {"added": [1]}, {"solver": {"method": "twin"}}, {"solver": {"method": "anchored", "histories": None, "seed": 1}},
    {"seconds": "many"}, {"verdict": None}, {"known": None},
])  # fmt: skip
def test_a_damaged_verdict(folder: Path, changes: dict[str, Any]) -> None:
    """Each ended with a traceback of the line that read it."""
    change(folder / VERDICTS / "set-1.json", **changes)
    with pytest.raises(InputError, match="damaged") as error:
        score([folder])
    assert error.value.field.startswith("set-1: verdict")


@pytest.mark.parametrize("data", [b"", b"no maps", b"PK\x03\x04 half of them", b"\x93NUMPY"])
def test_damaged_residuals(folder: Path, data: bytes) -> None:
    """The page says which file it is."""
    (folder / VERDICTS / "set-1.npz").write_bytes(data)
    with pytest.raises(InputError, match=r"set-1\.npz"):
        maps_of([{"folder": str(folder), "id": "set-1"}])


@pytest.mark.parametrize("changes", [
    {"model_sha256": "e" * 64}, {"solver": {"method": "anchored", "histories": 10_000_000, "seed": 1}},
    {"solver": {"method": "twin", "histories": None, "seed": 2}}, {"among": ["vignetting"]}, {"known": 31},
])  # fmt: skip
def test_unlike_verdicts_are_said_first(folder: Path, tmp_path: Path, changes: dict[str, Any]) -> None:
    """Another model, solver, seed, or other effects to choose from: in the first line, with how many of each."""
    alike = score([folder])["sentence"]
    assert alike.startswith("1 sets, by model paper, the twin, seed 1, all 32 effects: of ")
    other = folder_of(tmp_path / "other", (answer("set-1", hiding("coma")), record("none_of_the_known", **changes)))
    found = score([folder, other])
    assert found["sentence"].startswith("2 sets, UNLIKE verdicts, 1 by model paper, the twin")
    assert [one["sets"] for one in found["by"]] == [1, 1]
    assert next(told.scored(found)) == found["sentence"]


def test_a_score_without_verdicts(tmp_path: Path) -> None:
    """No seal is opened: even a broken one is not looked at."""
    folder = folder_of(tmp_path, (SET, None))
    (folder / ANSWERS / "set-1.json").write_text("{")
    with pytest.raises(InputError, match="luxloop blind diagnose"):
        score([folder])


def test_only_sets_with_verdicts_are_opened(tmp_path: Path) -> None:
    """The other one's answer is damaged, which nobody sees yet."""
    folder = folder_of(tmp_path, (SET, record("one_effect", "vignetting")), (answer("set-2"), None))
    (folder / ANSWERS / "set-2.json").write_text("{")
    found = score([folder])
    assert (found["sets"], found["without_verdict"]) == (1, 1)


def test_a_folder_counts_once(folder: Path) -> None:
    """Given twice, or made twice by one seed, it is refused; two folders add up."""
    with pytest.raises(InputError, match="each set once"):
        score([folder, folder])
    again = folder_of(folder.parent / "again", (SET, record("none_of_the_known")))
    with pytest.raises(InputError, match="made by the same seed"):
        score([folder, again])
    own = answer("set-1", hiding("vignetting"), dataset_sha256="e" * 64)
    other = folder_of(folder.parent / "other", (own, record("none_of_the_known")))
    found = score([folder, other])
    assert found["sets"] == 2
    assert [one["folder"] for one in found["misses"]] == [str(other)]


def test_a_set_has_one_further_set(folder: Path) -> None:
    """The last of several stood in for all of them; which one counts is nobody's choice."""
    follows = json.loads((folder / SETS / "set-1" / SEAL).read_text())["sha256"]
    sets = [answer("set-1", hiding("vignetting"), follows=follows, dataset_sha256=data * 64) for data in "ef"]
    one, two = (folder_of(folder.parent / name, (each, record("nothing_visible")))
                for name, each in zip(("one", "two"), sets, strict=True))  # fmt: skip
    found = score([folder, one])
    assert (found["sets"], found["further"], len(found["marks"])) == (1, 1, 2)
    assert found["seconds"]["made"] == {"sets": 1, "median": 2.0, "most": 2.0, "sum": 2.0}  # once, not for both
    assert "1 further sets, with the image that a verdict proposed" in "\n".join(told.scored(found))
    with pytest.raises(InputError, match="follows the same set"):
        score([folder, one, two])


def test_a_seal_outlives_new_words(folder: Path) -> None:
    """An answer that lacks what a later one says is hashed as it stands."""
    path = folder / ANSWERS / "set-1.json"
    data = json.loads(path.read_text())
    del data["answer"]["follows"]
    path.write_text(json.dumps(data))
    sealed = seal_of(data["answer"], bytes.fromhex(data["salt"]))
    change(folder / SETS / "set-1" / SEAL, sha256=sealed)
    change(folder / VERDICTS / "set-1.json", seal=sealed)
    (one,) = marked([folder])
    assert one.answer == SET
