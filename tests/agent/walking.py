"""How the tests drive a designer, and small problems to drive it on."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from agent.ask_tell import Designer, Proposal
from luxloop.campaign import Action, Step
from luxloop.design import Bounds, Design
from tests.objectives import Controller

Told = list[tuple[Proposal, Step]]

PLANE = Bounds(
    low=Design.from_vector((100.0, 10.0, 300.0, 5.0, 6.5)),
    high=Design.from_vector((180.0, 10.0, 700.0, 5.0, 6.5)),
    step=Design.from_vector((5.0, 2.0, 25.0, 5.0, 0.5)),
)
"""Two variables, D and S, 17 values each."""


class Function(Controller):
    """A controller whose uniformity (percent) is a plain function of the design in [-1, 1]."""

    def __init__(self, function: Callable[[np.ndarray], float], bounds: Bounds, reward: str = "gain") -> None:
        super().__init__("A", bounds, reward)  # type: ignore[arg-type]  # the tests give names of rewards only
        self.function = function

    def _seen(self, point: tuple[float, ...]) -> float:
        return self.function(self.bounds.normalise(Design.from_vector(point)))


def drive(designer: Designer, controller: Controller, steps: int, lanes: int = 1, learn: bool = False) -> Told:
    """So many rounds of all lanes: ask each, then tell each in order; what was proposed, and what came of it."""
    told: Told = []
    for _ in range(steps):
        asked = [designer.ask(lane) for lane in range(lanes)]
        if learn:
            designer.learn()
        for lane, proposal in enumerate(asked):
            if proposal is not None:
                told.append((proposal, controller.act(action_of(proposal))))
                designer.tell(lane, told[-1][1])
    return told


def action_of(proposal: Proposal) -> Action:
    """The action that a campaign sends for a proposal."""
    record = proposal.record
    words = {"lane": record.lane, "number": record.number, "design": proposal.design, "move": proposal.move}
    return Action(run="test", designer="test", **words)


def designs(told: Told) -> list[Design]:
    """Where the steps led."""
    return [step.design for _, step in told]
