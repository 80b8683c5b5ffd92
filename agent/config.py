"""What a campaign is: which designer looks where, how well designs are evaluated, when it stops."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

from pydantic import Field, model_validator

from agent.ddqn import Learning
from agent.designers import NAMES, SEARCHES, WITHOUT_START, learning_of
from luxloop.campaign import Fidelity, Plan, Reward
from luxloop.design import Bounds, Design
from luxloop.errors import InputError
from luxloop.files import read_text, toml_of
from luxloop.model import Model
from luxloop.words import Words, parse

TWIN_HISTORIES = 131_072
"""Exits that the twin lands where nothing else is said."""


STEPS_PER_EVALUATION = 10
BUDGET_S = 600.0
"""Of one evaluation; far above what a design takes, so that no slow machine changes a walk."""


class Stop(Words):
    """When a campaign has had enough; the first that is met ends it, and stands in its journal."""

    evaluations: int = Field(200, ge=1, le=10**7, description="Different designs evaluated.")
    steps: int | None = Field(
        None, ge=1, le=10**8, description="Steps, known designs counted each time; none: 10 for each evaluation."
    )
    time_s: float | None = Field(None, gt=0.0, le=1e7, description="Seconds since the first action; none: no limit.")
    episodes_without_gain: int | None = Field(
        None, ge=1, le=10**6, description="Episodes that ended without a gain above twice its error; none: no limit."
    )

    @property
    def most_steps(self) -> int:
        """Steps after which the walk ends: a learner that goes back and forth evaluates nothing new."""
        return self.steps or STEPS_PER_EVALUATION * self.evaluations


class Campaign(Words):
    """All settings of a campaign; what is left out has its default."""

    designer: str = Field("ddqn-fast", description="One of: " + ", ".join(NAMES) + ".")
    learning: Learning | None = Field(None, description="A learner's settings; none: its preset.")
    bounds: Bounds = Field(Bounds.preset("paper-table3"), description="Where to look, and the grid's steps.")
    start: Design | None = Field(None, description="Where to begin; none: drawn from the grid.")
    reward: Reward | None = Field(None, description="None: the designer's own, else gain.")
    method: Literal["monte_carlo", "twin"] = Field("monte_carlo", description="Solver of the walk.")
    walk_error_points: float = Field(1.0, ge=1e-3, le=100.0, description="Standard error of U in the walk.")
    twin_histories: int = Field(TWIN_HISTORIES, ge=1, le=10**9, description="Exits the twin lands.")
    final_error_points: float = Field(0.3, ge=1e-3, le=100.0, description="Standard error of U of the finalists.")
    finalists: int = Field(5, ge=1, le=100, description="Best designs evaluated anew; they alone are reported.")
    lanes: int = Field(4, ge=1, le=64, description="Designs under evaluation at once.")
    seed: int = Field(1, ge=0, le=10**9, description="Of the designer's choices and of all random numbers.")
    stop: Stop = Stop()

    @model_validator(mode="after")
    def _designer_is_known(self) -> Campaign:
        if self.designer not in NAMES:
            raise InputError("designer", self.designer, " or ".join(NAMES))
        if self.learning is not None and self.designer in SEARCHES:
            raise InputError("learning", self.designer, "a learner (ddqn-...)", "a search has nothing to set")
        if self.start is not None and not self.bounds.contains(self.start):
            raise InputError("start", str(self.start), f"from {self.bounds.low} to {self.bounds.high}")
        return self

    @property
    def learner(self) -> Learning | None:
        """The learner's settings, None for a search. A preset's schedule fits the campaign's budget.

        The paper's agent explores for half of its run; the fast one needs no more than its preset says.
        """
        if self.designer in SEARCHES:
            return None
        if self.learning is not None:
            return self.learning
        preset = learning_of(self.designer)
        budget = self.stop.evaluations if preset.profile == "paper" else min(preset.budget, self.stop.evaluations)
        return preset.model_copy(update={"budget": budget})

    def plan(self, run: str, model: Model, source: str, *, kind: Literal["campaign", "grid"] = "campaign") -> Plan:
        """What the controller is told of the run. `source` says where the model comes from, for people."""
        learner = self.learner
        seed = str(self.seed)
        how: dict[str, Any] = (
            {"histories": self.twin_histories}
            if self.method == "twin"
            else {"target_error_points": self.walk_error_points}
        )
        plain = {
            "run": run,
            "kind": kind,
            "model": source,
            "environment": model.environment,
            "effects": model.effects,
            "bounds": self.bounds,
            "reward": self.reward or (learner.reward if learner else "gain"),
            "walk": Fidelity(method=self.method, seed=seed, budget_s=BUDGET_S, **how),
            "final": Fidelity(target_error_points=self.final_error_points, budget_s=BUDGET_S),
            "lanes": self.lanes,
            "maps": kind == "campaign",
        }
        return parse(Plan, plain, "plan")


def read_campaign(path: Path | None, *, compared: bool = False, **given: Any) -> Campaign:
    """The settings in a TOML file (none: the defaults), what is given (not None) over them.

    `bounds` may be a preset's name; `learning` goes over the designer's preset. Another method or a search that
    is given goes over what it does not look at, too. `compared`: the settings are of several designers. Raises
    InputError naming file, field, value and range.
    """
    plain: dict[str, Any] = toml_of(read_text(path, "--config", "a TOML file"), path.name) if path else {}
    method, named = given.get("method"), given.get("designer")
    if method not in (None, plain.get("method", "monte_carlo")):
        plain.pop("walk_error_points" if method == "twin" else "twin_histories", None)
    if named in SEARCHES and named != plain.get("designer"):
        plain.pop("learning", None)
        if isinstance(plain.get("stop"), dict):
            plain["stop"].pop("episodes_without_gain", None)
    for name, value in given.items():
        if value is not None:
            part, _, field = name.partition("__")
            if field:
                table = plain.get(part, {})
                if not isinstance(table, dict):
                    raise InputError(f"{path}: {part}", table, "a table", f"write it under [{part}]")
                plain[part] = {**table, field: value}
            else:
                plain[name] = value
    if isinstance(plain.get("bounds"), str):
        plain["bounds"] = Bounds.preset(plain["bounds"]).model_dump()
    where = str(path) if path else "campaign"
    own = plain.get("learning")
    if isinstance(own, dict):
        preset = parse(Campaign, {**plain, "learning": None}, where).learner
        plain["learning"] = _over(preset, own) if preset else own
    campaign = parse(Campaign, plain, where)
    if campaign.learning is not None:
        _refuse_unmeant(campaign, campaign.learning, f"{where}: learning")
    _refuse_idle(campaign, where, compared)
    return campaign


def _over(preset: Learning, own: dict[str, Any]) -> dict[str, Any]:
    """A preset with settings of one's own over it; another rule of restart leaves the preset's patience behind."""
    patience = {} if own.get("restart", preset.restart) == preset.restart else {"patience": None}
    return preset.model_dump() | patience | own


def _refuse_idle(campaign: Campaign, where: str, compared: bool) -> None:
    """InputError for what a person asks for beside a method or a designer that does not look at it."""
    idle, acting, method = "twin_histories", "walk_error_points", "twin"
    if campaign.method == "twin":
        idle, acting, method = acting, idle, "monte_carlo"
    if idle in campaign.model_fields_set:
        mend = f"leave it out: {acting} says how exact this walk is"
        raise InputError(f"{where}: {idle}", getattr(campaign, idle), f'with method = "{method}" only', mend)
    if campaign.start is not None and campaign.designer in WITHOUT_START and not compared:
        mend = "leave it out: it looks everywhere, in an order of its own"
        raise InputError(f"{where}: start", str(campaign.start), "with pattern or a learner (ddqn-...) only", mend)
    quiet = campaign.stop.episodes_without_gain
    if quiet is not None and campaign.designer in SEARCHES and not compared:
        mend = f"leave it out: {campaign.designer} has no episodes"
        raise InputError(f"{where}: stop.episodes_without_gain", quiet, "with a learner (ddqn-...) only", mend)


def _refuse_unmeant(campaign: Campaign, learning: Learning, where: str) -> None:
    """InputError for a learner's settings that make it another one than is named, or would have no effect.

    Only what a person asks for is looked at: a run on record is what it was.
    """
    if learning.name != campaign.designer:
        mend = f"leave profile and random_actions out, or take the designer {learning.name}"
        raise InputError(where, learning.name, f"settings of the designer, {campaign.designer}", mend)
    if learning.patience is not None and learning.restart != "best":
        mend = f"leave it out: with {learning.restart!r} nothing is waited for"
        raise InputError(f"{where}.patience", learning.patience, 'with restart = "best" only', mend)
    if learning.restart == "start" and campaign.start is None and learning.start is None:
        mend = "say where under [start], with all five lengths of a design"
        raise InputError(f"{where}.restart", learning.restart, "only where a start is given", mend)
