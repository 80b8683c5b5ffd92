"""What a person types: numbers, ranges, stacks, names of files to write."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from containers.typed import MOST_NUMBERS, check_file, numbers, parse_stack
from luxloop.errors import InputError


def test_numbers_lists_and_ranges() -> None:
    """The last value of a range is included; rounding does not carry it beyond."""
    assert numbers("--angles", "5.5") == [5.5]
    assert numbers("--angles", "1,2,3") == [1.0, 2.0, 3.0]
    assert numbers("--angles", "0:80:20") == [0.0, 20.0, 40.0, 60.0, 80.0]
    assert numbers("--angles", "0:0.3:0.1")[-1] == 0.3
    assert numbers("--angles", "5:5:1e-320") == [5.0]


@pytest.mark.parametrize(
    "text",
    [
        *("", "a", "1,,2", "1:2", "1:2:3:4", "0:1,2", "nan", "1,inf", "1e999", "1" + ",1" * 10_000),
        *(
            "0:1:0",
            "0:1:-1",
            "2:1:1",
            "0:80:1e-320",
            "0:1e308:1e-9",
            "-1e308:1e308:1",
            "-1e308:1e308:1e308",
            "0:10000:1",
        ),
    ],
)
def test_what_is_no_list_of_numbers_is_refused_by_its_option(text: str) -> None:
    """Also ranges whose count is beyond any number: once an OverflowError."""
    with pytest.raises(InputError, match=r"^--angles: got"):
        numbers("--angles", text)


@settings(derandomize=True, max_examples=200, deadline=None)
@given(st.text(alphabet="0123456789.:,-e naif", max_size=24))
def test_any_text_gives_finite_numbers_or_an_input_error(text: str) -> None:
    """Nothing else comes out, whatever is typed."""
    try:
        found = numbers("--angles", text)
    except InputError:
        return
    assert 1 <= len(found) <= MOST_NUMBERS + 1
    assert all(abs(value) < float("inf") for value in found)


@settings(derandomize=True, max_examples=200, deadline=None)
@given(st.text(alphabet="0123456789.|~+-ij eSOnmcoherit", max_size=30))
def test_any_text_is_a_stack_or_an_input_error(text: str) -> None:
    """A sentence that is read has at least its two half spaces."""
    try:
        stack = parse_stack(text)
    except InputError:
        return
    assert text.count("|") == len(stack.layers) + 1


def test_a_file_to_write_is_tried_and_left_as_it_is(tmp_path: Path) -> None:
    """One that is there keeps its text, one that is not there is not made."""
    held, new = tmp_path / "held.png", tmp_path / "new.png"
    held.write_text("mine")
    check_file("--plot", held, (".png",))
    check_file("--plot", new, (".png",))
    check_file("--plot", None, (".png",))
    assert held.read_text() == "mine"
    assert not new.exists()


@pytest.mark.parametrize(
    "name", ["folder.png", "no/such/x.png", "x.jpg", "n" * 300 + ".png", "a\0.png", "held/x.png"]
)
def test_a_file_that_cannot_be_written_is_refused_by_its_option(tmp_path: Path, name: str) -> None:
    """A folder, no folder, another ending, a name no file can have."""
    (tmp_path / "folder.png").mkdir()
    (tmp_path / "held").touch()
    with pytest.raises(InputError, match=r"^--plot: got"):
        check_file("--plot", tmp_path / name, (".png",))


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="needs a folder where not even root may write")
def test_a_folder_where_nothing_can_be_made_is_refused() -> None:
    """What the rights say does not matter: it is tried."""
    with pytest.raises(InputError, match=r"^--plot: got '/proc/x\.png'"):
        check_file("--plot", Path("/proc/x.png"), (".png",))
