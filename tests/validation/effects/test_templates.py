"""The example files that `luxloop effects new` writes."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from containers.catalogue import Catalogue
from luxloop.errors import InputError
from tests.validation.effects.test_signatures import AMPLITUDE, spec_of
from validation.effects.checking import Finding, looks_like, trial_of
from validation.effects.known import Known
from validation.effects.showing import values_of
from validation.effects.templates import STAGES, source_of


@pytest.mark.parametrize("stage", STAGES)
def test_an_example_is_short_and_bears_the_name(stage: str) -> None:
    """At most 25 lines of at most 118 letters; one class, of the name in camel case, nothing left to fill in."""
    text = source_of("my_haze", stage)
    assert len(text.splitlines()) <= 25
    assert max(map(len, text.splitlines())) <= 118
    (defined,) = [node.name for node in ast.parse(text).body if isinstance(node, ast.ClassDef)]
    assert defined == "MyHaze"
    assert 'name = "my_haze"' in text
    assert not any(blank in text for blank in ("{name}", "{Name}", "{title}"))


def test_every_example_passes_its_trial_and_says_whether_it_acts_on_films(tmp_path: Path) -> None:
    """By the stage; what stands on the DBR of a chip is no film that is measured."""
    for stage in STAGES:
        (tmp_path / f"my_{stage}.py").write_text(source_of(f"my_{stage}", stage))
    found = Catalogue(tmp_path)
    assert found.refused == {}
    acts_on = {one.name: one.acts_on for one in found.specs if one.source_sha256}
    assert acts_on == {f"my_{one}": ("films",) if one in ("film", "curve") else ("modules",) for one in STAGES}


def test_values_are_taken_as_given_and_refused_out_of_range() -> None:
    """PARAM=VALUE over the typical ones; another parameter, or a value out of range, is an InputError."""
    spec = spec_of(AMPLITUDE)
    assert values_of(spec, []) == {"a": pytest.approx(0.5 / 3.0)}
    assert values_of(spec, ["a=0.25"]) == {"a": 0.25}
    for wrong in ("a=2", "b=0.1", "a", "a=much", "a=nan", "a=inf", "A=0.2", "a b=0.1", "a=" + 70 * "x"):
        with pytest.raises(InputError):
            values_of(spec, [wrong])


def test_a_refused_file_fails_with_its_reason_and_of_the_catalogue_nothing_is_demanded() -> None:
    """What the workers found is told line by line."""
    findings = [{"check": "import", "ok": True, "said": "yes"}, {"check": "off", "ok": False, "said": "no"}]
    known = Known((), {"mine.py": "mine.py: off: no"}, {"mine.py": {"sha256": "", "findings": findings}})
    assert list(trial_of(known, "mine")) == [Finding("import", True, "yes"), Finding("off", False, "no")]
    assert [one.ok for one in trial_of(known, "camera_psf")] == [None]
    with pytest.raises(InputError, match="off: no"):
        known.spec("mine")


def test_the_sentence_says_how_much_it_is_the_same() -> None:
    """With the cosine and the name; where calibration imitates it wholly it says that."""
    said = looks_like([("distance_error", 0.971), ("camera_psf", 0.5)], "six example images").said
    assert said == "your effect is 0.97 the same as distance_error for six example images; then camera_psf 0.50"
    assert "calibration imitates it wholly" in looks_like([], "six example images").said
