"""What a person types: numbers, ranges, stacks, names of files to write."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from containers.typed import (
    MAX_PLACES,
    angles_deg,
    bandwidth_nm,
    check_file,
    dbr_pairs,
    numbers,
    parse_stack,
    wavelengths_nm,
)
from luxloop.errors import InputError
from luxloop.stack import Layer, Medium, Stack


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
    assert 1 <= len(found) <= MAX_PLACES + 1
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


def test_a_sentence_with_everything_is_the_stack_that_it_says() -> None:
    """Bulk with a rough face, absorbing index, roughness, a thick layer, `air`: each word arrives."""
    sentence = "GaN ~0.3 | 2.49+0.01i 45.2nm ~1.5 | SiO2 1e6 incoherent ~2 | 0.04+2.6i 30 | air"
    assert parse_stack(sentence) == Stack(
        inside=Medium(material="GaN"),
        inside_roughness_nm=0.3,
        layers=(
            Layer(medium=Medium(n=2.49, k=0.01), thickness_nm=45.2, roughness_nm=1.5),
            Layer(medium=Medium(material="SiO2"), thickness_nm=1e6, roughness_nm=2.0, coherent=False),
            Layer(medium=Medium(n=0.04, k=2.6), thickness_nm=30.0),
        ),
        outside=Medium(n=1.0),
    )


@pytest.mark.parametrize(
    ("sentence", "words"),
    [
        ("Si | SiO2 -5 | air", "got 'SiO2 -5', allowed: a thickness of 0 to 1e+09 nm"),
        ("Si | SiO2 nan | air", "a thickness of 0 to 1e+09 nm"),
        ("Si | SiO2 thin | air", "'thin' is no number"),
        ("Si | SiO2 5 ~-1 | air", "a roughness of 0 to 100 nm"),
        ("Si | 2.5-0.1i 5 | air", "absorption has a plus sign"),
        ("Si | nan 5 | air", "an index n or n+ki"),
        ("Si | SiO2 | air", "medium thickness"),
        ("Si 5 | air", "the innermost medium has no thickness"),
        ("Si | air 5", "the outermost medium has no thickness"),
        ("Si", "separated by |"),
        ("Si" + " | SiO2 5" * 500 + " | air", "got '500 layers', allowed: at most 400"),
        ("a" * 80 + " | air", "a name of at most 64"),
    ],
)
def test_a_wrong_sentence_is_refused_with_the_wrong_word_and_the_mend(sentence: str, words: str) -> None:
    """In a person's words: no name of a field, no Python."""
    with pytest.raises(InputError) as refusal:
        parse_stack(sentence)
    assert words in str(refusal.value)
    assert refusal.value.field == "--stack"
    assert refusal.value.mend
    assert "Layer(" not in str(refusal.value)


@pytest.mark.parametrize(
    ("read", "text", "mend"),
    [
        (angles_deg, "90", "89.9"),
        (angles_deg, "0,-1", "from the normal"),
        (wavelengths_nm, "0.4", "nanometres"),
        (wavelengths_nm, "0", "nanometres"),
        (dbr_pairs, "4.3", "take 4 or 4.5"),
        (dbr_pairs, "100.5", "take fewer"),
        (dbr_pairs, "-0.5", "take"),
    ],
)
def test_numbers_out_of_range_are_refused_by_their_option_with_the_mend(
    read: Callable[[str, str], list[float]], text: str, mend: str
) -> None:
    """The option, what was typed, and what to type instead."""
    with pytest.raises(InputError) as refusal:
        read("--option", text)
    assert refusal.value.field == "--option"
    assert mend in refusal.value.mend


def test_numbers_in_range_come_as_they_are() -> None:
    """Ends included where they are allowed."""
    assert angles_deg("--angles", "0,89.9") == [0.0, 89.9]
    assert wavelengths_nm("--wavelengths", "1,400") == [1.0, 400.0]
    assert dbr_pairs("--pairs", "0:1:0.5") == [0.0, 0.5, 1.0]
    assert bandwidth_nm("--bandwidth", 18.0) == 18.0
    for wrong in (-1.0, float("nan"), 1e4):
        with pytest.raises(InputError, match=r"^--bandwidth: got"):
            bandwidth_nm("--bandwidth", wrong)


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


def test_the_roughness_of_the_bulk_is_told() -> None:
    """What changes the numbers stands in the stack's name."""
    assert str(parse_stack("Si ~3 | SiO2 100 ~2 | air")) == "Si ~3 | SiO2(100 nm ~2) | 1"
