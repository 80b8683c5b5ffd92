"""What binds sets and verdicts: a miss cannot be taken away, changed or made anew without being found."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from luxloop.errors import InputError
from luxloop.words import sha256_of
from tests.validation.blind_test.pretend import answer, bound_folder_of, change, folder_of, hiding, record
from validation.blind_test import told
from validation.blind_test.bound import Chain, chain_of, close, gone, refuse_gone, refuse_opened
from validation.blind_test.folders import (
    ANSWERS,
    ASKED,
    CHAIN,
    INDEX,
    OPENED,
    SETS,
    VERDICTS,
    read_index,
    write_whole,
)
from validation.blind_test.scoring import score

NAMES = ("set-1", "set-2", "set-3")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Three sets with verdicts, the second a miss; a fourth without."""
    said = ("vignetting", "camera_psf", "vignetting")
    sets = [
        (answer(name, hiding("vignetting")), record("one_effect", one)) for name, one in zip(NAMES, said, strict=True)
    ]
    return bound_folder_of(tmp_path / "blind", *sets, (answer("set-4"), None))


def test_what_nobody_touched_counts(folder: Path) -> None:
    """Twice, too; the root is told."""
    found = score([folder])
    assert (found["sets"], len(found["misses"])) == (3, 1)
    assert score([folder]) == found
    index = read_index(folder)
    assert index.root == sha256_of(index.seals)
    assert found["roots"] == {str(folder): index.root}
    assert any(str(index.root) in line for line in told.scored(found))


def test_the_last_verdict_is_told_and_a_miss_that_is_dropped_after_the_score_is_found(folder: Path) -> None:
    """The chain put back by hand to the verdict before: its seal was opened, so it is missed."""
    found = score([folder])
    last = json.loads((folder / VERDICTS / "set-3.json").read_text())
    assert found["last_verdicts"] == {str(folder): f"3, the last {last['sha256']}"}
    assert any(last["sha256"] in line for line in told.scored(found))
    (folder / VERDICTS / "set-3.json").unlink()
    change(folder / CHAIN, records=2, last=last["before"])
    with pytest.raises(InputError, match=r"set-3: verdict.*put back the verdict"):
        score([folder])


def test_residuals_of_another_verdict_are_found(folder: Path) -> None:
    """Those that diagnose wrote have their hash in the record; without the file the page goes without."""
    maps = folder / VERDICTS / "set-1.npz"
    maps.write_bytes(b"of this verdict")
    said = record("one_effect", "vignetting", maps_sha256=hashlib.sha256(b"of this verdict").hexdigest())
    other = bound_folder_of(folder.parent / "maps", (answer("set-1", hiding("vignetting")), said))
    assert score([other])["sets"] == 1
    (other / VERDICTS / "set-1.npz").write_bytes(b"of another one")
    with pytest.raises(InputError, match="set-1: residuals"):
        score([other])


def test_an_index_whose_root_was_taken_out_is_found(folder: Path) -> None:
    """It lists the seals of all sets: somebody bound them."""
    change(folder / INDEX, root=None)
    with pytest.raises(InputError, match="no root"):
        score([folder])


@pytest.mark.parametrize("also_seals", [False, True])
def test_a_set_taken_out_of_the_index_is_found(folder: Path, also_seals: bool) -> None:
    """Whether or not its seal is taken out, too."""
    data = json.loads((folder / INDEX).read_text())
    data["sets"] = [one for one in data["sets"] if one["id"] != "set-4"]
    if also_seals:
        del data["seals"]["set-4"]
    (folder / INDEX).write_text(json.dumps(data))
    with pytest.raises(InputError, match="all sets of the root"):
        score([folder])


def test_fewer_sets_than_were_asked_for(folder: Path) -> None:
    """The index was written anew with a root of its own, but the answers' folder says how many there were."""
    write_whole(folder / ANSWERS / ASKED, {"sets": 4})
    assert score([folder])["without_verdict"] == 1
    index = read_index(folder)
    fewer = index.model_copy(update={"sets": index.sets[:3], "seals": {}, "root": None})
    close(folder, fewer)
    with pytest.raises(InputError, match="4 that were asked for"):
        score([folder])


def test_another_seal_is_found_without_any_verdict(folder: Path) -> None:
    """The seal of a set that nobody has judged: it is bound by the root, and closing anew refuses it."""
    change(folder / "sets" / "set-4" / "seal.json", sha256="0" * 64)
    with pytest.raises(InputError, match="set-4: seal"):
        score([folder])
    with pytest.raises(InputError, match="set-4: seal"):
        close(folder, read_index(folder))


def test_an_edited_verdict_is_found(folder: Path) -> None:
    """Its hash is its own; with that written anew, too, the record after it says so."""
    path = folder / VERDICTS / "set-2.json"
    change(path, set=["vignetting"])
    with pytest.raises(InputError, match="it was edited") as error:
        score([folder])
    assert error.value.field == "set-2: verdict"
    first = json.loads((folder / VERDICTS / "set-1.json").read_text())
    write_whole(path, Chain(1, first["sha256"]).added(json.loads(path.read_text())))
    with pytest.raises(InputError, match="a verdict was taken away, or made anew") as error:
        score([folder])
    assert error.value.field == "set-3: verdict"


@pytest.mark.parametrize("name", NAMES)
def test_a_verdict_taken_away_is_found(folder: Path, name: str) -> None:
    """The first, one between, the last; no further verdict is given on top of it."""
    (folder / VERDICTS / f"{name}.json").unlink()
    with pytest.raises(InputError, match="taken away"):
        score([folder])
    with pytest.raises(InputError, match="taken away"):
        chain_of(folder, read_index(folder))


def test_a_verdict_without_a_number_is_found(folder: Path) -> None:
    """It was put there by hand."""
    path = folder / VERDICTS / "set-4.json"
    write_whole(path, record("nothing_visible", id="set-4"))
    with pytest.raises(InputError, match="a record without a number"):
        score([folder])


def test_a_chain_goes_on_after_a_kill_between_two_writings(folder: Path) -> None:
    """The record is there, the chain's end does not name it yet."""
    last = json.loads((folder / VERDICTS / "set-3.json").read_text())
    change(folder / CHAIN, records=2, last=last["before"])
    assert chain_of(folder, read_index(folder)) == Chain(3, last["sha256"])


@pytest.mark.parametrize("make", [folder_of, bound_folder_of])
def test_a_verdict_made_after_its_seal_was_opened_is_refused(make: Callable[..., Path], tmp_path: Path) -> None:
    """Even in a folder without a chain, and in one whose chain was written anew."""
    one = answer("set-1", hiding("vignetting"))
    folder = make(tmp_path / "a", (one, record("one_effect", "camera_psf")))
    score([folder])
    assert (folder / OPENED / "set-1.json").exists()
    kept = {path: path.read_bytes() for path in (folder / "answers").iterdir()}
    sealed = (folder / "sets" / "set-1" / "seal.json").read_bytes()
    (folder / CHAIN).unlink(missing_ok=True)
    (folder / VERDICTS / "set-1.json").unlink()
    with pytest.raises(InputError, match="put back the verdict"):
        refuse_opened(folder, read_index(folder))
    make(folder, (one, record("one_effect", "vignetting")))
    for path, data in kept.items():
        path.write_bytes(data)
    (folder / "sets" / "set-1" / "seal.json").write_bytes(sealed)
    change(folder / VERDICTS / "set-1.json", seal=json.loads(sealed)["sha256"])
    index = read_index(folder).model_copy(update={"seals": {}, "root": None})
    write_whole(folder / INDEX, index.text())
    data = json.loads((folder / VERDICTS / "set-1.json").read_text())
    placed = Chain().added(data)
    write_whole(folder / VERDICTS / "set-1.json", placed)
    Chain(1, placed["sha256"]).write(folder)
    with pytest.raises(InputError, match="its seal was opened before this verdict was made"):
        score([folder])


def test_a_folder_without_a_root_is_said(tmp_path: Path) -> None:
    """Of an older luxloop, or not all sets are made."""
    folder = folder_of(tmp_path, (answer("set-1", hiding("vignetting")), record("one_effect", "vignetting")))
    assert any("a set taken away would not be found" in line for line in told.scored(score([folder])))


def test_verdicts_that_go_with_the_end_of_their_chain_are_found(folder: Path) -> None:
    """One that is left is the first of its chain; before the first verdict the chain's end is there already."""
    for name in NAMES[1:]:
        (folder / VERDICTS / f"{name}.json").unlink()
    (folder / CHAIN).unlink()
    with pytest.raises(InputError, match=r"chain.json is not there.*verdicts taken away"):
        score([folder])


def test_the_end_that_is_told_is_that_of_the_records(folder: Path) -> None:
    """Killed between a record and the chain's end, which is one behind then: the record counts, and is the last."""
    last = json.loads((folder / VERDICTS / "set-3.json").read_text())
    change(folder / CHAIN, records=2, last=last["before"])
    assert score([folder])["last_verdicts"] == {str(folder): f"3, the last {last['sha256']}"}


def test_a_set_that_was_bound_and_is_not_there_is_told(folder: Path) -> None:
    """Without a verdict it could be one that nobody has judged yet: it is named."""
    shutil.rmtree(folder / SETS / "set-4")
    (folder / ANSWERS / "set-4.json").unlink()
    found = score([folder])
    assert found["gone"] == {str(folder): ["set-4"]}
    assert f"Bound by the root of {folder}, and not there: set-4." in list(told.scored(found))


def test_a_set_on_record_that_is_gone_is_not_made_anew(folder: Path) -> None:
    """Bound, judged, or opened: its answer and salt would be written over, and no score could count it again."""
    index = read_index(folder)
    refuse_gone(folder, index)
    loose = index.model_copy(update={"seals": {}, "root": None})
    shutil.rmtree(folder / SETS / "set-1")
    shutil.rmtree(folder / SETS / "set-4")
    assert gone(folder, index) == ["set-1", "set-4"]
    assert gone(folder, loose) == ["set-1"]  # the other may have been cut short in its making
    for one in (index, loose):
        with pytest.raises(
            InputError, match=r"set-1: data: got 'sets/set-1 is not there'.*take the folder as it was"
        ):
            refuse_gone(folder, one)


def test_verdicts_of_several_states_of_the_sources_are_told(tmp_path: Path) -> None:
    """A version stays what it is over many changes; records of before do not say."""
    codes = ("a" * 64, "b" * 64, None)
    folders = [
        bound_folder_of(
            tmp_path / f"{number}",
            (answer(f"set-{number}", hiding("vignetting")), record("one_effect", "vignetting", code_sha256=code)),
        )
        for number, code in enumerate(codes)
    ]
    assert not any("states" in line for line in told.scored(score(folders[:1])))
    lines = list(told.scored(score(folders[:2])))
    assert "UNLIKE verdicts: given by 2 states of luxloop's sources." in lines
    lines = list(told.scored(score(folders)))
    assert "UNLIKE verdicts: given by at least 3 states of luxloop's sources." in lines
    assert "1 records are of before such a state was put down." in lines
