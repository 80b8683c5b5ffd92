"""Effects on films as `effects check` looks at them: their columns on the example film; are they found again?"""

from __future__ import annotations

from pathlib import Path

import pytest

from luxloop.model_file import find_model
from tests.validation.workers import Workers
from validation.dataset.folder import read_dataset
from validation.effects.checking import derivative
from validation.effects.confounding import confounding
from validation.effects.confusing import Ground, confusion, curve_ground, grounds
from validation.effects.known import Known
from validation.effects.signatures import projected
from validation.effects.templates import source_of
from validation.observed import Observed
from validation.prediction import Predictor
from validation.self_diagnosis import self_diagnosed

PAPER = find_model("paper")
WAFER = Path(__file__).parents[3] / "examples" / "wafer"
RIVALS = ("film_absorption_tail", "film_interface_roughness")


@pytest.fixture
def workers(tmp_path: Path) -> Workers:
    """Workers that know an effect of the user's own, of a name that says nothing of films."""
    folder = tmp_path / "effects"
    folder.mkdir()
    (folder / "my_dye.py").write_text(source_of("my_dye", "film"))
    return Workers(tmp_path / "films", folder)


@pytest.fixture
def ground(workers: Workers) -> Ground:
    """The example film."""
    return curve_ground(PAPER, Predictor(workers))


def test_derivatives_on_the_film_are_stable_though_delta_is_steep_there(workers: Workers, ground: Ground) -> None:
    """To 3 % with half and double the step: delta turns by 126 deg within 5 nm, so long steps had 48 and 86 %."""
    known = Known.ask(workers)
    for name in ("film_missing_layer", "film_interlayer", "film_dispersion", "my_dye"):
        spec = known.spec(name)
        for finding in derivative(ground, PAPER, spec, ground.columns(PAPER, spec)):
            assert finding.ok
            changes = [float(part.split(" %")[0].split()[-1]) for part in finding.said.split(",")]
            assert max(changes) < 3.0, finding.said


def test_what_thickness_and_index_can_do_is_imitated_and_thin_layers_are_alike(
    workers: Workers, ground: Ground
) -> None:
    """Cauchy's rise is one of the film's own parameters; a layer upon the film is like another, in first order."""
    known, rows = Known.ask(workers), {}
    for name in ("film_dispersion", "film_missing_layer", "film_interlayer", "film_interface_roughness"):
        spec = known.spec(name)
        rows[name] = projected(ground.columns(PAPER, spec), ground.projection)
    assert not rows.pop("film_dispersion").any()
    found = confounding(rows)
    assert found.group_of("film_missing_layer") == ("film_missing_layer", "film_interlayer")
    assert abs(found.rivals("film_interface_roughness")[0][1]) < 0.5


@pytest.mark.parametrize("name", ["my_dye", "film_thickness_spread"])
def test_an_effect_hidden_in_curves_is_found_again(workers: Workers, ground: Ground, name: str) -> None:
    """At 20 sigma, thickness and index of the film free, among rivals; also a user's own of any name."""
    known, predictor = Known.ask(workers), Predictor(workers)
    few = Known(tuple(known.spec(one) for one in (name, *RIVALS)), {}, {})
    spec = known.spec(name)
    finding = self_diagnosed(ground, predictor, few, PAPER, spec, ground.columns(PAPER, spec))
    assert finding.ok, finding.said
    assert finding.said.endswith(f"hidden, 20 sigma: one_effect: {name}")


def test_effects_are_told_apart_on_measured_spectra(workers: Workers) -> None:
    """Of the shipped wafer, its thickness free: thin layers are alike; an effect on images is none of spectra."""
    known, predictor = Known.ask(workers), Predictor(workers)
    (ground,) = grounds(PAPER, predictor, known, Observed.of(read_dataset(WAFER)))
    names = ("film_missing_layer", "film_interlayer", "film_thickness_spread", "vignetting")
    found = confusion(ground, PAPER, [known.spec(name) for name in names])
    assert found.ground == "2 spectra"
    assert ("film_missing_layer", "film_interlayer") in [tuple(sorted(one, reverse=True)) for one in found.groups]
    assert "vignetting" not in found.names
