"""A model's effects before a run and during it: what a worker would refuse of every design ends it at once.

before    the smallest evaluation there is, with the model's effects: what a worker refuses of it, it refuses of all
during    an effect that a worker no longer knows (its file was changed) ends the walk, to be gone on with later
"""

from __future__ import annotations

import hashlib
from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from agent.report_under import film_request, with_film
from agent.telling import run_argument
from luxloop.bus import Interrupt
from luxloop.campaign import Action, Plan, Step
from luxloop.design import Design
from luxloop.door import RunDoor
from luxloop.errors import InputError, RemoteError
from luxloop.failure import Failure
from luxloop.model import Model
from luxloop.ray import RayRequest

if TYPE_CHECKING:
    from luxloop.client import Client

UNKNOWN = "unknown_effect"
MOST_SOURCES = 10  # a run's beginning holds 16 files


def try_effects(
    client: Client, model: Model, source: str, design: Design, method: Literal["monte_carlo", "twin"]
) -> list[str]:
    """Ask both workers for one history of a design under the model's effects; a sentence for each without influence.

    Nobody is asked where there are none, or where the design cannot be built. An answer that the controller keeps
    does not count, for the user's own effects may have changed since. Raises InputError for an effect that a worker
    does not know, RemoteError for a value, a pair or a method that it refuses; each names the model (`source`), the
    effect, its value, what is allowed, the mend.
    """
    environment = model.environment
    if not model.effects or design.feasibility(environment.distance_from, environment.spacing_is):
        return []
    rays = RayRequest(environment=environment, design=design, effects=model.effects, method=method, histories=1)
    film = film_request(model, design)
    try:
        if film is not None:
            rays = with_film(rays, client.run(film, fresh=True))
        warnings: list[str] = client.run(rays, fresh=True).result.get("warnings", [])
    except RemoteError as error:
        raise _of_model(source, error.failure) from error
    return [one for one in warnings if one.startswith(tuple(effect.name for effect in model.effects))]


def roomiest(plan: Plan) -> Design:
    """A design that can be built wherever one of the run's can: most room, the smallest chip, the most pairs."""
    low, high = plan.bounds.low, plan.bounds.high
    return high.model_copy(update={"width_um": low.width_um, "thickness_um": low.thickness_um})


def sources(model: Model, folder: Path) -> dict[str, str]:
    """The files of the user's own effects in a model, by file name, for the journal: they may change later.

    Those in `folder` whose hash is the model's, ten at most; where the workers' folder is out of reach here, none.
    """
    found: dict[str, str] = {}
    for effect in [one for one in model.effects if one.source_sha256 is not None][:MOST_SOURCES]:
        file = folder / f"{effect.name}.py"
        if file.is_file():
            source = file.read_bytes()
            if hashlib.sha256(source).hexdigest() == effect.source_sha256:
                found[file.name] = source.decode(errors="replace")
    return found


class EffectsKept:
    """The door of a run whose workers must go on knowing its effects; `on_record` are the steps of earlier starts.

    Once `left` is set, nobody waits any longer for what is under way.
    """

    def __init__(self, door: RunDoor, on_record: Collection[Step] = (), left: Interrupt | None = None) -> None:
        self.run, self.designer = door.run, door.designer
        self._door, self._left = door, left
        self._known = {(step.lane, step.number) for step in on_record}

    def act(self, action: Action) -> Step:
        """The step that comes of an action. Raises RemoteError where a worker no longer knows an effect.

        A step on record that failed so is past: the run was gone on with since.
        """
        step = self._door.act(action, self._left)
        failure = step.failure
        if failure is not None and failure.code == UNKNOWN and (step.lane, step.number) not in self._known:
            message = f"the run {self.run} stops: {failure.message}; allowed: {failure.allowed}"
            mend = f"{failure.mend}; then luxloop campaign resume {run_argument(Path(self._door.begun.folder))}"
            raise RemoteError(failure.model_copy(update={"message": message, "mend": mend}))
        return step


def _of_model(source: str, failure: Failure) -> InputError | RemoteError:
    """The refusal, told of the model that it came from."""
    if failure.code == UNKNOWN:
        mend = f"{failure.message}: {failure.mend}"
        return InputError(f"{source}: {failure.field}", failure.value, failure.allowed, mend)
    return RemoteError(failure.model_copy(update={"message": f"{source}: {failure.message}"}))
