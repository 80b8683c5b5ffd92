"""The words between a designer and the environment-control agent: a plan, an action, the step that came of it.

designer ──Begin──▶ controller     opens the journal of a run
         ──Action─▶                a design is proposed in one of the run's lanes
         ◀──Step───                how uniform it is, and what that is worth; on disk before it is told
         ──Note───▶                what the designer wants to have on record
         ──End────▶                the journal is finished; its root comes back
"""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, field_validator, model_validator

from luxloop.design import Bounds, Design
from luxloop.effect import AppliedEffect
from luxloop.errors import InputError
from luxloop.failure import Failure
from luxloop.model import Environment
from luxloop.ray import Seed
from luxloop.words import Name, Plain, Sha256, Text, Words

RunId = Annotated[str, Field(min_length=1, max_length=60, pattern=r"^[a-z0-9][a-z0-9-]*$")]
Lane = Annotated[int, Field(ge=0, le=63)]
Number = Annotated[int, Field(ge=0, le=10**9)]
Share = Annotated[float, Field(ge=-1.0, le=1.0)]
Reward = Literal["r1", "r2", "r3", "gain"]
REWARDS: dict[str, str] = {
    "r1": "(U - U_before) / 100, U in percent (Eq. 3)",
    "r2": "(U - 75)^3 / 1000 (Eq. 4)",
    "r3": "(U - 79)^3 / 1000 (Eq. 5)",
    "gain": "(U - U_before) / 10",
}
"""What a reward is, by name; U in percent."""
Role = Literal["finalist", "best", "start", "without_dbr"]
"""What a final evaluation is for: one of the walk's best; the best of these once more; where the walk began; the
best without its mirror."""
MAX_ATTACHMENT = 1 << 20
LIMIT_S = 86_400.0
"""Longest computation of one evaluation; its fidelity's budget is what bounds it."""


class Fidelity(Words):
    """How well designs are evaluated, and with which random numbers."""

    method: Literal["monte_carlo", "twin"] = "monte_carlo"
    histories: int | None = Field(None, ge=1, le=10**11, description="At least so many; for the twin, of its exits.")
    target_error_points: float | None = Field(None, ge=1e-3, le=100.0, description="Of U; 1 point is 0.01.")
    budget_s: float = Field(60.0, gt=0.0, le=86_400.0, description="An evaluation that would take longer is refused.")
    stored_exits: bool = Field(False, description="Land stored exits of each chip instead of full histories.")
    seed: Seed = Field("1", description="One for all designs: differences between them are then less noisy.")

    @model_validator(mode="after")
    def _one_end(self) -> Fidelity:
        if (self.histories is None) == (self.target_error_points is None):
            mend = "give one of the two"
            raise InputError("histories", self.histories, "a count, or else target_error_points", mend)
        if self.method == "twin" and self.histories is None:
            raise InputError("histories", None, "a count where method is twin", "131,072 are usual")
        return self


class Plan(Words):
    """What the controller must know of a run: the model, where to look, what is rewarded, how well one looks."""

    run: RunId
    kind: Literal["campaign", "grid", "validation"] = "campaign"
    model: Text = Field("", description="Where the environment comes from, for people.")
    environment: Environment
    effects: tuple[AppliedEffect, ...] = Field((), max_length=64)
    bounds: Bounds
    reward: Reward = "gain"
    walk: Fidelity = Field(description="Of every step.")
    final: Fidelity = Field(description="Of the finalists, each with a seed of its own.")
    lanes: int = Field(1, ge=1, le=64, description="Designs that may be under evaluation at once.")
    maps: bool = Field(True, description="Every step's map goes into the journal; else the finalists' only.")

    @model_validator(mode="after")
    def _some_design_can_be_built(self) -> Plan:
        """A box whose best corner is infeasible holds nothing: most room, thinnest and narrowest chip."""
        low, high, environment = self.bounds.low, self.bounds.high, self.environment
        roomy = Design(
            distance_um=high.distance_um,
            width_um=low.width_um,
            spacing_um=high.spacing_um,
            thickness_um=low.thickness_um,
            dbr_pairs=low.dbr_pairs,
        )
        reason = roomy.feasibility(environment.distance_from, environment.spacing_is)
        if reason is not None:
            raise InputError("bounds", str(roomy), "a box with a feasible design", f"{reason}: widen it")
        return self


class Begin(Words):
    """A designer opens a run; answered by `Begun`, `Nothing` while its journal is read, or why it cannot be opened.

    A run has one designer at a time: one that was taken over from, while it was not heard of, is refused.
    """

    plan: Plan
    designer: Name = Field(description="This process: a second one on the same run is refused.")
    facts: Plain = Field(default_factory=dict, description="Into the journal: argv, configuration, packages.")
    attachments: dict[Name, str] = Field(default_factory=dict, max_length=16)
    resume: bool = Field(False, description="Go on with a run that exists: what its journal holds is not done again.")
    root: Sha256 | None = Field(None, description="Of the chain of the journal that is to be gone on with.")

    @field_validator("attachments")
    @classmethod
    def _bounded(cls, attachments: dict[str, str]) -> dict[str, str]:
        for name, text in attachments.items():
            if len(text) > MAX_ATTACHMENT:
                raise InputError(f"attachments.{name}", len(text), f"up to {MAX_ATTACHMENT:,} characters")
        return attachments

    def same_run(self, other: Begin) -> bool:
        """Whether both are of one designer and one run, opened or opened again."""
        return self.model_copy(update={"resume": other.resume, "root": other.root}) == other


class Begun(Words):
    """The run is open: where its journal lies, as the controller names it, and how many steps were on record."""

    run: RunId
    folder: Text
    segment: int
    steps: int = 0


class Move(Words):
    """One variable by so many of the bounds' steps, up or down."""

    variable: Literal["distance_um", "width_um", "spacing_um", "thickness_um", "dbr_pairs"]
    steps: int = Field(ge=-1000, le=1000)

    @field_validator("steps")
    @classmethod
    def _somewhere(cls, steps: int) -> int:
        if steps == 0:
            raise InputError("steps", steps, "not 0: a move goes somewhere")
        return steps


class AgentRecord(Words):
    """What a learner was like when it chose an action."""

    lane: Lane
    number: Number
    episode: Number = 0
    epsilon: float = Field(0.0, ge=0.0, le=1.0)
    greedy: bool = False
    q: float | None = None
    loss: float | None = None
    updates: Number = 0
    weights_sha256: Text = ""


class Action(Words):
    """What is to be evaluated next in a lane: a design, or a move from where the lane is.

    `number` counts a lane's actions from 0; the same action asked twice is one, and gets the same step, also after
    the run was resumed. A final action leaves its lane where it was, and may lie outside the bounds (the best design
    without its DBR).
    """

    run: RunId
    designer: Name
    lane: Lane
    number: Number
    design: Design | None = None
    move: Move | None = None
    final: bool = Field(False, description="With the plan's final fidelity, and `seed` for its own.")
    seed: Seed | None = None
    role: Role | None = Field(None, description="What a final evaluation is for.")
    agent: AgentRecord | None = Field(None, description="What the designer was like; goes on record with the step.")

    @model_validator(mode="after")
    def _one_of_them(self) -> Action:
        if (self.design is None) == (self.move is None):
            raise InputError("design", self.design, "a design, or else a move", "give one of the two")
        for name in ("seed", "role"):
            if getattr(self, name) is not None and not self.final:
                raise InputError(name, getattr(self, name), "nothing but with final")
        if self.final and self.seed is None:
            raise InputError("seed", None, "a seed of its own with final")
        return self


class Cut(Words):
    """The line of Eq. 8 of a finalist, from edge to edge of the module or the cell."""

    x_um: tuple[float, ...] = Field(max_length=10_000)
    illuminance_lx: tuple[float, ...] = Field(max_length=10_000)
    illuminance_error_lx: tuple[float, ...] = Field(max_length=10_000, description="Standard errors.")


class Step(Words):
    """State and reward, in the one format for every designer: where the lane is now, how good that is."""

    FIGURES: ClassVar[tuple[str, ...]] = ("uniformity", "mean_illuminance_lx", "optical_efficiency", "hot_spot_ratio")
    CIRCUMSTANCES: ClassVar[set[str]] = {"run", "cut", "cached", "physics_s", "controller_s", "failure"}

    run: RunId
    lane: Lane
    number: Number
    design: Design
    move: Move | None = Field(
        None, description="What led here from where the lane was; none: a design was asked for."
    )
    state: tuple[Share, Share, Share, Share, Share] = Field(description="The design in [-1, 1] of the bounds.")
    uniformity: float = Field(description="Eq. 8, 0 to 1; 0 where the design is infeasible.")
    uniformity_error: float = Field(0.0, ge=0.0, description="Its standard error.")
    reward: float
    feasible: bool = True
    reason: Text = Field("", description="Why it is infeasible, or why the move led nowhere.")
    figures: Plain = Field(default_factory=dict, description="Other metrics: {value, standard_error} by name.")
    final: bool = False
    role: Role | None = Field(None, description="What a final evaluation is for.")
    cut: Cut | None = Field(None, description="Of a finalist.")
    cached: bool = Field(False, description="Known before, or by another step: no worker had to compute it.")
    task_id: Sha256 | None = Field(None, description="Of the ray task.")
    film_task_id: Sha256 | None = None
    physics_s: float = Field(0.0, ge=0.0, description="Computing time of the workers; once in a run.")
    controller_s: float = Field(0.0, ge=0.0, description="From the action to this step, waiting included.")
    failure: Failure | None = Field(None, description="Why it could not be evaluated; the figures then mean nothing.")

    def content(self) -> dict[str, Any]:
        """The step without what depends on clocks, workers and on what happened to be known: the same in any run of
        the same plan, designer and seed, however often that was interrupted."""
        plain = self.model_dump(mode="json", exclude=self.CIRCUMSTANCES)
        return plain | {"failure": self.failure.code if self.failure else None}


class Note(Words):
    """Something a designer wants to have on record; answered once it is on disk.

    The same number again, after an answer that was lost, is the same note, as long as the controller lives.
    """

    run: RunId
    designer: Name
    number: Number | None = Field(None, description="Counts a designer's notes; none: each is another one.")
    agent: AgentRecord | None = None
    result: Plain | None = Field(None, description="What was found, at the end of a run.")
    validation: Plain | None = Field(None, description="A `ValidationStep`: model and data compared.")
    residual_maps: dict[Name, tuple[tuple[float, ...], ...]] = Field(
        default_factory=dict, max_length=64, description="In standard deviations, by shot."
    )
    log: Text = ""


class End(Words):
    """The run is over, for this reason."""

    run: RunId
    designer: Name
    reason: Text
    complete: bool = Field(False, description="Nothing is left to do; else the run may be gone on with.")


class Ended(Words):
    """The journal is finished: how many records, and the root of their chain (which should leave the machine)."""

    run: RunId
    records: int
    root: Sha256
    folder: Text
