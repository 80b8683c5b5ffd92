"""The words for work of the ray-tracing worker (PC3): which module, how it is solved and how well, what comes back.

Everything that decides a result is in its request, the seeds and the film's hash too; wall clock and threads are not.
"""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from luxloop.camera import Camera
from luxloop.design import Design
from luxloop.effect import AppliedEffect
from luxloop.errors import InputError
from luxloop.model import Environment, Fraction
from luxloop.words import Name, Sha256, Words

KIND = "ray"

Seed = Annotated[str, Field(pattern=r"^(0|[1-9][0-9]{0,18})$", coerce_numbers_to_str=True)]
Chips = Annotated[int, Field(ge=1, le=100)]
Power = Annotated[float, Field(ge=0.0, le=1000.0)]
Offset = Annotated[float, Field(ge=-1e4, le=1e4)]


class Film(Words):
    """The table of the design's DBR as PC2 answered it."""

    sha256: Sha256
    bytes: int = Field(gt=0, le=64 << 20)


class ChipArray(Words):
    """A finite module about its centre, its chips listed row by row from the lowest y."""

    rows: Chips
    columns: Chips
    half_um: float | None = Field(None, gt=0.0, le=1e6, description="Centre to edge; none: half a pitch past chips.")
    wall_reflectance: Fraction | None = Field(None, description="Of a mirror at the edge; none: the edge is open.")
    power: tuple[Power, ...] = Field((), max_length=10_000, description="Of each chip, relative; none: all 1.")
    offset_um: tuple[tuple[Offset, Offset], ...] = Field((), max_length=10_000, description="x, y of each chip.")


class Module(Words):
    """A design in an environment, as a scene is built from it."""

    environment: Environment
    design: Design
    film: Film | None = Field(None, description="Of the design's DBR; none: no pairs.")
    effects: tuple[AppliedEffect, ...] = Field((), max_length=64)
    array: ChipArray | None = Field(None, description="A finite module; none: chips without end.")


class RayRequest(Module):
    """A design in an environment, solved up to a count of histories or up to an error of its uniformity."""

    KIND: ClassVar[str] = KIND

    method: Literal["monte_carlo", "twin"] = "monte_carlo"
    histories: int | None = Field(None, ge=1, le=10**11, description="At least so many.")
    target_error_points: float | None = Field(None, ge=1e-3, le=100.0, description="Of U; 1 point is 0.01.")
    budget_s: float = Field(60.0, gt=0.0, le=86_400.0, description="What would take longer is refused.")
    seed: Seed = "1"
    stored_exits: bool = Field(False, description="Land stored exits instead of full histories.")
    exit_seed: Seed = Field("1", description="Of the walk inside the chip, where exits are stored or returned.")
    map_bins: int = Field(64, ge=2, le=512, description="Along the longer side of the map.")
    far_field: bool = False
    exit_histories: int = Field(0, ge=0, le=10_000_000, description="Whose exits come back as rays.")
    images: tuple[Camera, ...] = Field((), max_length=64)

    @model_validator(mode="after")
    def _one_end(self) -> RayRequest:
        if (self.histories is None) == (self.target_error_points is None):
            allowed = "a count, or else target_error_points"
            raise InputError("histories", self.histories, allowed, "give one of the two")
        return self


class EffectsRequest(Words):
    """Which effects the worker knows, its folder of the user's own looked through again."""

    KIND: ClassVar[str] = KIND

    task: Literal["effects"] = "effects"


class ShotRequest(Module):
    """A finite module, and the camera whose image of it is predicted."""

    camera: Camera = Field(Camera(), description="What it does before its gain; its sensor has no part in this.")
    apart: str = Field("", max_length=256, description="Of an anchor: names a module that shares no random numbers.")


class AnchorRequest(Words):
    """Where Monte Carlo is run, and whose chips' exits stand for those of chips near them."""

    shots: tuple[ShotRequest, ...] = Field((), max_length=64, description="One for each; none: the wanted ones.")
    histories: int = Field(ge=0, le=10**9, description="At least so many for each module; 0: none, exits alone.")
    seed: Seed = "1"
    stored_exits: bool = Field(False, description="Land stored exits instead of full histories.")


class PredictionRequest(Words):
    """What cameras see of finite modules, by the twin, and how that changes; `task` tells it from a simulation."""

    KIND: ClassVar[str] = KIND

    task: Literal["prediction"] = "prediction"
    shots: tuple[ShotRequest, ...] = Field(min_length=1, max_length=64, description="Images of one size.")
    columns: tuple[Name, ...] = Field((), max_length=64, description="Parameters to differentiate by.")
    anchor: AnchorRequest | None = None
    noise: bool = Field(True, description="Told, and in the images; else they are by another run, for differences.")
    exit_histories: int = Field(131_072, ge=1, le=524_288, description="Whose exits the twin lands.")
    exit_seed: Seed = Field("1", description="Of the walk inside the chip.")
