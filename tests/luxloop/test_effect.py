"""The words for an effect: what a catalogue may say, and what a model may apply."""

from __future__ import annotations

from typing import Any

import pytest

from luxloop.effect import AppliedEffect, EffectParameter, EffectSpec, check, did_you_mean
from luxloop.errors import InputError
from luxloop.words import parse

GLARE = EffectSpec(
    name="veiling_glare",
    stage="detector",
    description="A share of the light is spread wide over the image.",
    parameters=(
        EffectParameter(name="share", description="Share.", lower=0.0, upper=0.1, off=0.0, one_sided=True),
        EffectParameter(
            name="width_mm", description="Width.", unit="mm", lower=0.2, upper=2.0, shape_grid=(0.4, 0.8, 1.6)
        ),
    ),
    scope="per_camera",
    conserves=("energy",),
    reference="ISO 9358",
)
ORDER = EffectSpec(
    name="dbr_layer_order",
    stage="stack",
    description="Which layer lies on the bulk.",
    parameters=(EffectParameter(name="order", description="First layer.", choices=("gan_first", "aln_first")),),
    discrete=True,
)
POWERS = EffectSpec(
    name="chip_power_spread",
    stage="emission",
    description="A gain per chip.",
    parameters=(EffectParameter(name="gain", description="Gain.", lower=-0.5, upper=0.5, off=0.0, per_chip=True),),
    scope="per_sample",
)


def applied(name: str, **parameters: Any) -> AppliedEffect:
    """An effect as it is read from a file."""
    return parse(AppliedEffect, {"name": name, "parameters": parameters})


@pytest.mark.parametrize(
    ("effect", "spec"),
    [
        (applied("veiling_glare", share=0.0, width_mm=0.8), GLARE),
        (applied("veiling_glare", share=0.1, width_mm=2), GLARE),
        (applied("dbr_layer_order", order="aln_first"), ORDER),
        (applied("chip_power_spread", gain=[0.1, -0.1, 0.5]), POWERS),
    ],
)
def test_what_the_catalogue_describes_may_be_applied(effect: AppliedEffect, spec: EffectSpec) -> None:
    """The ends of a range belong to it; whole numbers, words and lists stand where they are described."""
    check(effect, spec)
    assert AppliedEffect.model_validate_json(effect.model_dump_json()) == effect


@pytest.mark.parametrize(
    ("effect", "spec", "field", "told"),
    [
        (applied("veiling_glare", share=0.2, width_mm=0.8), GLARE, "share", "0 to 0.1"),
        (applied("veiling_glare", share="a lot", width_mm=0.8), GLARE, "share", "0 to 0.1"),
        (applied("veiling_glare", share=[0.1], width_mm=0.8), GLARE, "share", "one value"),
        (applied("veiling_glare", share=0.1, width_mm=0.1), GLARE, "width_mm", "0.2 to 2 mm"),
        (applied("veiling_glare", share=0.1), GLARE, "width_mm", "missing"),
        (applied("veiling_glare", shar=0.1, width_mm=0.8), GLARE, "shar", "did you mean share"),
        (applied("dbr_layer_order", order="gan"), ORDER, "order", "gan_first or aln_first"),
        (applied("dbr_layer_order", order=1.0), ORDER, "order", "gan_first or aln_first"),
        (applied("chip_power_spread", gain=[0.1, 0.6]), POWERS, "gain", "-0.5 to 0.5"),
        (applied("chip_power_spread", gain=0.1), POWERS, "gain", "one per chip"),
        (applied("dead_chip", gain=0.1), POWERS, "dead_chip", "another effect"),
    ],
)
def test_what_it_does_not_is_refused_by_name(effect: AppliedEffect, spec: EffectSpec, field: str, told: str) -> None:
    """The error names the path in the model, the value, and what is allowed or how to mend it."""
    with pytest.raises(InputError, match=told) as caught:
        check(effect, spec)
    assert caught.value.field.startswith(f"effects.{effect.name}")
    assert caught.value.field.endswith(field)


def test_a_users_effect_of_another_source_is_refused() -> None:
    """Both hashes are named."""
    spec = GLARE.model_copy(update={"source_sha256": "a" * 64})
    effect = applied("veiling_glare", share=0.1, width_mm=0.8).model_copy(update={"source_sha256": "b" * 64})
    with pytest.raises(InputError, match=r"bbbb.*aaaa"):
        check(effect, spec)


@pytest.mark.parametrize("value", [True, float("nan"), float("inf"), None, {"a": 1.0}, ["0.1"], [True]])
def test_a_value_is_a_number_a_word_or_a_list_of_numbers(value: object) -> None:
    """No booleans for numbers, nothing that is not finite."""
    with pytest.raises(InputError, match="share"):
        parse(AppliedEffect, {"name": "veiling_glare", "parameters": {"share": value}})


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"unit": "um"}, "unit"),
        ({"lower": 3.0}, "lower"),
        ({"upper": None}, "lower"),
        ({"choices": ["a", "b"]}, "choices"),
        ({"off": 5.0}, "width_mm"),
        ({"shape_grid": [0.4, 4.0]}, "width_mm"),
        ({"score_variable": "cube"}, "score_variable"),
    ],
)
def test_a_parameter_that_contradicts_itself_is_refused(change: dict[str, Any], field: str) -> None:
    """Unit against name, range against itself, off and the shape grid against the range."""
    with pytest.raises(InputError) as caught:
        parse(EffectParameter, GLARE.parameters[1].model_dump() | change)
    assert field in caught.value.field


def test_two_parameters_of_one_name_are_refused() -> None:
    """The error names the parameter."""
    with pytest.raises(InputError, match="share"):
        parse(EffectSpec, GLARE.model_dump() | {"parameters": [GLARE.parameters[0].model_dump()] * 2})


def test_a_misspelt_word_is_met_by_its_nearest() -> None:
    """Near words are offered, far ones are not."""
    assert did_you_mean("veilling_glare", ["saturation", "veiling_glare"]) == "did you mean veiling_glare?"
    assert did_you_mean("xyz", ["saturation", "veiling_glare"]) == ""
