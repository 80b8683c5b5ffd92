"""Kinds left out of a truth: of that one only, on record, and weak is said only of what is weak."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from luxloop.errors import InputError
from validation.blind_test import making, told
from validation.blind_test.folders import ANSWERS, ASKED, WEAK, write_whole
from validation.blind_test.left_out import leave_out, left_out, no_amounts, weak_kinds
from validation.blind_test.strength import NoAmount, NotReached
from validation.blind_test.truths import Kinds, Planned


class Hider:
    """A scene of a truth in which vignetting's kind is weak, or no amount of it is found."""

    def __init__(self, fails: dict[str, Exception]) -> None:
        self.fails = fails

    def hide(self, name: str, seed: int) -> Any:
        """The kind, where it can be."""
        if name in self.fails:
            raise self.fails[name]
        return name, seed


def hidden(folder: Path, truth: int, **fails: Exception) -> Any:
    """What is hidden in a set of a truth."""
    asked: Any = SimpleNamespace(folder=folder, sigma=20.0)
    scene: Any = Hider(fails)
    kinds = Kinds(["clipped_pupil", "weak_chip"], seed=1)
    kinds.took("weak_chip")
    return making._hidden(asked, scene, Planned("set-1", "of-set-1", truth, 1, False, 5), kinds, ())


def test_what_is_weak_in_one_truth_is_hidden_in_another(tmp_path: Path) -> None:
    """A kind that failed in one truth was dropped for all later ones."""
    assert hidden(tmp_path, 0, clipped_pupil=NotReached("clipped_pupil", 6.0)) == ("weak_chip", 5)
    assert left_out(tmp_path, 0) == {"clipped_pupil": 6.0}
    assert hidden(tmp_path, 0) == ("weak_chip", 5)
    assert hidden(tmp_path, 1) == ("clipped_pupil", 5)
    assert left_out(tmp_path, 1) == {}


def test_a_search_that_failed_is_no_weakness(tmp_path: Path) -> None:
    """It is told by itself."""
    assert hidden(tmp_path, 0, clipped_pupil=NoAmount("clipped_pupil")) == ("weak_chip", 5)
    assert (weak_kinds(tmp_path), no_amounts(tmp_path)) == ({}, ["clipped_pupil"])
    lines = list(told.kinds_left_out({"too_weak": {}, "no_amount": no_amounts(tmp_path)}))
    assert lines == ["not hidden in a truth where no amount came near the asked strength: clipped_pupil"]


def test_a_truth_in_which_nothing_can_be_hidden(tmp_path: Path) -> None:
    """Both reasons are said."""
    with pytest.raises(InputError, match=r"clipped_pupil 6\.0; no amount was found for weak_chip"):
        hidden(tmp_path, 0, clipped_pupil=NotReached("clipped_pupil", 6.0), weak_chip=NoAmount("weak_chip"))


def test_the_least_of_all_truths_is_told(tmp_path: Path) -> None:
    """A list of before, which was of all truths together, counts, too."""
    write_whole(tmp_path / ANSWERS / WEAK, {"dust": 4.0})
    leave_out(tmp_path, 0, {"dust": 6.0, "hair": 3.0})
    leave_out(tmp_path, 1, {"hair": 2.0})
    assert weak_kinds(tmp_path) == {"dust": 4.0, "hair": 2.0}


@pytest.mark.parametrize("damaged", [{"truth-1": {"dust": "weak"}}, {"dust": [4.0]}, {"truth-1": {"dust": True}}])
def test_a_list_that_was_damaged_is_named(tmp_path: Path, damaged: dict[str, Any]) -> None:
    """By `make` as by the score."""
    write_whole(tmp_path / ANSWERS / WEAK, damaged)
    with pytest.raises(InputError, match=r"too-weak\.json: dust: .*put the file back"):
        weak_kinds(tmp_path)


def test_what_was_asked_for_and_answers_that_were_damaged_are_named(tmp_path: Path) -> None:
    """No traceback: the file, and the mend."""
    write_whole(tmp_path / ANSWERS / ASKED, {"seed": "x"})
    with pytest.raises(InputError, match=r"asked\.json: seed: got 'x'"):
        making.seed_of(tmp_path, None)
    for damaged in ({}, {"answer": {"id": "set-1"}}):
        write_whole(tmp_path / ANSWERS / "set-1.json", damaged)
        with pytest.raises(InputError, match=r"answers/set-1\.json"):
            list(making._answers(tmp_path))
