"""Stacks: pairs to layers, both orders, environments, and the rows that the kernels read."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from containers.materials import material
from containers.stack import ALN, GAN, dbr_layers, dbr_of, dbr_stack, resolve
from luxloop.errors import InputError
from luxloop.model import Environment
from luxloop.stack import Layer, Medium, Stack

PAPER = Environment()


@settings(max_examples=40, derandomize=True)
@given(st.integers(0, 200))
def test_layers_alternate_and_there_are_two_per_pair(halves: int) -> None:
    """2 x pairs layers that never repeat; the two orders are each other's complement."""
    gan_first, aln_first = dbr_layers(halves / 2, "gan_first"), dbr_layers(halves / 2, "aln_first")
    assert len(gan_first) == halves
    assert all(a != b for a, b in pairwise(gan_first))
    assert [a + b for a, b in zip(gan_first, aln_first, strict=True)] == [GAN + ALN] * halves


def test_half_pairs_end_with_the_material_they_begin_with() -> None:
    """2.5 pairs: gan_first ends with GaN against air, aln_first with AlN."""
    assert dbr_layers(2.5, "gan_first") == (GAN, ALN, GAN, ALN, GAN)
    assert dbr_layers(2.5, "aln_first") == (ALN, GAN, ALN, GAN, ALN)
    assert dbr_layers(0.0) == ()


def test_the_stack_reads_as_a_sentence() -> None:
    """The paper's 1.5 pairs, from the bulk outwards."""
    sentence = "2.4869 | 2.4869(45.2 nm) | 2.1793(51.6 nm) | 2.4869(45.2 nm) | 1"
    assert str(dbr_of(PAPER, 1.5)) == sentence


def test_an_environment_decides_order_thickness_and_indices() -> None:
    """Every field of the environment reaches the stack."""
    changed = PAPER.model_copy(
        update={
            "layer_order": "aln_first", "indices": "dispersive", "gan_layer_nm": 40.0, "aln_layer_nm": 55.0,
        }
    )  # fmt: skip
    stack = dbr_of(changed, 1.0, roughness_nm=0.5)
    assert stack.inside == Medium(material="GaN")
    assert [(str(layer.medium), layer.thickness_nm) for layer in stack.layers] == [("AlN", 55.0), ("GaN", 40.0)]
    assert stack.inside_roughness_nm == 0.5
    assert {layer.roughness_nm for layer in stack.layers} == {0.5}


def test_rows_hold_media_layers_and_faces_from_the_bulk_outwards() -> None:
    """Index (wavelength, M + 2), thickness (M,), roughness (M + 1,) of the outward faces, coherence (M,)."""
    stack = Stack(
        inside=Medium(material="GaN"),
        inside_roughness_nm=0.3,
        layers=(
            Layer(medium=Medium(n=1.5, k=0.2), thickness_nm=10.0, roughness_nm=0.7),
            Layer(medium=Medium(material="AlN"), thickness_nm=5e5, coherent=False),
        ),
        outside=Medium(n=1.0),
    )
    rows = resolve(stack, [440.0, 450.0])
    assert rows.index.shape == (2, 4)
    np.testing.assert_array_equal(rows.index[:, 0], material("GaN").index([440.0, 450.0]))
    np.testing.assert_array_equal(rows.index[1, 1:], [1.5 + 0.2j, material("AlN").index(450.0), 1.0])
    np.testing.assert_array_equal(rows.thickness_nm, [10.0, 5e5])
    np.testing.assert_array_equal(rows.roughness_nm, [0.3, 0.7, 0.0])
    np.testing.assert_array_equal(rows.coherent, [True, False])
    assert not rows.lossless


def test_a_cauchy_medium_has_its_index_and_one_name() -> None:
    """n = a + b / lambda^2 in um, no k; it is the only thing said of the medium, and an index below 0 is refused."""
    glass = Medium(cauchy=(1.5, 0.004))
    stack = Stack(inside=glass, outside=Medium(n=1.0))
    np.testing.assert_allclose(resolve(stack, [400.0, 500.0]).index[:, 0], [1.525, 1.516], rtol=1e-15)
    assert str(stack) == "1.5+0.004/um2 | 1"
    assert Stack.model_validate_json(stack.model_dump_json()) == stack
    assert "cauchy" not in Medium(n=1.0).model_dump()  # so that hashes of other stacks stay what they were
    for wrong in ({"n": 1.5}, {"material": "SiO2"}, {"k": 0.1}):
        with pytest.raises(ValidationError, match=r"exactly one|without an index"):
            Medium(cauchy=(1.5, 0.004), **wrong)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="cauchy"):
        resolve(Stack(inside=Medium(cauchy=(1.5, -0.3)), outside=glass), [400.0])


def test_a_stack_without_loss_says_so() -> None:
    """The paper's stack has no k and no roughness; with either it is not lossless."""
    assert resolve(dbr_of(PAPER, 5.5), [445.0]).lossless
    assert not resolve(dbr_of(PAPER, 5.5, roughness_nm=1.0), [445.0]).lossless


@pytest.mark.parametrize("pairs", [-0.5, 0.25, 100.5, math.nan, math.inf])
def test_pairs_that_are_not_halves_are_refused(pairs: float) -> None:
    """The error names the field and the allowed values."""
    with pytest.raises(InputError, match=r"dbr_pairs: got .*multiple of 0.5 from 0 to 100"):
        dbr_layers(pairs)


def test_an_unknown_order_is_refused() -> None:
    """Only the two orders exist."""
    with pytest.raises(InputError, match="layer_order"):
        dbr_layers(1.0, "gan-first")  # type: ignore[arg-type]  # the wrong word is the point


def test_a_wavelength_outside_a_materials_data_is_refused() -> None:
    """Silver ends at 1700 nm; the stack says so before any kernel runs."""
    gan = Medium(n=2.4869)
    silver = dbr_stack(1.0, gan=gan, aln=Medium(material="Ag"), gan_layer_nm=45.2, aln_layer_nm=51.6)
    with pytest.raises(InputError, match="300 to 1700 nm"):
        resolve(silver, [445.0, 1800.0])


def test_a_layer_that_an_effect_made_thinner_than_nothing_is_refused() -> None:
    """A film of negative thickness would be computed as if it were one: R(0) = 0.998 and no word."""
    stack = dbr_of(PAPER, 2.5)
    layer = stack.layers[1].model_copy(update={"thickness_nm": -45.2})
    wrong = stack.model_copy(update={"layers": (stack.layers[0], layer, *stack.layers[2:])})
    with pytest.raises(InputError, match=r"thickness_nm: got -45\.2"):
        resolve(wrong, [445.0])
