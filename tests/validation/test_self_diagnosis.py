"""What `effects check` asks last: hidden at 20 sigma, is an effect found again?"""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from luxloop.client import Client
from luxloop.effect import EffectParameter, EffectSpec
from luxloop.model_file import find_model
from luxloop.settings import Settings
from tests.running_set import RunningSet
from tests.validation.workers import Workers
from validation import self_diagnosis
from validation.effects import example_set
from validation.effects.checking import Finding
from validation.effects.confounding import Confounding
from validation.effects.confusing import image_ground
from validation.effects.known import Known
from validation.effects.signatures import Column
from validation.prediction import Predictor
from validation.self_diagnosis import SIGMA, loudest, monte_carlo, self_diagnosed, verdict_on


def parameter(name: str, **facts: Any) -> EffectParameter:
    """From 0, where it is off, to 2."""
    return EffectParameter(name=name, description="", **({"lower": 0.0, "upper": 2.0, "off": 0.0} | facts))


def spec(*parameters: EffectParameter) -> EffectSpec:
    """An effect with these."""
    return EffectSpec(name="mine", stage="module", description="", parameters=parameters)


def column(name: str) -> Column:
    """Of a parameter; its parts do not matter here."""
    return Column("mine", name, {}, None, 0.1, ())


def test_the_size_is_that_of_20_sigma_or_the_end_of_the_range() -> None:
    """In the value and in its square; of two parameters the one that shows most; downwards where off is the top."""
    one, other = parameter("a"), parameter("b")
    chosen, value, sigma = loudest(spec(one, other), [column("a"), column("b")], np.diag([10.0, 40.0]))
    assert (chosen.name, value, sigma) == ("b", pytest.approx(0.5), SIGMA)
    square = parameter("w", score_variable="square")
    assert loudest(spec(square), [column("w")], np.array([[20.0 / 0.09]]))[1] == pytest.approx(0.3)
    assert loudest(spec(one), [column("a")], np.array([[4.0]]))[1:] == (2.0, 8.0)
    down = parameter("g", off=2.0)
    assert loudest(spec(down), [column("g")], np.array([[40.0]]))[1] == pytest.approx(1.5)


@pytest.mark.parametrize(
    ("named", "sigma", "ok"),
    [
        (("mine",), SIGMA, True),
        (("other", "mine"), SIGMA, True),
        (("alike",), SIGMA, True),
        (("other",), SIGMA, False),
        ((), SIGMA, False),
        ((), 4.0, None),
    ],
)
def test_the_name_or_its_group_is_demanded_at_20_sigma(named: tuple[str, ...], sigma: float, ok: bool | None) -> None:
    """Below that, at the end of a range, nothing is demanded."""
    cosines = np.array([[1.0, 0.95, 0.0], [0.95, 1.0, 0.0], [0.0, 0.0, 1.0]])
    step = SimpleNamespace(
        verdict=SimpleNamespace(set=named), confounding=Confounding(("mine", "alike", "other"), cosines)
    )
    found: Any = SimpleNamespace(steps=[step], verdict=SimpleNamespace(word="one_effect"))
    finding = verdict_on(spec(parameter("a")), found, "a 1", sigma)
    assert finding.ok is ok
    assert finding.said.startswith(f"a 1 hidden, {sigma:.0f} sigma: one_effect")


@pytest.mark.slow
def test_an_effect_of_the_catalogue_finds_itself(settings: Settings, monkeypatch: pytest.MonkeyPatch) -> None:
    """Vignetting and blurs off the axis at 20 sigma among five, by real workers, in two of the six example images."""
    sizes = {"vignetting": "corner_loss", "off_axis_blur": "corner_um", "focus_tilt": "edge_um"}
    two = [one for one in example_set.samples() if one.id in ("single-0", "array-2.5")]
    monkeypatch.setattr(example_set, "samples", lambda: two)
    running = RunningSet(settings)
    try:
        running.add("-m", "luxloop", "serve", "thin-film")
        running.add("-m", "luxloop", "serve", "ray-tracing")
        model = find_model("paper").model_copy(update={"fit": {}})  # nothing of it moves: quick
        with Client(running.settings, local=False, patience_s=60.0) as client:
            predictor, known = Predictor(client), Known.ask(client)
            few = [known.spec(name) for name in (*sizes, "camera_psf", "substrate_lobe")]
            ground, only = image_ground(model, predictor, known), Known(tuple(few), {}, {})
            for name, size in sizes.items():
                hidden = known.spec(name)
                finding = self_diagnosed(ground, predictor, only, model, hidden, ground.columns(model, hidden))
                assert finding.ok, finding.said
                assert size in finding.said
                assert f"20 sigma: one_effect: {name}" in finding.said
    finally:
        running.close()


def test_the_noise_of_a_truth_is_told_and_falls_with_its_histories(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By half with four times as many; the images agree within it."""
    predictor, found = Predictor(Workers(tmp_path)), []
    for histories in (40_000, 160_000):
        monkeypatch.setattr(self_diagnosis, "TRUTH_HISTORIES", histories)
        found.append(monte_carlo(find_model("paper"), predictor))
    (few, loud), (many, quiet) = found
    assert 0.4 < quiet / loud < 0.65
    for one, other in zip(few, many, strict=True):
        assert one.irradiance_per_mm2.sum() == pytest.approx(other.irradiance_per_mm2.sum(), rel=0.02)


def test_a_verdict_about_noisy_data_is_told_and_not_demanded(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of an effect that only Monte Carlo shows, or whose values have walks of their own."""
    finding = Finding("self-diagnosis", False, "a 1 hidden, 20 sigma: none_of_the_known")
    known = Known((), {}, {})
    monkeypatch.setattr(self_diagnosis, "verdict_on", lambda *_: finding)
    monkeypatch.setattr(self_diagnosis, "diagnosis", lambda *_: None)
    ground: Any = SimpleNamespace(sight=SimpleNamespace(views=[1]), projection=None)
    monkeypatch.setattr(self_diagnosis, "projected", lambda *_: np.array([[40.0]]))
    mine = spec(parameter("a")).model_copy(update={"walks": True})
    for noise, ok in ((0.1, False), (0.65, None)):
        monkeypatch.setattr(self_diagnosis, "monte_carlo", lambda *_, share=noise: ([], share))
        monkeypatch.setattr(self_diagnosis, "noisy_images", lambda *_: None)
        told = self_diagnosed(ground, Predictor(SimpleNamespace()), known, find_model("paper"), mine, [column("a")])
        assert told.ok is ok
        assert ("not demanded" in told.said) == (ok is None)
