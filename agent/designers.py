"""The designers there are, by name: what a command line or a comparison chooses from."""

from __future__ import annotations

from collections.abc import Callable

from agent.ask_tell import Designer
from agent.ddqn import PRESETS, DoubleDqn, Learning
from agent.moves import Space
from agent.searches import GridSearch, PatternSearch, RandomSearch
from luxloop.design import Design
from luxloop.errors import InputError

SEARCHES: dict[str, Callable[..., Designer]] = {"random": RandomSearch, "pattern": PatternSearch, "grid": GridSearch}
WITHOUT_START = tuple(name for name in SEARCHES if name != "pattern")
NAMES = (*(f"ddqn-{profile}{end}" for profile in PRESETS for end in ("", "-random")), *SEARCHES)


def learning_of(name: str) -> Learning:
    """The preset of a learner's name: `ddqn-paper`, `ddqn-fast`, with `-random` for random actions."""
    for learning in PRESETS.values():
        for candidate in (learning, learning.model_copy(update={"random_actions": True})):
            if candidate.name == name:
                return candidate
    raise InputError("designer", name, " or ".join(NAMES))


def designer(
    name: str,
    space: Space,
    *,
    seed: int,
    lanes: int = 1,
    start: Design | None = None,
    learning: Learning | None = None,
) -> Designer:
    """The designer of that name; `learning` instead of a learner's preset, `start` for those that have one.

    Raises InputError where nobody has the name.
    """
    if name in SEARCHES:
        options = {} if name in WITHOUT_START else {"start": start}
        return SEARCHES[name](space, seed=seed, lanes=lanes, **options)
    settings = learning or learning_of(name)
    return DoubleDqn(space, settings.model_copy(update={"start": start or settings.start}), seed=seed, lanes=lanes)
