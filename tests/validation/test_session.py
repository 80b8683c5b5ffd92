"""Which model and data a command works on, and that nobody's edits are written over."""

from __future__ import annotations

from pathlib import Path

import pytest

from luxloop.effect import AppliedEffect
from luxloop.errors import InputError
from luxloop.model import Fit as Limits
from luxloop.model_file import find_model, read_model
from validation.fit.parameters import free_paths
from validation.model_versions import save, versions
from validation.session import subject_of

EXAMPLE = Path(__file__).parents[2] / "examples" / "paper-like"
POWERS = AppliedEffect(name="chip_power_spread", parameters={"gain": ()})


def test_a_file_edited_while_a_command_runs_stays_as_it_is(tmp_path: Path) -> None:
    """Whatever the command found is not written over somebody's work; without an edit it is."""
    file = tmp_path / "model.toml"
    subject = subject_of(str(file), EXAMPLE)
    edited = file.read_text() + "# mine\n"
    file.write_text(edited)
    with pytest.raises(InputError, match="nobody edits while a command runs"):
        subject.saved(subject.with_data, "compare", {})
    assert file.read_text() == edited
    assert len(versions(file)) == 1
    again = subject_of(str(file), EXAMPLE)
    again.saved(again.with_data, "compare", {})
    assert read_model(file).data is not None


def test_a_shipped_model_is_not_promised_data() -> None:
    """A comparison keeps none in it: a file of one's own is named as the mend."""
    with pytest.raises(InputError, match="with a --model file of your own: paper ships"):
        subject_of("paper", None)


def test_values_by_sample_are_of_their_own_data(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Of data in another folder they are left out, which is said; those of a sample that is not there are refused."""
    file = tmp_path / "model.toml"
    own = {"array-0": {"chip_power_spread": {"gain": (0.1,) * 25}}}
    paper = find_model("paper")
    limits = {
        "effects.chip_power_spread.gain": Limits(free=True, lower=-0.5, upper=0.5, prior_mean=0.0, prior_sd=0.1)
    }
    model = paper.model_copy(update={"effects": (POWERS,), "samples": own, "fit": paper.fit | limits})
    save(file, model, "by hand")
    assert subject_of(str(file), EXAMPLE).model.samples == own
    elsewhere = {"path": str(tmp_path), "sha256": "a" * 64}
    save(file, type(model).model_validate({**model.model_dump(), "data": elsewhere}), "by hand")
    left = subject_of(str(file), EXAMPLE).model
    assert left.samples == {}
    assert not any(path.startswith("effects.") for path in free_paths(left))  # a list is no number that could move
    assert "left out" in capsys.readouterr().err
    save(file, model.model_copy(update={"samples": {"gone": own["array-0"]}}), "by hand")
    with pytest.raises(InputError, match="a sample of the data: single-0"):
        subject_of(str(file), EXAMPLE)
