"""What the physics is asked with: the `Environment`, and the `Model` file around it.

    receiver   ─────────────────────────────── diffuser, z = D
                       air
    top face        ┌──────┐  DBR: GaN and AlN layers          z = T
    chip            │ GaN  │  active layer at depth x T
    chip bottom  ───┴──────┴─────────────────── substrate, z = 0

An `Environment` holds every reading of the module that is not a design variable; a `Model` is an environment with
effects on top, and with a note for each parameter that may be fitted. Values stand in the environment and in the
effects, once; `fit` says what may move. What belongs to single samples of the data, as the powers of their chips,
stands in `samples` and holds for them only: a design has the effects as they are under `effects`. Only what changes
results (`environment`, `effects`, `samples`) enters `Model.sha256`.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field, field_validator, model_validator

from luxloop.design import DistanceFrom, SpacingIs
from luxloop.effect import AppliedEffect, Name, Value, did_you_mean, refuse_twice
from luxloop.errors import InputError
from luxloop.words import Words, parse, sha256_of

Index = Annotated[float, Field(gt=1.0, le=5.0)]
Thickness = Annotated[float, Field(ge=1.0, le=1000.0)]
Fraction = Annotated[float, Field(ge=0.0, le=1.0)]


class Strict(Words):
    """Words in which "0.97" or true is not a number: a value in a file is taken as it was written or not at all."""

    model_config = ConfigDict(strict=True)


class Surface(Strict):
    """How a large surface of the module scatters: substrate or receiver."""

    scatter: Literal["gaussian", "lambertian"] = Field(
        description="Shape of the scattered light: a lobe about the mirror direction, or Lambert's cosine law."
    )
    sigma_deg: float | None = Field(
        None, gt=0.0, le=40.0, description="Rayleigh scale of the lobe's polar angle; only where scatter is gaussian."
    )
    reflectance: Fraction = Field(description="Share of the incident power that the surface sends back.")

    @model_validator(mode="after")
    def _sigma_goes_with_the_lobe(self) -> Surface:
        if self.scatter == "gaussian" and self.sigma_deg is None:
            raise InputError("sigma_deg", None, "above 0 to 40 deg for a gaussian surface", "give the lobe's width")
        if self.scatter == "lambertian" and self.sigma_deg is not None:
            raise InputError("sigma_deg", self.sigma_deg, "nothing beside scatter = lambertian", "remove sigma_deg")
        return self


class Environment(Strict):
    """Every reading of the module that is not a design variable; the defaults are the clear chip."""

    peak_nm: float = Field(445.0, ge=390.0, le=770.0, description="Peak wavelength of the chip's Gaussian spectrum.")
    fwhm_nm: float = Field(18.0, gt=0.0, le=100.0, description="Full width at half maximum of that spectrum.")
    flux_per_chip_w: float = Field(
        1.482e-3,
        gt=0.0,
        le=10.0,
        description="Radiant flux one chip emits inside itself; it scales lux, not uniformity.",
    )
    spectrum: Literal["averaged", "sampled"] = Field(
        "averaged", description="One spectrum-averaged DBR table for all light, or a wavelength per history."
    )
    emission: Literal["isotropic", "in_plane_dipole"] = Field(
        "isotropic", description="Angular law of the emission inside the chip (c-plane wells are in-plane dipoles)."
    )
    active_layer_depth: Fraction | None = Field(
        None,
        description="Height of a thin emitting layer above the chip's bottom as a share of T; none: whole volume.",
    )
    indices: Literal["fixed", "dispersive"] = Field(
        "fixed", description="Refractive indices: n_gan and n_aln as given, or the material tables with dispersion."
    )
    n_gan: Index = Field(2.4869, description="Refractive index of GaN, bulk and layers, where indices is fixed.")
    n_aln: Index = Field(2.1793, description="Refractive index of the AlN layers, where indices is fixed.")
    gan_layer_nm: Thickness = Field(45.2, description="Thickness of each GaN layer of the DBR.")
    aln_layer_nm: Thickness = Field(51.6, description="Thickness of each AlN layer of the DBR.")
    layer_order: Literal["gan_first", "aln_first"] = Field(
        "gan_first", description="Which layer of the DBR lies on the bulk; N.5 pairs end with the same material."
    )
    chip_bottom: Literal["contact", "mirror", "air_gap"] = Field(
        "contact",
        description="What light meets at the chip's bottom: the substrate itself, a mirror, or air above it.",
    )
    chip_absorption_per_cm: float = Field(
        0.0, ge=0.0, le=10_000.0, description="Absorption coefficient inside the chip (Beer-Lambert)."
    )
    spacing_is: SpacingIs = Field(
        "pitch", description="What the spacing S is: chip centre to chip centre, or the gap between chips."
    )
    distance_from: DistanceFrom = Field(
        "substrate", description="Where the distance D to the receiver is measured from."
    )
    substrate: Surface = Field(
        Surface(scatter="gaussian", sigma_deg=5.0, reflectance=0.97),
        description="White coat under and between the chips (z = 0).",
    )
    receiver: Surface = Field(
        Surface(scatter="lambertian", reflectance=0.35),
        description="Diffuser above the chips (z = D); illuminance is read here.",
    )


class Fit(Strict):
    """What a fit may do with one parameter, in that parameter's unit; the value itself stands in the model."""

    free: bool = Field(False, description="Whether calibration moves it.")
    lower: float = Field(description="Least value a fit may try.")
    upper: float = Field(description="Largest value a fit may try.")
    prior_mean: float | None = Field(None, description="Mean of the Gaussian prior; none: flat between the limits.")
    prior_sd: float | None = Field(None, gt=0.0, description="Standard deviation of that prior.")

    @model_validator(mode="after")
    def _limits_hold_the_prior(self) -> Fit:
        if not self.lower < self.upper:
            raise InputError("lower", self.lower, f"below upper = {self.upper:g}", "exchange the two")
        if (self.prior_mean is None) != (self.prior_sd is None):
            raise InputError(
                "prior_sd", self.prior_sd, "a prior has both prior_mean and prior_sd", "give both or none"
            )
        if self.prior_mean is not None and not self.lower <= self.prior_mean <= self.upper:
            raise InputError("prior_mean", self.prior_mean, f"{self.lower:g} to {self.upper:g}", "widen the limits")
        return self


class Data(Strict):
    """The measurements that a model is compared with; recorded by `luxloop compare`."""

    path: str = Field(min_length=1, max_length=4000, description="Folder of the data set, from the model file's own.")
    sha256: str = Field(pattern=r"^[0-9a-f]{64}$", description="Of the data set as it was compared.")


class Model(Words):
    """A model file's content: an environment, the effects on top of it in their order, what may be fitted."""

    name: str = Field(min_length=1, max_length=80, pattern=r"^[^\x00-\x1f\x7f]+$", description="For people.")
    notes: str = Field("", max_length=4000, description="For people: where the values come from.")
    environment: Environment = Environment()
    effects: tuple[AppliedEffect, ...] = Field((), max_length=100, description="Each under its own [[effects]].")
    samples: dict[str, dict[Name, dict[Name, Value]]] = Field({}, description="Each under [samples.ID.EFFECT].")
    fit: dict[str, Fit] = Field(default_factory=dict, description='Each under its own [fit."PATH"].')
    data: Data | None = Field(None, description="What `compare` compared it with.")

    @field_validator("effects")
    @classmethod
    def _each_effect_once(cls, effects: tuple[AppliedEffect, ...]) -> tuple[AppliedEffect, ...]:
        refuse_twice("effects", (effect.name for effect in effects))
        return effects

    @model_validator(mode="after")
    def _fit_speaks_of_numbers_that_count(self) -> Model:
        for path, fit in self.fit.items():
            self._refuse_fit(path, fit)
        return self

    @property
    def sha256(self) -> str:
        """The hash of what changes results: environment, effects, samples; not the name, the notes or the fit."""
        plain = self.model_dump(mode="json", include={"environment", "effects", *(["samples"] * bool(self.samples))})
        return sha256_of(plain)

    def leaves(self) -> dict[str, Any]:
        """Everything in the model by dotted path: `environment.substrate.reflectance`, `effects.NAME.PARAMETER`."""
        plain = self.model_dump(mode="json")
        plain["effects"] = {
            effect["name"]: {**effect["parameters"], "source_sha256": effect["source_sha256"]}
            for effect in plain["effects"]
        }
        return flat(plain)

    def with_value(self, path: str, value: Any) -> Model:
        """The model with one leaf of `environment` or `effects` replaced; InputError where it cannot be."""
        parts = path.split(".")
        if path not in self.leaves() or parts[0] not in ("environment", "effects"):
            raise InputError("path", path, "a parameter of the model", did_you_mean(path, self.leaves()))
        plain = self.model_dump()
        if parts[0] == "environment":
            put(plain, parts, value)
        else:
            effect = next(effect for effect in plain["effects"] if effect["name"] == parts[1])
            put(effect, parts[2:] if parts[2] == "source_sha256" else ["parameters", *parts[2:]], value)
        return parse(Model, plain)

    def _refuse_fit(self, path: str, fit: Fit) -> None:
        where, leaves = f"fit.{path}", self.leaves()
        numbers = [name for name in leaves if name.startswith(("environment.", "effects."))]
        if path not in numbers:
            raise InputError(where, path, "the path of a number in the model", did_you_mean(path, numbers))
        values = value if isinstance(value := leaves[path], list) else [value]
        if not all(isinstance(one, float) for one in values):
            raise InputError(where, value, "a number in the model", f"give {path} a value, or remove this table")
        if not all(fit.lower <= one <= fit.upper for one in values):
            raise InputError(
                path, value, f"{fit.lower:g} to {fit.upper:g}, the limits of its fit", "widen the limits"
            )
        if fit.free and self.environment.indices == "dispersive" and path.startswith("environment.n_"):
            raise InputError(f"{where}.free", True, "false where indices is dispersive", f"{path} is not used there")
        if path.startswith("environment."):
            for limit in ("lower", "upper"):
                self._refuse_limit(path, where, limit, getattr(fit, limit))

    def _refuse_limit(self, path: str, where: str, limit: str, value: float) -> None:
        """The limits of a fit must be values that the environment itself would take."""
        plain = self.environment.model_dump()
        put(plain, path.split(".")[1:], value)
        try:
            parse(Environment, plain)
        except InputError as error:
            raise InputError(f"{where}.{limit}", value, error.allowed, f"{path} has that range") from None


def flat(tree: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """The leaves of nested dictionaries by dotted path, in their order."""
    leaves: dict[str, Any] = {}
    for key, value in tree.items():
        leaves |= flat(value, f"{prefix}{key}.") if isinstance(value, dict) else {f"{prefix}{key}": value}
    return leaves


def put(tree: dict[str, Any], path: list[str], value: Any) -> None:
    """Puts a value at a path of nested dictionaries, in place."""
    *parents, last = path
    for part in parents:
        tree = tree[part]
    tree[last] = value
