"""The prefix-sharing real kernel against the general one, the golden table and itself."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from containers.materials import material
from containers.stack import dbr_of, dbr_stack, resolve
from containers.thin_film.lossless import applies, dbr_reflectance, family_reflectance, stack_reflectance
from containers.thin_film.refinement import sampled
from containers.thin_film.transfer_matrix import solve
from luxloop.errors import InputError
from luxloop.film import Spectrum
from luxloop.model import Environment
from luxloop.stack import Layer, Medium, Stack

GOLDEN = json.loads((Path(__file__).parents[1] / "golden" / "thin_film.json").read_text())["tables"]
GAN, ALN = 2.4869, 2.1793
PAIRS = [0.0, *np.arange(4.5, 10.0, 0.5)]


@pytest.mark.parametrize("order", ["gan_first", "aln_first"])
def test_a_family_is_its_members_solved_alone_by_the_general_kernel(
    order: Literal["gan_first", "aln_first"],
) -> None:
    """All pair counts at once agree with the complex kernel to 1e-12, from both sides, to grazing incidence."""
    wavelength, u = np.linspace(400.0, 490.0, 7), np.linspace(0.0, GAN, 120)
    R = dbr_reflectance(
        PAIRS, wavelength, u, n_gan=GAN, n_aln=ALN, gan_layer_nm=45.2, aln_layer_nm=51.6, layer_order=order
    )
    for found, pairs in zip(R, PAIRS, strict=True):
        rows = resolve(dbr_of(Environment().model_copy(update={"layer_order": order}), pairs), wavelength)
        general = solve(rows.index, rows.thickness_nm, rows.roughness_nm, wavelength, u)
        np.testing.assert_allclose(found, general.R_inside, atol=1e-12)
        np.testing.assert_allclose(found[..., u < 1], general.R_outside[..., u < 1], atol=1e-12)
        np.testing.assert_allclose(1.0 - found, general.T, atol=1e-12)


@settings(max_examples=40, deadline=None, derandomize=True)
@given(st.integers(0, 2**31), st.integers(0, 25))
def test_any_lossless_stack_agrees_with_the_general_kernel(seed: int, layers: int) -> None:
    """Random real stacks, evanescent layers among them, half spaces of any index: 1e-12."""
    rng = np.random.default_rng(seed)
    media = [Medium(n=float(n)) for n in rng.uniform(1.0, 3.5, layers + 2)]
    chosen = [Layer(medium=m, thickness_nm=float(rng.uniform(0.0, 120.0))) for m in media[1:-1]]
    rows = resolve(Stack(inside=media[0], layers=tuple(chosen), outside=media[-1]), [450.0, 600.0])
    u = np.linspace(0.0, rows.index.real[0, 0], 30)[:-1]
    assert applies(rows)
    general = solve(rows.index, rows.thickness_nm, 0.0, rows.wavelength_nm, u)
    np.testing.assert_allclose(stack_reflectance(rows, u), general.R_inside, atol=1e-12)


def test_order_of_the_stacks_and_repeats_do_not_matter() -> None:
    """Each stack of a family gets the same answer wherever it stands, twice, or alone."""
    stacks = [[0, 1, 0], [1, 0], [], [0, 1, 0], [0], [1, 1, 0]]
    u = np.linspace(0.0, 1.2, 20)
    together = family_reflectance(GAN, 1.0, [GAN, ALN], [45.2, 51.6], stacks, [445.0], u)
    for stack, found in zip(stacks, together, strict=True):
        alone = family_reflectance(GAN, 1.0, [GAN, ALN], [45.2, 51.6], [stack], [445.0], u)
        assert np.array_equal(alone[0], found)


def test_dispersive_indices_are_taken_per_wavelength() -> None:
    """With GaN and AlN tables the batch agrees with the general kernel on resolved rows."""
    wavelength, u = np.linspace(400.0, 490.0, 5), np.linspace(0.0, 2.4, 40)
    gan, aln = material("GaN").index(wavelength).real, material("AlN").index(wavelength).real
    R = dbr_reflectance([5.5], wavelength, u, n_gan=gan, n_aln=aln, gan_layer_nm=45.2, aln_layer_nm=51.6)
    stack = dbr_stack(
        5.5, gan=Medium(material="GaN"), aln=Medium(material="AlN"), gan_layer_nm=45.2, aln_layer_nm=51.6
    )
    rows = resolve(stack, wavelength)
    general = solve(rows.index, rows.thickness_nm, rows.roughness_nm, wavelength, u)
    np.testing.assert_allclose(R[0], general.R_inside, atol=1e-12)


def test_nodes_may_differ_per_wavelength() -> None:
    """u of shape (wavelength, U) is the loop over wavelengths."""
    wavelength, u = np.array([430.0, 460.0]), np.array([[0.1, 0.5], [0.7, 1.3]])
    R = family_reflectance(GAN, 1.0, [ALN], [51.6], [[0]], wavelength, u)
    for w in range(2):
        one = family_reflectance(GAN, 1.0, [ALN], [51.6], [[0]], wavelength[[w]], u[w])
        assert np.array_equal(R[0, w], one[0, 0])


@pytest.mark.parametrize("case", sorted(GOLDEN))
def test_golden_averages(case: str) -> None:
    """The double-checked table to 1e-9, by the batch function."""
    side, order, pairs = case.split("|")
    wavelength, weight = sampled(Spectrum(), 61)
    u = np.sin(np.radians(GOLDEN[case]["deg"])) * (GAN if side == "GaN" else 1.0)
    R = dbr_reflectance(
        [float(pairs)],
        wavelength,
        u,
        n_gan=GAN,
        n_aln=ALN,
        gan_layer_nm=45.2,
        aln_layer_nm=51.6,
        layer_order="gan_first" if order == "GaN-first" else "aln_first",
    )
    np.testing.assert_allclose(weight @ R[0].mean(axis=1), GOLDEN[case]["R"], atol=1e-9)


def test_a_thick_evanescent_layer_is_left_to_the_general_kernel() -> None:
    """A gap in which the field falls by more than exp(-300) would overflow: `applies` says no, the kernel refuses."""
    gap = Layer(medium=Medium(n=1.0), thickness_nm=1e5)
    rows = resolve(Stack(inside=Medium(n=GAN), layers=(gap,), outside=Medium(n=GAN)), [445.0])
    assert not applies(rows)
    with pytest.raises(InputError, match="general kernel"):
        stack_reflectance(rows, np.array([0.5, 2.0]))


@pytest.mark.parametrize("what", ["k", "roughness", "incoherent"])
def test_a_stack_with_loss_is_not_for_this_kernel(what: str) -> None:
    """Absorption, roughness or an incoherent layer: `applies` says no."""
    layer = Layer(
        medium=Medium(n=ALN, k=0.01 if what == "k" else 0.0),
        thickness_nm=50.0,
        roughness_nm=1.0 if what == "roughness" else 0.0,
        coherent=what != "incoherent",
    )
    assert not applies(resolve(Stack(inside=Medium(n=GAN), layers=(layer,), outside=Medium(n=1.0)), [445.0]))


def test_one_compiled_version_serves_all_inputs() -> None:
    """Read-only, broadcast, strided or empty arrays reach the kernels as one type: nothing compiles at run time."""
    from containers.thin_film import lossless, transfer_matrix  # the kernels are private to their modules

    fixed = np.linspace(0.0, 1.2, 12)[::3]
    fixed.flags.writeable = False
    for stack in ([], [0, 1]):
        family_reflectance(GAN, 1.0, np.broadcast_to(ALN, 2), [45.2, 51.6], [stack], [445.0], fixed)
        solve(np.broadcast_to(2.0, len(stack) + 2), [50.0] * len(stack), 0.0, np.array([445.0])[::-1], fixed)
    assert len(lossless._sweep.signatures) == 1
    assert len(transfer_matrix._solve.signatures) == 1
