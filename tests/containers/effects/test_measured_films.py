"""Effects on measured films: which layer is the film, what they do beside each other, what instruments read."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tmm
from numpy.typing import NDArray
from scipy.integrate import quad

from containers.acting import Effects
from containers.catalogue import Catalogue
from containers.effect import Reading, StackEffect
from containers.effects.film_baseline_offset import FilmBaselineOffset
from containers.effects.film_interlayer import FilmInterlayer
from containers.effects.film_missing_layer import FilmMissingLayer
from containers.materials import material
from containers.stack import StackRows, films_in, resolve, with_film
from containers.thin_film.database import open_database
from containers.thin_film.film_measurement import measure
from containers.thin_film.worker import DATABASE, FilmComputation
from luxloop.computation import Progress
from luxloop.effect import AppliedEffect
from luxloop.errors import InputError
from luxloop.film import FilmMeasurementRequest
from luxloop.stack import Layer, Medium, Stack

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]
AIR, SI = Medium(n=1.0), Medium(material="Si")
GLASS = Layer(medium=Medium(n=1.5), thickness_nm=20_000.0, coherent=False)
FILM = Layer(medium=Medium(n=1.7), thickness_nm=300.0)
OXIDE = Layer(medium=Medium(material="SiO2"), thickness_nm=1.5)
PLATE = Stack(inside=AIR, layers=(GLASS, FILM), outside=AIR)
WAVE = np.array([420.0, 500.0, 640.0])
FRINGES = {"coherent_share": 0.4, "shift_nm": 40.0}
BESIDE: dict[str, dict[str, Any]] = {
    "film_dispersion": {"rise": 0.05},
    "film_absorption_tail": {"extinction": 0.05, "urbach_ev": 0.8},
    "film_thickness_spread": {"spread_ratio": 0.02},
    "film_interlayer": {"thickness_nm": 12.0, "face": "inner"},
    "film_missing_layer": {"thickness_nm": 8.0, "material": "organic", "face": "inner"},
}


def effects(**applied: dict[str, Any]) -> Effects:
    """Effects of the catalogue in the order of a model, ready to act."""
    return Catalogue().effects(
        [AppliedEffect(name=name, parameters=given) for name, given in applied.items()], "test"
    )


def measured(acting: Effects, stack: Stack, wave: Real = WAVE, quantity: Any = "R") -> Real:
    """R or T at normal incidence, as the worker asks for them."""
    spot = tuple((share, lambda nm, one=one: acting.rows(resolve(one, nm))) for share, one in acting.film(stack))
    return measure(spot, quantity, wave, [0.0])[:, 0]


def tmm_mean(layers: Callable[[float], tuple[list[complex], list[float]]], coherent: bool, wave: Real = WAVE) -> Real:
    """R from the air side of (n, d) at each wavelength, half spaces left out, by tmm; its last layer is the glass."""
    found = []
    for nm in wave:
        n, d = layers(float(nm))
        n, d = [1.0, *n, 1.0], [math.inf, *d, math.inf]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            if coherent:
                found.append(tmm.coh_tmm("s", n, d, 0.0, nm)["R"])
            else:
                kinds = ["i", *["c"] * (len(n) - 3), "i", "i"]
                found.append(tmm.inc_tmm("s", n, d, kinds, 0.0, nm)["R"])
    return np.array(found)


# which layer is the film


@pytest.mark.parametrize("name", BESIDE)
def test_film_effects_beside_fringes_of_the_substrate_act_on_the_film(name: str) -> None:
    """The two orders in a model are one, and no share of the spot has a changed substrate."""
    orders = list(permutations({"film_substrate_fringes": FRINGES, name: BESIDE[name]}.items()))
    one, other = (measured(effects(**dict(order)), PLATE) for order in orders)
    np.testing.assert_allclose(one, other, rtol=1e-12)
    for order in orders:
        acting = effects(**dict(order))
        for _, stack in acting.film(PLATE):
            rows = acting.rows(resolve(stack, WAVE))
            glass = int(np.argmax(rows.thickness_nm))
            given_nm = 6.0 if name == "film_interlayer" else 0.0
            assert rows.thickness_nm[glass] + given_nm in (20_000.0, 20_040.0)
            np.testing.assert_array_equal(rows.index[:, glass + 1], 1.5)


def test_dispersion_beside_fringes_is_what_tmm_says() -> None:
    """Film with the slope on glass of one index: 0.6 of the incoherent reflectance and 0.4 of the coherent one."""

    def layers(thick_nm: float) -> Callable[[float], tuple[list[complex], list[float]]]:
        def at(nm: float) -> tuple[list[complex], list[float]]:
            return [1.7 + 0.05 * (nm**-2 - 550.0**-2) / (400.0**-2 - 800.0**-2), 1.5], [300.0, thick_nm]

        return at

    acting = effects(film_substrate_fringes=FRINGES, film_dispersion=BESIDE["film_dispersion"])
    want = 0.6 * tmm_mean(layers(20_000.0), False) + 0.4 * tmm_mean(layers(20_040.0), True)
    np.testing.assert_allclose(measured(acting, PLATE), want, atol=1e-12)


def test_of_two_like_layers_one_stays_the_film_whatever_its_thickness() -> None:
    """310 nm upon 300 nm, spread by 5 %: the outer one alone is thinned to 217 nm, and has the slope everywhere."""
    lower = Layer(medium=Medium(n=1.46), thickness_nm=300.0)
    two = Stack(inside=Medium(n=3.9), layers=(lower, FILM.model_copy(update={"thickness_nm": 310.0})), outside=AIR)
    acting = effects(film_thickness_spread={"spread_ratio": 0.05}, film_dispersion={"rise": 0.1})

    def reflectance(d_nm: float, nm: float) -> float:
        n = 1.7 + 0.1 * (nm**-2 - 550.0**-2) / (400.0**-2 - 800.0**-2)
        return float(tmm.coh_tmm("s", [1.0, n, 1.46, 3.9], [math.inf, d_nm, 300.0, math.inf], 0.0, nm)["R"])

    def density(z: float) -> float:
        return math.exp(-z * z / 2.0) / math.sqrt(2.0 * math.pi)

    want = [
        quad(lambda z, nm=nm: density(z) * reflectance(310.0 * (1.0 + 0.05 * z), nm), -7, 7, limit=200)[0]
        for nm in WAVE
    ]
    np.testing.assert_allclose(measured(acting, two), want, atol=2e-6)


def test_a_plate_without_a_film_has_none_when_it_interferes() -> None:
    """Dispersion leaves the bare plate alone, coherent or not; a layer that is added does not become the film."""
    bare = Stack(inside=AIR, layers=(GLASS,), outside=AIR)
    missing = {"thickness_nm": 8.0, "material": "organic", "face": "outer"}
    acting = effects(film_substrate_fringes=FRINGES, film_dispersion={"rise": 0.1}, film_missing_layer=missing)
    for _, stack in acting.film(bare):
        assert [layer.medium.n for layer in stack.layers] == [1.5, 1.5]
        assert not any(films_in(stack))
        np.testing.assert_array_equal(acting.rows(resolve(stack, WAVE)).index[:, 1:-1], 1.5)


def test_an_effect_that_finds_no_film_says_so(tmp_path: Path) -> None:
    """Asked of the worker: dispersion of a bare plate is a sentence in the answer, of a coated one none."""
    applied = (AppliedEffect(name="film_dispersion", parameters={"rise": 0.1}),)
    asked = FilmMeasurementRequest(
        stack=PLATE.model_copy(update={"layers": (GLASS,)}),
        quantity="R", wavelength_nm=(500.0,), aoi_deg=(0.0,), effects=applied,
    )  # fmt: skip
    with open_database(tmp_path / DATABASE) as database:
        worker = FilmComputation(database)
        bare, _ = worker.compute(asked.model_dump(mode="json"), Progress())
        coated, _ = worker.compute(asked.model_copy(update={"stack": PLATE}).model_dump(mode="json"), Progress())
    (said,) = bare["warnings"]
    assert said.startswith("film_dispersion has no influence: ")
    assert said.endswith("no coherent layer, hence no film")
    assert "warnings" not in coated


def test_an_effect_that_needs_another_one_is_asked_after_it() -> None:
    """A mixed layer of 8 nm in an oxide of 1.5 nm and 10 more: regression, it was asked without them, and refused."""
    acting = effects(
        film_missing_layer={"thickness_nm": 10.0, "material": "SiO2", "face": "inner"},
        film_interlayer={"thickness_nm": 8.0, "face": "inner"},
    )
    thin = Layer(medium=Medium(n=1.45), thickness_nm=5.0)
    assert acting.idle_on(Stack(inside=SI, layers=(OXIDE, thin), outside=AIR), WAVE) == []


class Recoats(StackEffect):
    """A user's effect that makes its layers anew."""

    name = "recoats"
    of = ("film",)
    formula = reference = "-"

    def stack(self, stack: Stack) -> Stack:
        """The same layers, told anew."""
        return stack.model_copy(update={"layers": tuple(Layer(**layer.model_dump()) for layer in stack.layers)})


class Reckons(StackEffect):
    """A user's effect that reckons rows anew, of another stack."""

    name = "reckons"
    of = ("film",)
    formula = reference = "-"

    def rows(self, rows: StackRows) -> StackRows:
        """Those of the plate as it is written."""
        return resolve(PLATE, rows.wavelength_nm)


def test_an_effect_that_loses_the_film_is_refused() -> None:
    """Those after it would not know what to act on: it is named, with what to do."""
    with pytest.raises(InputError, match=r"effects\.recoats.*model_copy"):
        Effects((Recoats(),)).film(PLATE)
    with pytest.raises(InputError, match=r"effects\.reckons.*replace"):
        Effects((Reckons(),)).rows(resolve(with_film(PLATE), WAVE))


# layers at its faces


def test_a_missing_layer_without_a_film_lies_at_the_first_or_last_face() -> None:
    """Grease on a bare plate is where the light comes in, not below it; a bare bulk has one face."""
    bare = Stack(inside=SI, layers=(GLASS,), outside=AIR)
    lie = [
        FilmMissingLayer(thickness_nm=5.0, material="organic", face=face).stack(with_film(bare)).layers.index(GLASS)
        for face in ("inner", "outer")
    ]
    assert lie == [1, 0]
    oxidised = effects(film_missing_layer={"thickness_nm": 2.0, "material": "SiO2", "face": "outer"})
    n = [[complex(material(name).index(nm)) for name in ("SiO2", "Si")] for nm in WAVE]
    want = [
        tmm.coh_tmm("s", [1.0, *of], [math.inf, 2.0, math.inf], 0.0, nm)["R"] for of, nm in zip(n, WAVE, strict=True)
    ]
    np.testing.assert_allclose(measured(oxidised, Stack(inside=SI, outside=AIR)), want, atol=1e-12)


@pytest.mark.parametrize("first", [0, 1])
def test_a_missing_layer_is_there_before_faces_are_rough(first: int) -> None:
    """Whatever stands first in the model, all three faces are rough."""
    both = [
        ("film_missing_layer", {"thickness_nm": 5.0, "material": "organic", "face": "inner"}),
        ("film_interface_roughness", {"roughness_nm": 3.0}),
    ]
    ((_, stack),) = effects(**dict(both[first:] + both[:first])).film(Stack(inside=SI, layers=(FILM,), outside=AIR))
    np.testing.assert_array_equal(resolve(stack, WAVE).roughness_nm, [3.0, 3.0, 3.0])


def mixed(a: Complex, b: Complex, share_b: float) -> Complex:
    """Bruggeman's mixture by Newton's method on its own equation."""
    e_a, e_b = a**2, b**2
    e = (1.0 - share_b) * e_a + share_b * e_b
    for _ in range(60):
        residual = (1 - share_b) * (e_a - e) / (e_a + 2 * e) + share_b * (e_b - e) / (e_b + 2 * e)
        slope = -3 * (1 - share_b) * e_a / (e_a + 2 * e) ** 2 - 3 * share_b * e_b / (e_b + 2 * e) ** 2
        e = e - residual / slope
    return np.asarray(np.sqrt(e))


@pytest.mark.parametrize(
    ("thickness_nm", "left_nm", "share"),
    [(2.0, (0.5, 299.0), 0.5), (3.0, (0.0, 298.5), 0.5), (20.0, (0.0, 281.5), 0.925)],
)
def test_the_mixed_layer_takes_what_a_thin_neighbour_has(
    thickness_nm: float, left_nm: tuple[float, float], share: float
) -> None:
    """Between a film and 1.5 nm of oxide: half of each, then all the oxide and the rest of the film; none is lost."""
    stack = with_film(Stack(inside=SI, layers=(OXIDE, FILM), outside=AIR))
    rows = FilmInterlayer(thickness_nm=thickness_nm, face="inner").rows(resolve(stack, WAVE))
    np.testing.assert_allclose(rows.thickness_nm, [left_nm[0], thickness_nm, left_nm[1]], atol=1e-12)
    assert rows.thickness_nm.sum() == pytest.approx(301.5, abs=1e-12)
    assert list(rows.film) == [False, False, True]
    oxide = material("SiO2").index(WAVE)
    np.testing.assert_allclose(rows.index[:, 2], mixed(oxide, np.full(3, 1.7 + 0j), share), rtol=1e-12)


def test_a_mixed_layer_thicker_than_both_neighbours_is_refused() -> None:
    """With its value, what there is, and what to do."""
    stack = Stack(inside=SI, layers=(OXIDE, FILM.model_copy(update={"thickness_nm": 6.0})), outside=AIR)
    acting = effects(film_interlayer={"thickness_nm": 8.0, "face": "inner"})
    with pytest.raises(InputError, match=r"thickness_nm.*8\.0.*0 to 7\.5 nm.*thinner"):
        measured(acting, stack)


# absorption


@pytest.mark.parametrize("urbach_ev", [0.1, 0.4])
def test_the_tail_is_straight_over_photon_energy(urbach_ev: float) -> None:
    """ln of the absorption coefficient that T of a matched film tells: slope 1 / Eu below the edge, 0 above it."""
    film = Layer(medium=Medium(n=1.5), thickness_nm=2000.0)
    matched = Stack(inside=Medium(n=1.5), layers=(film,), outside=Medium(n=1.5))
    energy_ev = np.array([3.8, 3.6, 3.5, 3.3, 3.1])
    wave = 6.62607015e-34 * 299792458.0 / 1.602176634e-19 * 1e9 / energy_ev
    acting = effects(film_absorption_tail={"extinction": 1e-3, "urbach_ev": urbach_ev})
    a_per_nm = -np.log(measured(acting, matched, wave, "T")) / 2000.0
    edge = 4.0 * np.pi * 1e-3 / 350.0
    below = np.minimum(energy_ev - 6.62607015e-34 * 299792458.0 / 1.602176634e-19 / 350e-9, 0.0)
    np.testing.assert_allclose(a_per_nm, edge * np.exp(below / urbach_ev), rtol=2e-5)


def test_the_spread_follows_the_harmonics_of_a_high_index() -> None:
    """A film of n = 2.5 on n = 5 + i at 300 nm, spread by 100 nm: scipy's mean of tmm, to 1e-4 of R."""
    stack = Stack(
        inside=Medium(n=5.0, k=1.0), layers=(Layer(medium=Medium(n=2.5), thickness_nm=5000.0),), outside=AIR
    )
    wave = np.array([300.0, 301.7])
    found = measured(effects(film_thickness_spread={"spread_ratio": 0.02}), stack, wave)

    def reflectance(d_nm: Real, nm: float) -> Real:
        r1, r2 = (1.0 - 2.5) / 3.5, (2.5 - (5.0 + 1j)) / (7.5 + 1j)
        turn = np.exp(4j * np.pi * 2.5 * d_nm / nm)
        return np.asarray(np.abs((r1 + r2 * turn) / (1.0 + r1 * r2 * turn)) ** 2)

    z = np.linspace(-8.0, 8.0, 20_001)
    weight = np.exp(-(z**2) / 2.0)
    want = [float(weight @ reflectance(5000.0 + 100.0 * z, nm) / weight.sum()) for nm in wave]
    np.testing.assert_allclose(found, want, atol=1e-4)
    too_far = Stack(inside=SI, layers=(Layer(medium=Medium(n=1.5), thickness_nm=20_000.0),), outside=AIR)
    with pytest.raises(InputError, match=r"spread_ratio.*0\.05.*0 to 0\.041"):
        effects(film_thickness_spread={"spread_ratio": 0.05}).film(too_far)


# what instruments read


def analyser_reads(rho: complex, polariser_deg: float, before_deg: float) -> tuple[float, float]:
    """psi and delta in degrees that a rotating analyser finds, its polariser believed to stand at 45 deg.

    Intensities behind the analyser are summed as its detector would; `before_deg` is what a window before the sample
    adds to the phase of p over s, with the sign of delta.
    """
    at = math.radians(polariser_deg)
    p, s = rho * np.exp(1j * math.radians(before_deg)) * math.cos(at), math.sin(at)
    turned = np.linspace(0.0, np.pi, 64, endpoint=False)
    intensity = np.abs(p * np.cos(turned) + s * np.sin(turned)) ** 2
    alpha, beta = (2.0 * np.mean(intensity * f(2.0 * turned)) / np.mean(intensity) for f in (np.cos, np.sin))
    psi = math.degrees(math.atan(math.sqrt((1.0 + alpha) / (1.0 - alpha))))
    return psi, math.degrees(math.acos(beta / math.sqrt(1.0 - alpha**2)))


@pytest.mark.parametrize("azimuth_deg", [-2.0, 0.7])
@pytest.mark.parametrize("retardance_deg", [-1.5, 2.0])
def test_what_an_ellipsometer_out_of_adjustment_reads(azimuth_deg: float, retardance_deg: float) -> None:
    """A film on silicon at 70 deg by tmm, measured by a rotating analyser behind a turned polariser and a window."""
    silicon = complex(material("Si").index(633.0))
    found = tmm.ellips([1.0, 1.46, silicon], [math.inf, 80.0, math.inf], math.radians(70.0), 633.0)
    psi, delta = math.degrees(found["psi"]), math.degrees(found["Delta"])
    rho = math.tan(found["psi"]) * np.exp(1j * found["Delta"])
    want_psi, want_delta = analyser_reads(rho, 45.0 - azimuth_deg, retardance_deg)
    effect = FilmBaselineOffset(offset_percent=0.0, azimuth_deg=azimuth_deg, retardance_deg=retardance_deg)
    assert read(effect, "psi", psi) == pytest.approx(want_psi, abs=1e-9)
    assert read(effect, "delta", delta) == pytest.approx(want_delta, abs=1e-6)
    assert abs(want_psi - psi) > 0.1


def read(effect: FilmBaselineOffset, quantity: Any, value: float) -> float:
    """What is read instead of a value."""
    reading = Reading(quantity, np.array([633.0]), np.array([70.0]), "u")
    return float(effect.curve(np.array([[value]]), reading)[0, 0])


def test_readings_out_of_adjustment_stay_what_they_can_be() -> None:
    """psi stays in 0 to 90 and delta in 0 to 360 deg; R and T may fall below 0, and each is off by itself."""
    effect = FilmBaselineOffset(offset_percent=-1.0, azimuth_deg=-2.0, retardance_deg=-0.5)
    for quantity, value, want in (
        ("R", 0.2, 0.19), ("T", 0.004, -0.006), ("psi", 0.0, 0.0), ("psi", 90.0, 90.0), ("psi", 45.0, 43.0),
        ("delta", 0.2, 359.7),
    ):  # fmt: skip
        assert read(effect, quantity, value) == pytest.approx(want, abs=1e-12)
    off, value = FilmBaselineOffset.at_off(), np.array([[0.3]])
    for quantity in ("R", "T", "psi", "delta"):
        assert off.curve(value, Reading(quantity, WAVE[:1], WAVE[:1], "u")) is value  # type: ignore[arg-type]  # its four words
