"""A module whose chips have different films on top: scenes with one film each, whose light is added.

    film at -x        film at 0         film at x             shares of a chip's light, of sum 1
    1 ╲             ╱╲             ╱ 1
       ╲___________╱  ╲___________╱
    ────■────■────■────■────■────■──── columns of chips

An image is linear in the chips' powers. So each film has a scene of its own, in which all chips wear it and shine
with the share that it has of them; between two films images are linear in the place. Neglected: light that comes back
to chips meets the film of the chip that it came from.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from containers.acting import Effects
from containers.ray_tracing.build import film_faces
from containers.ray_tracing.monte_carlo import BLOCK
from containers.ray_tracing.stopping import Solver
from containers.ray_tracing.tally import Tally
from containers.scene import Array, Scene
from containers.thin_film.table import FilmTable
from luxloop.model import Environment

MOST_FILMS = 5
SUMS = ("bins", "ledger", "arrivals", "directions")
OTHER_DRAWS = 0xD1B54A32D192ED03
"""Turns the seed from film to film, so that their noise is not the same (that of stored exits is). Another constant
than `exits.LANDING`: with that a film's landing had the numbers of the walk inside the chip."""


def with_tops(scene: Scene, environment: Environment, film: FilmTable | None, effects: Effects) -> Scene:
    """The scene of a finite module with the films that effects give chips at other places, along x."""
    if film is None or not effects.varies_over_module or not isinstance(scene.layout, Array):
        return scene
    columns = np.arange(scene.layout.columns)
    x_um = scene.layout.origin_um[0] + columns * scene.layout.spacing_um
    nodes_um = np.linspace(x_um[0], x_um[-1], min(MOST_FILMS, x_um.size))
    stacks = [effects.beside(film.stack, float(x)) for x in nodes_um]
    if all(stack == film.stack for stack in stacks):
        return scene
    shares = [np.interp(x_um, nodes_um, one) for one in np.eye(nodes_um.size)]
    tops = [
        scene.chip.top if stack == film.stack else film_faces(environment, replace(film, stack=stack))
        for stack in stacks
    ]
    return replace(scene, tops=tuple(zip(tops, shares, strict=True)))


def scenes_of(scene: Scene) -> list[Scene]:
    """The scenes of one film each whose light is that of the scene: itself, where all chips have the same."""
    layout, found = scene.layout, []
    if not scene.tops or not isinstance(layout, Array):
        return [scene]
    for top, share in scene.tops:
        power = layout.power * share
        if np.any(power > 0.0):
            chip = scene.chip if top is scene.chip.top else replace(scene.chip, top=top)
            found.append(replace(scene, chip=chip, layout=replace(layout, power=power), tops=()))
    return found


def solver_of_all(scene: Scene, solver_of: Callable[[Scene, int], Solver], seed: int) -> Solver:
    """What traces a scene: `solver_of` (scene, seed), or one such for each of its films."""
    scenes = scenes_of(scene)
    if len(scenes) == 1:
        return solver_of(scenes[0], seed)
    powers = np.array([one.layout.power.sum() for one in scenes if isinstance(one.layout, Array)])
    solvers = [solver_of(one, seed ^ (number * OTHER_DRAWS % 2**64)) for number, one in enumerate(scenes)]
    return Several(solvers, powers / powers.sum())


class Several:
    """Solvers of scenes that shine together, with as many histories each; the tally is that of all of them."""

    def __init__(self, solvers: Sequence[Solver], shares: Sequence[float]) -> None:
        self._solvers, self._weights = solvers, [len(solvers) * float(share) for share in shares]
        self.tally = self._together()

    def run_to(self, histories: int, report: Callable[[float], None] | None = None) -> Tally:
        """Trace until each group has `histories`, or up to a block for each film more."""
        count = len(self._solvers)
        each = BLOCK * -(-histories // (BLOCK * count))
        for number, solver in enumerate(self._solvers):
            if report is not None:
                report(number / count)
            solver.run_to(each, None if report is None else _part(report, number, count))
        self.tally = self._together()
        return self.tally

    def _together(self) -> Tally:
        tallies = [solver.tally for solver in self._solvers]
        sums = {
            name: sum(w * getattr(one, name) for w, one in zip(self._weights, tallies, strict=True)) for name in SUMS
        }
        return replace(tallies[0], histories=sum(one.histories for one in tallies), **sums)


def _part(report: Callable[[float], None], number: int, count: int) -> Callable[[float], None]:
    return lambda share: report((number + share) / count)
