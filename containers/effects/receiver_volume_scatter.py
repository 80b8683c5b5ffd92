"""Light spreads inside the receiver's plate."""

from __future__ import annotations

from dataclasses import replace

from containers.effect import SceneEffect, parameter, with_receiver
from containers.scene import Scene
from luxloop.errors import InputError


class ReceiverVolumeScatter(SceneEffect):
    """A part of the light spreads sideways inside the receiver's plate before it is recorded."""

    name = "receiver_volume_scatter"
    stage = "volume"
    formula = (
        "E -> (1 - a) E + a (w E) * K, K a Gaussian of standard deviation l along each axis, w 1 within the module, "
        "else 0: the plate ends at the edge, where light leaves it, or walls send it back"
    )
    reference = "lateral spread in diffusing plates (Opt. Express 24, 11727, 2016; 25, 22575, 2017); judged ranges"
    conserves = ("energy",)

    scatter_share: float = parameter("a, of the light", unit="", lower=0.0, upper=0.6, off=0.0, one_sided=True)
    spread_um: float = parameter(
        "l of the formula", unit="um", lower=50.0, upper=500.0, shape_grid=(50.0, 100.0, 200.0, 350.0, 500.0)
    )

    def scene(self, scene: Scene) -> Scene:
        """The plate spreads light."""
        if not self.scatter_share:
            return scene
        if scene.receiver.spread_share:
            raise InputError(
                "receiver.spread_share", scene.receiver.spread_share, "0", "one spread is known, not two"
            )
        plate = lambda r: replace(r, spread_share=self.scatter_share, spread_um=self.spread_um)  # noqa: E731
        return with_receiver(scene, plate)
