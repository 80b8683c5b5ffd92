"""What the effects of a model are to a prediction: asked of the workers once, and only where a model has any."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING, Any

from luxloop.ray import EffectsRequest

if TYPE_CHECKING:
    from luxloop.effect import AppliedEffect
    from luxloop.model import Model
    from validation.prediction.words import Asks

ON_ALL_LIGHT = frozenset(["volume", "detector"])
"""Stages of effects that act on what the twin misses as on its own light: in chip and plate, in camera and sensor."""


class Catalogue:
    """The catalogue of one session."""

    def __init__(self, client: Asks) -> None:
        self._client = client

    @cached_property
    def _specs(self) -> dict[str, dict[str, Any]]:
        told = self._client.run(EffectsRequest(), fresh=True).result["effects"]
        return {one["name"]: one for one in told}

    def beyond_twin(self, model: Model) -> frozenset[str]:
        """Names of a model's effects that the twin cannot represent."""
        return frozenset(one.name for one in model.effects if not self._specs.get(one.name, {}).get("twin", True))

    def by_chance(self, model: Model) -> frozenset[str]:
        """Names of a model's effects that send a share of the light, drawn by chance, another way."""
        return frozenset(one.name for one in model.effects if self._specs.get(one.name, {}).get("by_chance", False))

    def on_all_light(self, model: Model) -> frozenset[str]:
        """Names of a model's effects on what the twin misses, too; none that sends light other ways."""
        specs = {one.name: self._specs.get(one.name, {}) for one in model.effects}
        smooth = {name: one for name, one in specs.items() if one.get("twin", True) and not one.get("walks", False)}
        return frozenset(name for name, one in smooth.items() if one.get("stage") in ON_ALL_LIGHT)

    def of_films(self, model: Model) -> tuple[AppliedEffect, ...]:
        """A model's effects that decide a film's table; one that nobody knows too, so that a worker refuses it."""
        return tuple(one for one in model.effects if self._specs.get(one.name, {}).get("stage", "stack") == "stack")
