"""The dipoles that emit lie in the plane of the wells, or stand on it, more often than at random."""

from __future__ import annotations

from containers.effect import SceneEffect, parameter, with_emission
from containers.scene import Scene


class DipoleOrientation(SceneEffect):
    """The dipoles that emit prefer the plane of the wells (a below 0) or the chip's normal (a above 0)."""

    name = "dipole_orientation"
    stage = "emission"
    formula = "intensity inside the chip x (1 + a sin^2 theta) / (1 + 2a/3); a = -1/2: all dipoles in the plane"
    reference = (
        "(1 + cos^2 theta) of in-plane dipoles, c-plane wells: Benisty, Stanley, Mayer, JOSA A 15, 1192 (1998)"
    )
    conserves = ("energy",)

    preference: float = parameter("a of the formula", unit="", lower=-0.5, upper=0.5, off=0.0)

    def scene(self, scene: Scene) -> Scene:
        """The chips' light is born in other directions, as much of it."""
        a = self.preference
        if not a:
            return scene
        factor = lambda cosine: (1.0 + a * (1.0 - cosine**2)) / (1.0 + 2.0 * a / 3.0)  # noqa: E731
        return with_emission(scene, lambda emission: emission.by_direction(factor))
