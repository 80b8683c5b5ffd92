"""The environment, the model around it, its hash, and what contradicts itself."""

from __future__ import annotations

from typing import Any

import pytest

from luxloop.effect import AppliedEffect
from luxloop.errors import InputError
from luxloop.model import Environment, Fit, Model, Surface
from luxloop.model_file import find_model
from luxloop.photometry import luminous_efficacy_lm_per_w
from luxloop.words import parse

TILT = AppliedEffect(name="receiver_tilt", parameters={"tilt_per_mm": 0.01})
GLARE = AppliedEffect(name="veiling_glare", parameters={"share": 0.05})


def test_the_default_environment_is_the_papers_table_4() -> None:
    """Indices, layers, substrate and receiver as the paper prints them; S a pitch, D from the substrate."""
    e = Environment()
    assert (e.n_gan, e.n_aln, e.gan_layer_nm, e.aln_layer_nm) == (2.4869, 2.1793, 45.2, 51.6)
    assert e.substrate == Surface(scatter="gaussian", sigma_deg=5.0, reflectance=0.97)
    assert e.receiver == Surface(scatter="lambertian", reflectance=0.35)
    assert (e.peak_nm, e.fwhm_nm, e.layer_order) == (445.0, 18.0, "gan_first")
    assert (e.spacing_is, e.distance_from, e.spectrum) == ("pitch", "substrate", "averaged")


def test_every_field_is_described_in_a_sentence() -> None:
    """The file and `model show` print them."""
    for words in (Environment, Surface, Fit):
        for name, field in words.model_fields.items():
            assert field.description, f"{words.__name__}.{name}"
            assert field.description.endswith("."), f"{words.__name__}.{name}"


@pytest.mark.parametrize(
    ("data", "field"),
    [
        ({"n_gan": 0.9}, "n_gan"),
        ({"n_gan": "2.4869"}, "n_gan"),
        ({"n_gan": True}, "n_gan"),
        ({"gan_layer_nm": -1.0}, "gan_layer_nm"),
        ({"aln_layer_nm": float("nan")}, "aln_layer_nm"),
        ({"chip_absorption_per_cm": -1.0}, "chip_absorption_per_cm"),
        ({"active_layer_depth": 1.01}, "active_layer_depth"),
        ({"chip_bottom": "glue"}, "chip_bottom"),
        ({"peak_nm": 300.0}, "peak_nm"),
        ({"flux_per_chip_w": 0.0}, "flux_per_chip_w"),
        ({"n_gann": 2.4}, "n_gann"),
        ({"receiver": {"scatter": "lambertian", "sigma_deg": 5.0, "reflectance": 0.35}}, "receiver.sigma_deg"),
        ({"substrate": {"scatter": "gaussian", "reflectance": 0.97}}, "substrate.sigma_deg"),
        ({"substrate": {"scatter": "gaussian", "sigma_deg": 0.0, "reflectance": 0.97}}, "substrate.sigma_deg"),
        ({"substrate": {"scatter": "lambertian", "reflectance": 1.1}}, "substrate.reflectance"),
        ({"substrate": {"scatter": "lambertian"}}, "substrate.reflectance"),
    ],
)
def test_a_senseless_environment_is_refused_by_path(data: dict[str, Any], field: str) -> None:
    """The error's field is the dotted path."""
    with pytest.raises(InputError) as caught:
        parse(Environment, data)
    assert caught.value.field == field


def test_the_hash_follows_what_changes_results_and_nothing_else() -> None:
    """Environment, effects and their order change it; name, notes and fit do not."""
    base = Model(name="a", effects=(TILT, GLARE))
    fit = {"environment.n_gan": Fit(lower=2.4, upper=2.6)}
    assert Model(name="b", notes="other", effects=(TILT, GLARE), fit=fit).sha256 == base.sha256
    others = [
        Model(name="a"),
        Model(name="a", effects=(GLARE, TILT)),
        base.with_value("environment.n_gan", 2.5),
        base.with_value("effects.veiling_glare.share", 0.06),
    ]
    assert len({base.sha256, *(other.sha256 for other in others)}) == 5


def test_an_effect_may_stand_in_a_model_once() -> None:
    """Its parameters are addressed by its name."""
    with pytest.raises(InputError, match="receiver_tilt"):
        parse(Model, {"name": "a", "effects": [TILT.model_dump(), TILT.model_dump()]})


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("environment.substrate.reflectance", 0.5),
        ("environment.active_layer_depth", 0.3),
        ("environment.layer_order", "aln_first"),
        ("effects.receiver_tilt.tilt_per_mm", -0.02),
        ("effects.veiling_glare.source_sha256", "c" * 64),
    ],
)
def test_with_value_changes_one_leaf(path: str, value: object) -> None:
    """That leaf and no other, in a new model."""
    base = Model(name="a", effects=(TILT, GLARE))
    changed = base.with_value(path, value)
    before, after = base.leaves(), changed.leaves()
    assert {name for name in before if before[name] != after[name]} == {path}
    assert after[path] == value
    assert base == Model(name="a", effects=(TILT, GLARE))


@pytest.mark.parametrize("path", ["environment.n_gam", "name", "effects.dead_chip.gain", "environment.substrate"])
def test_with_value_refuses_what_is_no_parameter(path: str) -> None:
    """The error names the path."""
    with pytest.raises(InputError, match=path):
        Model(name="a").with_value(path, 2.0)


@pytest.mark.parametrize(
    ("path", "fit", "field"),
    [
        ("environment.n_gam", {"lower": 2.0, "upper": 3.0}, "fit.environment.n_gam"),
        ("environment.layer_order", {"lower": 2.0, "upper": 3.0}, "fit.environment.layer_order"),
        ("environment.active_layer_depth", {"lower": 0.0, "upper": 1.0}, "fit.environment.active_layer_depth"),
        ("environment.n_gan", {"lower": 2.5, "upper": 3.0}, "environment.n_gan"),
        ("environment.n_gan", {"lower": 0.5, "upper": 3.0}, "fit.environment.n_gan.lower"),
        ("environment.substrate.reflectance", {"lower": 0.9, "upper": 1.2}, "reflectance.upper"),
        ("environment.n_gan", {"lower": 3.0, "upper": 2.0}, "lower"),
        ("environment.n_gan", {"lower": 2.0, "upper": 3.0, "prior_mean": 2.5}, "prior_sd"),
        ("environment.n_gan", {"lower": 2.0, "upper": 3.0, "prior_mean": 2.5, "prior_sd": 0.0}, "prior_sd"),
        ("environment.n_gan", {"lower": 2.0, "upper": 3.0, "prior_mean": 4.0, "prior_sd": 1.0}, "prior_mean"),
        ("effects.veiling_glare.gain", {"lower": 2.0, "upper": 3.0}, "fit.effects.veiling_glare.gain"),
    ],
)
def test_a_fit_that_cannot_be_is_refused(path: str, fit: dict[str, Any], field: str) -> None:
    """No such number, value outside the limits, limits outside the physical range, half a prior."""
    with pytest.raises(InputError) as caught:
        parse(Model, {"name": "a", "effects": [GLARE.model_dump()], "fit": {path: fit}})
    assert caught.value.field.endswith(field)


def test_an_index_that_is_not_used_cannot_be_freed() -> None:
    """With dispersive indices n_gan has no influence, so a fit of it would be singular."""
    fit = {"environment.n_gan": {"free": True, "lower": 2.0, "upper": 3.0}}
    assert parse(Model, {"name": "a", "fit": fit}).fit["environment.n_gan"].free
    with pytest.raises(InputError, match="dispersive"):
        parse(Model, {"name": "a", "fit": fit, "environment": {"indices": "dispersive"}})


def test_the_shipped_clear_chip_is_the_default_environment() -> None:
    """Nothing absorbs in the chip, it emits from its whole volume in all directions, and nothing is to be fitted."""
    model = find_model("clear_chip")
    assert model.environment == Environment()
    assert (model.environment.chip_absorption_per_cm, model.environment.active_layer_depth) == (0.0, None)
    assert (model.environment.emission, model.effects, model.fit) == ("isotropic", (), {})


def test_the_shipped_paper_model_is_its_stated_reading() -> None:
    """Layer at 0.99 T, mirror bottom, 200 /cm; the rest as in the clear chip; effects none."""
    paper, clear = find_model("paper").environment, find_model("clear_chip").environment
    assert (paper.active_layer_depth, paper.chip_bottom, paper.chip_absorption_per_cm) == (0.99, "mirror", 200.0)
    changed = {name for name in Environment.model_fields if getattr(paper, name) != getattr(clear, name)}
    assert changed == {"active_layer_depth", "chip_bottom", "chip_absorption_per_cm", "flux_per_chip_w"}


def test_the_clear_chips_flux_gives_the_papers_lux_by_the_golden_cell() -> None:
    """119,910 lx over a 0.5 mm cell whose mean relative illuminance an independent Monte Carlo found as 0.9437."""
    irradiance = find_model("clear_chip").environment.flux_per_chip_w * 0.9437 / 0.5e-3**2
    assert irradiance * luminous_efficacy_lm_per_w(445.0, 18.0) == pytest.approx(119_910, rel=3e-3)
