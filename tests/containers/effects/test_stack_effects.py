"""Effects on stacks and curves: off is off, and each does what a closed form or another program says it does."""

from __future__ import annotations

import cmath
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tmm
from numpy.typing import NDArray
from scipy.integrate import quad

from containers.acting import Effects
from containers.catalogue import Catalogue
from containers.effect import StackEffect
from containers.effects.dbr_absorption import DbrAbsorption
from containers.effects.dbr_dispersion import DbrDispersion
from containers.effects.dbr_index_error import DbrIndexError
from containers.effects.dbr_layer_order import DbrLayerOrder
from containers.effects.dbr_roughness import DbrRoughness
from containers.effects.dbr_thickness_error import DbrThicknessError
from containers.effects.film_dispersion import FilmDispersion
from containers.effects.film_interface_roughness import FilmInterfaceRoughness
from containers.effects.film_interlayer import FilmInterlayer
from containers.effects.film_missing_layer import FilmMissingLayer
from containers.effects.film_substrate_fringes import FilmSubstrateFringes
from containers.materials import material
from containers.stack import dbr_of, resolve, with_film
from containers.thin_film.database import open_database
from containers.thin_film.film_measurement import interlayer, measure
from containers.thin_film.table import Side, film_table
from containers.thin_film.worker import DATABASE, FilmComputation
from luxloop.computation import Progress
from luxloop.effect import AppliedEffect
from luxloop.errors import InputError
from luxloop.film import FilmMeasurementRequest, FilmTableRequest, Grid, Spectrum
from luxloop.model import Environment
from luxloop.stack import Layer, Medium, Stack

Real = NDArray[np.float64]
PAPER = Environment()
AIR, SI = Medium(n=1.0), Medium(material="Si")
POLYMER = Layer(medium=Medium(cauchy=(1.45, 0.005)), thickness_nm=300.0)
OXIDE = Layer(medium=Medium(material="SiO2"), thickness_nm=1.5)
FILM = Stack(inside=SI, layers=(OXIDE, POLYMER), outside=AIR)
PLATE = Stack(
    inside=AIR,
    layers=(Layer(medium=Medium(n=1.5), thickness_nm=20_000.0, coherent=False), POLYMER),
    outside=AIR,
)
WAVES = np.linspace(380.0, 800.0, 43)
CONSERVING = [spec.name for spec in Catalogue().specs if "energy" in spec.conserves and spec.stage == "stack"]


def effects(name: str, **parameters: Any) -> Effects:
    """One effect of the catalogue, ready to act."""
    return Catalogue().effects([AppliedEffect(name=name, parameters=parameters)], "test")


def values_of(name: str) -> dict[str, Any]:
    """Parameters of an effect well away from off: its upper limits, and choices that are not off."""
    (spec,) = (spec for spec in Catalogue().specs if spec.name == name)
    return {
        one.name: next(word for word in reversed(one.choices) if word != one.off) if one.choices else one.upper
        for one in spec.parameters
    }


def own(stage: str) -> list[str]:
    """The names of the catalogue's effects on stacks or on curves."""
    names = [spec.name for spec in Catalogue().specs if spec.name.startswith(("dbr_", "film_"))]
    return [name for name in names if (name == "film_baseline_offset") == (stage == "detector")]


@pytest.fixture
def computation(tmp_path: Path) -> Iterator[FilmComputation]:
    """The thin-film computation with a database of its own."""
    with open_database(tmp_path / DATABASE) as database:
        yield FilmComputation(database)


def ask(computation: FilmComputation, request: Any) -> tuple[dict[str, Any], dict[str, Any]]:
    """Result and arrays for a request."""
    result, arrays = computation.compute(request.model_dump(mode="json"), Progress())
    return result, dict(arrays)


def table_of(computation: FilmComputation, *applied: AppliedEffect, pairs: float = 2.5) -> dict[str, Any]:
    """The answer for the table of a DBR."""
    request = FilmTableRequest(environment=PAPER, dbr_pairs=pairs, effects=applied, grid=Grid(wavelengths=1))
    return ask(computation, request)[0]


def curve_of(computation: FilmComputation, stack: Stack, *applied: AppliedEffect, quantity: str = "R") -> Real:
    """What is measured of a film at 50 deg."""
    request = FilmMeasurementRequest(
        stack=stack, quantity=quantity, wavelength_nm=tuple(WAVES), aoi_deg=(50.0,), effects=applied
    )
    return np.asarray(ask(computation, request)[1]["value"][:, 0])


def tmm_r(n: list[complex], d: list[float], wavelength_nm: float) -> float:
    """R at normal incidence by the independent program; half spaces first and last."""
    return float(tmm.coh_tmm("s", n, [math.inf, *d, math.inf], 0.0, wavelength_nm)["R"])


# off, energy


@pytest.mark.parametrize("name", own("stack"))
def test_off_gives_back_the_stack_and_its_table(computation: FilmComputation, name: str) -> None:
    """At off the same stacks and the same rows come back, so the table has the same hash and curves the same bits."""
    kind = type(Effects((Catalogue()._known(AppliedEffect(name=name), "test")[1].at_off(),)).all[0])
    assert issubclass(kind, StackEffect)
    effect = kind.at_off()
    dbr, rows = dbr_of(PAPER, 5.5), resolve(FILM, WAVES)
    for stack in (dbr, FILM, PLATE, Stack(inside=SI, outside=AIR)):
        assert effect.stacks(stack) == ((1.0, stack),)
        assert effect.beside(stack, 700.0) == stack
    assert effect.rows(rows) is rows
    applied = AppliedEffect(name=name, parameters=effect.model_dump())
    assert table_of(computation, applied)["table_sha256"] == table_of(computation)["table_sha256"]
    for quantity in ("R", "psi", "delta"):
        plain = curve_of(computation, FILM, quantity=quantity)
        np.testing.assert_array_equal(curve_of(computation, FILM, applied, quantity=quantity), plain)


@pytest.mark.parametrize("name", own("stack"))
def test_on_changes_the_film_it_is_of(computation: FilmComputation, name: str) -> None:
    """Away from off an effect of the DBR changes its stack, one of films a measured curve, and neither the other."""
    if name == "dbr_thickness_gradient":
        assert effects(name, **values_of(name)).beside(dbr_of(PAPER, 2.5), 500.0) != dbr_of(PAPER, 2.5)
        return
    applied = AppliedEffect(name=name, parameters=values_of(name))
    of_dbr = table_of(computation, applied)["table_sha256"] != table_of(computation)["table_sha256"]
    stack = PLATE if name == "film_substrate_fringes" else FILM
    of_film = bool(np.any(curve_of(computation, stack, applied) != curve_of(computation, stack)))
    assert (of_dbr, of_film) == (name.startswith("dbr_"), name.startswith("film_"))


@pytest.mark.parametrize("name", CONSERVING)
def test_what_conserves_energy_makes_no_loss(name: str) -> None:
    """R + T is 1 of a clear stack; for rough faces with what they scatter."""
    acting = effects(name, **values_of(name))
    if name == "dbr_roughness":
        powers = film_table(acting.dbr(dbr_of(PAPER, 5.5)), Spectrum(), Grid(wavelengths=11)).powers("inside")
        np.testing.assert_allclose(sum(powers), 1.0, atol=1e-12)
        assert float(powers.A.max()) < 1e-12
        return
    clear = Stack(inside=Medium(n=1.5), layers=PLATE.layers, outside=AIR)
    spot = ((1.0, acting.dbr(dbr_of(PAPER, 5.5))),) if name.startswith("dbr_") else acting.film(clear)
    if name == "dbr_thickness_gradient":
        spot = ((1.0, acting.beside(dbr_of(PAPER, 5.5), 900.0)),)
    lies = tuple((share, lambda wave, one=one: acting.rows(resolve(one, wave))) for share, one in spot)
    R, T = (measure(lies, quantity, WAVES, [0.0, 40.0]) for quantity in ("R", "T"))
    np.testing.assert_allclose(R + T, 1.0, atol=2e-9)


# the DBR: closed forms and tmm


def quarter_wave(pairs: int, at_nm: float) -> Stack:
    """GaN | (AlN GaN)^pairs | air of quarter waves at a wavelength, the paper's indices."""
    layers = [
        Layer(medium=Medium(n=n), thickness_nm=at_nm / (4.0 * n)) for _ in range(pairs) for n in (2.1793, 2.4869)
    ]
    return Stack(inside=Medium(n=2.4869), layers=tuple(layers), outside=AIR)


def textbook(pairs: int, n_low: float) -> float:
    """R of so many quarter-wave pairs on GaN, against air: ((n0 - Y) / (n0 + Y))^2, Y = (n_low / n_high)^2N."""
    admittance = (n_low / 2.4869) ** (2 * pairs)
    return ((2.4869 - admittance) / (2.4869 + admittance)) ** 2


@pytest.mark.parametrize("error", [-0.05, -0.01, 0.03])
def test_the_stop_band_moves_by_the_thickness_error(error: float) -> None:
    """A mirror of quarter waves at 450 nm is one at 450 (1 + e): R of all wavelengths is that, stretched."""
    stack = DbrThicknessError(error_ratio=error).stack(quarter_wave(20, 450.0))
    np.testing.assert_allclose(
        measure(stack, "R", WAVES * (1.0 + error), [0.0]),
        measure(quarter_wave(20, 450.0), "R", WAVES, [0.0]),
        rtol=1e-9,
    )
    at = 450.0 * (1.0 + error)
    R = measure(stack, "R", [at - 2.0, at, at + 2.0], [0.0])[:, 0]
    assert R[1] == max(R) == pytest.approx(textbook(20, 2.1793), rel=1e-10)


@pytest.mark.parametrize("change", [-0.1, 0.05])
@pytest.mark.parametrize("pairs", [1, 5, 9])
def test_an_index_error_is_the_textbooks_mirror_of_that_index(pairs: int, change: float) -> None:
    """Pairs of quarter waves of the changed index reflect as the closed form says."""
    n = 2.1793 + change
    stack = DbrIndexError(index_change=change).stack(quarter_wave(pairs, 445.0))
    aln = [nm * 2.1793 / n if j % 2 == 0 else nm for j, nm in enumerate(one.thickness_nm for one in stack.layers)]
    layers = tuple(layer.model_copy(update={"thickness_nm": nm}) for layer, nm in zip(stack.layers, aln, strict=True))
    quarter = stack.model_copy(update={"layers": layers})
    assert float(measure(quarter, "R", [445.0], [0.0])[0, 0]) == pytest.approx(textbook(pairs, n), rel=1e-9)


@pytest.mark.parametrize("indices", ["fixed", "dispersive"])
def test_index_and_absorption_go_to_the_aln_alone(indices: str) -> None:
    """n + dn + ik of AlN as tmm has it, whether the index is a number or a material's; GaN stays, the bulk too."""
    environment = PAPER.model_copy(update={"indices": indices})
    plain = dbr_of(environment, 4.5)
    stack = DbrAbsorption(extinction=0.01).stack(DbrIndexError(index_change=-0.04).stack(plain))
    before, after = (resolve(one, [445.0]).index[0] for one in (plain, stack))
    kinds = np.array([0, 0, 1, 0, 1, 0, 1, 0, 1, 0, 0], bool)
    np.testing.assert_allclose(after - before, np.where(kinds, -0.04 + 0.01j, 0.0), atol=1e-15)
    d = [layer.thickness_nm for layer in plain.layers]
    want = tmm_r(list(before[::-1] + np.where(kinds, -0.04 + 0.01j, 0.0)[::-1]), d[::-1], 445.0)
    assert float(measure(stack, "R", [445.0], [0.0])[0, 0]) == pytest.approx(want, abs=1e-12)
    assert Stack.model_validate_json(stack.model_dump_json()) == stack


def test_absorption_takes_what_tmm_says() -> None:
    """k = 0.01 in the AlN of 9.5 pairs, 30 deg in air: R and T of both sides and both polarisations to 1e-12."""
    stack = DbrAbsorption(extinction=0.01).stack(dbr_of(PAPER, 9.5))
    n, d = list(resolve(stack, [445.0]).index[0]), [layer.thickness_nm for layer in stack.layers]
    inner_deg = math.degrees(math.asin(0.5 / 2.4869))
    for p in ("s", "p"):
        sides: tuple[tuple[Side, float, int], ...] = (("inside", inner_deg, 1), ("outside", 30.0, -1))
        for side, at_deg, turn in sides:
            want = tmm.coh_tmm(p, n[::turn], [math.inf, *d[::turn], math.inf], math.radians(at_deg), 445.0)
            for quantity in ("R", "T"):
                found = measure(stack, quantity, [445.0], [at_deg], p, from_side=side)
                assert float(found[0, 0]) == pytest.approx(want[quantity], abs=1e-12)
            assert want["R"] + want["T"] < 0.99


def test_the_layer_order_has_the_papers_two_branches() -> None:
    """2.5 pairs: R(0) of the line 0.378 with GaN first, 0.009 with AlN, here and by tmm, whichever the model has."""
    for order in ("gan_first", "aln_first"):
        stack = dbr_of(PAPER.model_copy(update={"layer_order": order}), 2.5)
        for wanted, R, alone in (("gan_first", 0.378, 0.380), ("aln_first", 0.009, 0.005)):
            swapped = DbrLayerOrder(order=wanted).stack(stack)
            assert swapped == dbr_of(PAPER.model_copy(update={"layer_order": wanted}), 2.5)
            of_line = measure(swapped, "R", [445.0], [0.0], bandwidth_nm=18.0, from_side="inside")
            assert float(of_line[0, 0]) == pytest.approx(R, abs=5e-4)
            media, layers = resolve(swapped, [445.0]).index[0], [layer.thickness_nm for layer in swapped.layers]
            sigmas = np.linspace(-5.0, 5.0, 101)
            by_tmm = [tmm_r(list(media), layers, 445.0 + 18.0 / 2.3548 * at) for at in sigmas]
            assert float(np.average(by_tmm, weights=np.exp(-(sigmas**2) / 2.0))) == pytest.approx(R, abs=5e-4)
            assert tmm_r(list(media), layers, 445.0) == pytest.approx(alone, abs=5e-4)
        assert DbrLayerOrder(order=order).stack(stack) is stack
    with pytest.raises(InputError, match="order"):
        DbrLayerOrder(order="aln_first").stack(dbr_of(PAPER, 0.5))


@pytest.mark.parametrize("first", range(1, 5))
def test_effects_on_the_dbr_act_in_any_order(first: int) -> None:
    """Whatever stands first in the model: thickness, order, index and k commute, and dispersion acts before them."""
    every = (
        DbrIndexError(index_change=0.02), DbrDispersion(indices="literature"), DbrAbsorption(extinction=0.004),
        DbrLayerOrder(order="aln_first"), DbrThicknessError(error_ratio=0.02),
    )  # fmt: skip
    other = (*every[first:], *every[:first])
    stacks = [Effects(some).dbr(dbr_of(PAPER, 3.5)) for some in (every, other)]
    indices = [resolve(stack, [445.0]).index for stack in stacks]
    thickness = [[layer.thickness_nm for layer in stack.layers] for stack in stacks]
    assert thickness[0] == thickness[1]
    np.testing.assert_array_equal(indices[0], indices[1])
    assert indices[0][0].imag.max() == pytest.approx(0.004)
    kinds = [layer.medium.material for layer in stacks[1].layers]
    assert kinds == ["AlN", "GaN"] * 3 + ["AlN"]


def test_dispersion_is_that_of_the_materials_and_leaves_the_bulk() -> None:
    """At 450 nm, where the paper's indices are the literature's, R is the same; the bulk has the model's n."""
    plain = dbr_of(PAPER, 5.5)
    stack = DbrDispersion(indices="literature").stack(plain)
    assert stack.inside == plain.inside
    np.testing.assert_allclose(resolve(stack, [450.0]).index, resolve(plain, [450.0]).index, atol=6e-5)
    np.testing.assert_array_equal(resolve(stack, [430.0]).index[0, 2], material("AlN").index(430.0))
    assert float(measure(stack, "R", [450.0], [0.0])[0, 0]) == pytest.approx(
        float(measure(plain, "R", [450.0], [0.0])[0, 0]), abs=1e-4
    )
    dispersive = dbr_of(PAPER.model_copy(update={"indices": "dispersive"}), 5.5)
    assert DbrDispersion(indices="literature").stack(dispersive) == dispersive


def test_a_rough_face_follows_debye_and_waller() -> None:
    """One AlN layer at normal incidence: Airy's sum with both factors at each face, by hand."""
    s, wave, d = 5.0, 445.0, 51.6
    n = [2.4869, 2.1793, 1.0]
    k = [2.0 * math.pi * one / wave for one in n]

    def face(i: int, j: int) -> tuple[float, float]:
        r, t = (n[i] - n[j]) / (n[i] + n[j]), 2.0 * n[i] / (n[i] + n[j])
        return r * math.exp(-2.0 * (k[i] * s) ** 2), t * math.exp(-(((k[i] - k[j]) * s) ** 2) / 2.0)

    (r01, t01), (r10, t10), (r12, _) = face(0, 1), face(1, 0), face(1, 2)
    turn = cmath.exp(2j * k[1] * d)
    amplitude = r01 + t01 * t10 * r12 * turn / (1.0 - r10 * r12 * turn)
    stack = DbrRoughness(roughness_nm=s).stack(dbr_of(PAPER.model_copy(update={"layer_order": "aln_first"}), 0.5))
    found = float(measure(stack, "R", [wave], [0.0], from_side="inside")[0, 0])
    assert found == pytest.approx(abs(amplitude) ** 2, rel=1e-12)


def test_roughnesses_add_in_squares() -> None:
    """3 nm upon 4 nm are 5 nm, on every face."""
    rough = DbrRoughness(roughness_nm=3.0).stack(dbr_of(PAPER, 1.5, roughness_nm=4.0))
    np.testing.assert_allclose(resolve(rough, [445.0]).roughness_nm, 5.0, rtol=1e-15)


# measured films


def airy(n: float, d_nm: float, wave: Real) -> Real:
    """R at normal incidence of one clear film on n = 3.9 in air, Airy's sum."""
    r1, r2 = (1.0 - n) / (1.0 + n), (n - 3.9) / (n + 3.9)
    turn = np.exp(4j * np.pi * n * d_nm / wave)
    return np.asarray(np.abs((r1 + r2 * turn) / (1.0 + r1 * r2 * turn)) ** 2)


def on_plain(layer: Layer, *below: Layer) -> Stack:
    """Layers on n = 3.9, in air."""
    return Stack(inside=Medium(n=3.9), layers=(*below, layer), outside=AIR)


def test_the_spread_is_the_mean_of_fringes_over_a_normal_distribution() -> None:
    """R of a film of 900 nm with 4 % spread is scipy's integral of Airy's fringes."""
    stack = on_plain(Layer(medium=Medium(n=1.5), thickness_nm=900.0))
    found = measure(effects("film_thickness_spread", spread_ratio=0.04).film(stack), "R", [420.0, 555.0], [0.0])[:, 0]
    for value, wave in zip(found, (420.0, 555.0), strict=True):
        want, _ = quad(
            lambda z, wave=wave: float(
                np.exp(-z * z / 2.0) / math.sqrt(2.0 * math.pi) * airy(1.5, 900.0 * (1.0 + 0.04 * z), np.array(wave))
            ),
            -8.0, 8.0, limit=400,
        )  # fmt: skip
        assert value == pytest.approx(want, abs=2e-6)


def test_spread_takes_the_fringes_away_and_leaves_their_mean() -> None:
    """With 10 % of 3 um fringes of many turns fade to the incoherent sum of the two faces."""
    thick = Layer(medium=Medium(n=1.5), thickness_nm=3000.0)
    spot = effects("film_thickness_spread", spread_ratio=0.1).film(on_plain(thick))
    spread = measure(spot, "R", WAVES, [0.0])
    plain = measure(on_plain(thick), "R", WAVES, [0.0])
    incoherent = measure(on_plain(thick.model_copy(update={"coherent": False})), "R", WAVES, [0.0])
    np.testing.assert_allclose(spread, incoherent, atol=2e-5)
    assert float(np.ptp(plain)) > 0.1


def rows_of(effect: StackEffect, stack: Stack, wave: Real = WAVES) -> Any:
    """The rows that an effect makes of a stack's."""
    return effect.rows(resolve(with_film(stack), wave))


def test_dispersion_turns_the_index_about_550_nm() -> None:
    """n(400) - n(800) grows by s, n(550) stays, and only the film has it."""
    wave = np.array([400.0, 550.0, 800.0])
    before, after = resolve(FILM, wave), rows_of(FilmDispersion(rise=0.03), FILM, wave)
    change = after.index - before.index
    assert not change[:, [0, 1, 3]].any()
    assert change[1, 2] == 0.0
    assert change[0, 2] - change[2, 2] == pytest.approx(0.03, rel=1e-12)


def test_dispersion_shows_in_the_fringes_as_airy_has_them() -> None:
    """A film of 800 nm with the slope reflects at each wavelength as a film of that index does."""
    stack = with_film(on_plain(Layer(medium=Medium(n=1.5), thickness_nm=800.0)))
    acting = effects("film_dispersion", rise=0.05)
    found = measure(lambda wave: acting.rows(resolve(stack, wave)), "R", WAVES, [0.0])[:, 0]
    slope = 0.05 * (WAVES**-2 - 550.0**-2) / (400.0**-2 - 800.0**-2)
    np.testing.assert_allclose(
        found, [airy(1.5 + b, 800.0, w) for w, b in zip(WAVES, slope, strict=True)], atol=1e-12
    )


def test_the_rough_film_is_debye_wallers_and_excludes_the_mixed_layer() -> None:
    """A bare face reflects r^2 exp(-(4 pi s / lambda)^2); roughness and mixed layer together are refused."""
    bare = FilmInterfaceRoughness(roughness_nm=10.0).stack(Stack(inside=Medium(n=3.9), outside=AIR))
    want = (2.9 / 4.9) ** 2 * np.exp(-((4.0 * np.pi * 10.0 / WAVES) ** 2))
    np.testing.assert_allclose(measure(bare, "R", WAVES, [0.0])[:, 0], want, rtol=1e-12)
    both = [
        AppliedEffect(name="film_interface_roughness", parameters={"roughness_nm": 1.0}),
        AppliedEffect(name="film_interlayer", parameters={"thickness_nm": 1.0, "face": "outer"}),
    ]
    with pytest.raises(InputError, match="one of the two"):
        Catalogue().effects(both, "test")


@pytest.mark.parametrize(("face", "number"), [("inner", 1), ("outer", 2)])
def test_the_mixed_layer_lies_at_the_films_face(computation: FilmComputation, face: str, number: int) -> None:
    """Asked of the worker, psi is that of the interlayer of an ellipsometer's model at that face of the polymer."""
    applied = AppliedEffect(name="film_interlayer", parameters={"thickness_nm": 1.4, "face": face})
    want = measure(interlayer(FILM, number, 1.4), "psi", WAVES, [50.0])[:, 0]
    np.testing.assert_array_equal(curve_of(computation, FILM, applied, quantity="psi"), want)
    kept = rows_of(FilmInterlayer(thickness_nm=1.4, face="outer"), FILM)
    assert float(kept.thickness_nm.sum()) == pytest.approx(301.5 + 0.7)  # the air gives half of it


def test_a_missing_oxide_is_the_stack_that_has_it(computation: FilmComputation) -> None:
    """Polymer on bare silicon with 1.5 nm of SiO2 below is the polymer on its native oxide, bit for bit."""
    words = {"thickness_nm": 1.5, "material": "SiO2", "face": "inner"}
    bare = Stack(inside=SI, layers=(POLYMER,), outside=AIR)
    assert str(FilmMissingLayer(**words).stack(with_film(bare))) == str(FILM)
    above = FilmMissingLayer(thickness_nm=2.0, material="organic", face="outer").stack(with_film(bare))
    assert [str(layer.medium) for layer in above.layers] == [str(POLYMER.medium), "1.5"]
    applied = AppliedEffect(name="film_missing_layer", parameters=words)
    for quantity in ("psi", "delta"):
        found = curve_of(computation, bare, applied, quantity=quantity)
        np.testing.assert_array_equal(found, curve_of(computation, FILM, quantity=quantity))
        assert float(np.abs(found - curve_of(computation, bare, quantity=quantity)).max()) > 0.02


def test_fringes_of_the_substrate_are_those_of_a_coherent_plate() -> None:
    """A plate of 20 um, half coherent: fringes of period lambda^2 / 2nd, half as high, about the incoherent mean."""
    plate = PLATE.model_copy(update={"layers": PLATE.layers[:1]})
    wave = np.linspace(600.0, 620.0, 2001)
    spots = [FilmSubstrateFringes(coherent_share=c, shift_nm=0.0).stacks(plate) for c in (0.5, 1.0)]
    half, whole = (measure(spot, "R", wave, [0.0])[:, 0] for spot in spots)
    incoherent = measure(plate, "R", wave, [0.0])[:, 0]
    np.testing.assert_allclose(half, (whole + incoherent) / 2.0, atol=1e-12)
    r2 = 0.2**2
    phase = 4.0 * np.pi * 1.5 * 20_000.0 / wave
    airy_sum = 4.0 * r2 * np.sin(phase / 2.0) ** 2 / ((1.0 - r2) ** 2 + 4.0 * r2 * np.sin(phase / 2.0) ** 2)
    np.testing.assert_allclose(whole, airy_sum, atol=1e-12)
    moved = FilmSubstrateFringes(coherent_share=1.0, shift_nm=40.0).stacks(plate)[1][1]
    assert moved.layers[0].thickness_nm == 20_040.0
    assert FilmSubstrateFringes(coherent_share=0.5, shift_nm=0.0).stacks(FILM) == ((1.0, FILM),)


# asked of the worker


def test_an_effect_that_is_not_of_the_stack_leaves_the_table(computation: FilmComputation) -> None:
    """The same hash with a camera's blur in the model, and it is known, not computed again."""
    blur = AppliedEffect(name="camera_psf", parameters={"psf_um": 20.0, "profile": "gaussian"})
    first, second = table_of(computation), table_of(computation, blur)
    assert second["table_sha256"] == first["table_sha256"]
    assert second["known"]


@pytest.mark.parametrize("name", [name for name in own("stack") if name.startswith("dbr_")])
def test_without_pairs_an_effect_of_the_dbr_says_that_it_has_no_influence(
    computation: FilmComputation, name: str
) -> None:
    """A sentence in the answer; with pairs none."""
    applied = AppliedEffect(name=name, parameters=values_of(name))
    assert table_of(computation, applied, pairs=0.0)["warnings"] == [
        f"{name} has no influence: the chip has no DBR (0 pairs)"
    ]
    assert "warnings" not in table_of(computation, applied, pairs=2.5)


@pytest.mark.parametrize("name", ["film_thickness_spread", "film_dispersion"])
def test_a_table_is_of_one_stack_of_known_media(computation: FilmComputation, name: str) -> None:
    """What makes several stacks or media of its own is for measurements; a table is refused and says so."""
    applied = AppliedEffect(name=name, parameters=values_of(name))
    with pytest.raises(InputError, match="ask for a measurement"):
        ask(computation, FilmTableRequest(stack=FILM, effects=(applied,), grid=Grid(wavelengths=1)))


def test_a_medium_with_an_addition_reads_and_hashes_as_itself() -> None:
    """n + ik of a material, moved, in its sentence; media without one have the dump they always had."""
    moved = Medium(material="AlN", plus=(-0.04, 0.01))
    assert str(moved) == "AlN-0.04+0.01i"
    assert "plus" not in Medium(material="AlN").model_dump()
    with pytest.raises(InputError, match="plus"):
        resolve(Stack(inside=Medium(material="AlN", plus=(0.0, -0.01)), outside=AIR), [445.0])
