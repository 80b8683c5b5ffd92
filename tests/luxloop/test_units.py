"""Every number with a dimension says its unit in its name: in messages, files and frozen descriptions."""

from __future__ import annotations

import dataclasses
import importlib
import pkgutil
import typing
from types import ModuleType
from typing import Any, get_args, get_type_hints

import pytest
from pydantic import Field

from containers.effect import Effect
from luxloop.units import UNITS, unit_of
from luxloop.words import Words

ROOMS = ("luxloop", "agent", "containers", "env_controller", "validation", "viewer")

PURE = {
    # of light and matter
    "n": "refractive index",
    "k": "extinction coefficient, the imaginary part of the index",
    "cauchy": "index, and its slope against 1 / um^2",
    "plus": "added to refractive index and extinction coefficient",
    "fixed": "refractive index and extinction coefficient",
    "free": "limits by name; the names carry the units",
    "n_gan": "refractive index",
    "n_aln": "refractive index",
    "reflectance": "ratio of powers",
    "active_layer_depth": "share of the chip's thickness",
    "dbr_pairs": "count in halves",
    # in the unit of something else
    "lower": "in the unit of the parameter it bounds",
    "upper": "in the unit of the parameter it bounds",
    "prior_mean": "in the unit of the parameter it is the prior of",
    "prior_sd": "in the unit of the parameter it is the prior of",
    "off": "in the unit of the effect's parameter",
    "shape_grid": "in the unit of the effect's parameter",
    "parameters": "values by name; the names carry the units",
    "samples": "values by sample, effect and name; the names carry the units",
    "errors": "values by name; the names carry the units",
    # ratios
    "progress_ratio": "share of a task that is done",
    "tolerance_ratio": "share of the incident power",
    "ratio": "share of a task that is done",
    # of a camera
    "magnification_error": "ratio of lengths",
    "distortion": "ratio of lengths",
    "vignetting": "share of the light",
    "more_psf": "kinds with um, as psf_um",
    "more_vignetting": "laws with shares of the light",
    "uneven_psf": "laws with um and deg, as edge_um and direction_deg of their effects",
    "glare": "share of the light",
    "nonlinearity": "ratio of signals",
    "saturation_knee": "share of the full scale",
    # of an array
    "power": "relative to the nominal chip",
    "wall_reflectance": "ratio of powers",
    # of a learner
    "state": "design in [-1, 1] of its bounds",
    "uniformity": "ratio of illuminances",
    "uniformity_error": "of a ratio of illuminances",
    "reward": "as its formula says",
    "epsilon": "probability",
    "q": "sum of rewards",
    "loss": "of rewards, squared",
    "gamma": "discount",
    "epsilon_first": "probability",
    "epsilon_last": "probability",
    "exploration": "share of a budget",
    "learning_rate": "of Adam",
    # of a formula
    "exponent": "power of a scatter spectrum's fall",
    # of a comparison
    "z": "difference in standard errors",
    "residual_maps": "in standard deviations of the noise",
    # of a blind set
    "amount": "in the unit of its kind",
    "sigma": "length of a whitened image",
    "asked_sigma": "length of a whitened image",
    "rivals": "lengths of whitened images, by name",
    "priors": "each in the unit of its path",
}
UNIT_INSIDE = {
    "heard_s_ago": "seconds; reads as a sentence",
    "seconds": "the unit itself",
    "walk_error_points": "points of uniformity",
    "final_error_points": "points of uniformity",
    "target_error_points": "points of uniformity, of which 1 has 100",
}


def modules() -> list[ModuleType]:
    """Every module of the house."""
    found = [importlib.import_module(room) for room in ROOMS]
    for package in tuple(found):
        for info in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            if info.name != "luxloop.__main__":  # importing that one runs the command line
                found.append(importlib.import_module(info.name))  # noqa: PERF401 a loop reads better with its reason
    return found


def holds_floats(annotation: Any) -> bool:
    """Whether a float stands anywhere in a type: float | None, tuple[float, ...], dict[str, float]."""
    return annotation is float or any(map(holds_floats, get_args(annotation)))


def float_fields(owner: type) -> list[str]:
    """The fields of a model of words or of a dataclass that hold floats."""
    own = get_type_hints(owner)
    names = owner.model_fields if issubclass(owner, Words) else [field.name for field in dataclasses.fields(owner)]
    return [name for name in names if holds_floats(own[name])]


def nameless(owner: type) -> list[str]:
    """The float fields of a class that have neither a unit nor a place among the pure numbers."""
    return [name for name in float_fields(owner) if not unit_of(name) and name not in PURE | UNIT_INSIDE]


def words_of_the_house() -> list[type]:
    """All models of words, wherever they stand, and the frozen dataclasses of the hall."""
    found: dict[str, type] = {}
    for module in modules():
        for value in vars(module).values():
            if not isinstance(value, type) or value.__module__ != module.__name__:
                continue
            if issubclass(value, Effect):  # its parameters state their units, "" too: `Effect.spec` refuses any other
                continue
            in_hall = module.__name__.split(".")[0] == "luxloop" and dataclasses.is_dataclass(value)
            if issubclass(value, Words) or in_hall:
                found[f"{module.__name__}.{value.__qualname__}"] = value
    return list(found.values())


def test_every_float_of_the_house_has_a_unit_or_a_reason() -> None:
    """A new dimensional field without a unit in its name fails here, named with its class."""
    bad = {
        f"{owner.__module__}.{owner.__qualname__}": names
        for owner in words_of_the_house()
        if (names := nameless(owner))
    }
    assert bad == {}


def test_the_walk_sees_models_of_several_rooms_and_levels() -> None:
    """A walk that finds nothing would pass for ever."""
    seen = {owner.__qualname__ for owner in words_of_the_house()}
    assert {"Environment", "Surface", "Fit", "Design", "EffectParameter", "Layer", "Heartbeat"} <= seen


def test_no_reason_is_given_for_a_field_that_is_gone() -> None:
    """The lists of exceptions stay short: what nobody uses leaves them."""
    used = {name for owner in words_of_the_house() for name in float_fields(owner)}
    assert (PURE | UNIT_INSIDE).keys() - used == set()


class Planted(Words):
    """One bad field among good ones, in every shape a float can have."""

    width_um: float
    width: float
    depth: float | None = None
    sides: tuple[float, ...] = ()
    by_name: dict[str, float] = Field(default_factory=dict)
    nested: typing.Annotated[list[float | None], Field()] = Field(default_factory=list)
    count: int = 0
    reflectance: float = 0.5


@dataclasses.dataclass(frozen=True)
class PlantedPlain:
    """The same in a frozen dataclass."""

    length: float
    length_nm: float
    name: str


def test_planted_bad_fields_are_found_and_good_ones_are_not() -> None:
    """The test above is tested."""
    assert nameless(Planted) == ["width", "depth", "sides", "by_name", "nested"]
    assert nameless(PlantedPlain) == ["length"]


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("width_um", "um"), ("flux_per_chip_w", "W"), ("chip_absorption_per_cm", "1/cm"), ("gain_dn_per_e", "DN/e"),
        ("irradiance_w_per_m2", "W/m2"), ("illuminance_lx", "lx"), ("sigma_deg", "deg"), ("n_gan", ""), ("e", ""),
        ("read_noise_e", "e"), ("environment.substrate.sigma_deg", "deg"), ("resident_mb", "MB"), ("dbr_pairs", ""),
    ],
)  # fmt: skip
def test_the_longest_ending_says_the_unit(name: str, unit: str) -> None:
    """`_per_cm` before `_cm`, `_dn_per_e` before `_e`."""
    assert unit_of(name) == unit
    assert all(ending.startswith("_") for ending in UNITS)
