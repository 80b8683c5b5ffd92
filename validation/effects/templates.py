"""Example files of effects, one for each stage: what `luxloop effects new` writes, to be changed.

Each is a working effect of some 20 lines that passes its trial. `{name}` and `{Name}` are the effect's own.
"""

from __future__ import annotations

STACK = '''"""{title}: every layer of the DBR is rough."""

from containers.effect import StackEffect, parameter
from luxloop.stack import Stack


class {Name}(StackEffect):
    """Every face of a film is rough."""

    name = "{name}"
    of = ("dbr",)  # ("dbr", "film"): of measured films, too
    formula = "r -> r exp(-2 (k s)^2) at every face, Debye and Waller"
    reference = "where the formula is written, or: engineering judgement"

    rough_nm: float = parameter(
        "rms height of every face", unit="nm", lower=0.0, upper=8.0, off=0.0, score="square", one_sided=True
    )

    def stack(self, stack: Stack) -> Stack:
        if not self.rough_nm:
            return stack
        layers = tuple(layer.model_copy(update={"roughness_nm": self.rough_nm}) for layer in stack.layers)
        return stack.model_copy(update={"layers": layers, "inside_roughness_nm": self.rough_nm})
'''

FILM = '''"""{title}: the film absorbs in a band."""

from dataclasses import replace

import numpy as np

from containers.effect import StackEffect, parameter
from containers.stack import StackRows


class {Name}(StackEffect):
    """Something in a measured film, a dye perhaps, absorbs in a band about 500 nm."""

    name = "{name}"
    of = ("film",)
    scope = "per_sample"
    formula = "k -> k + k0 exp(-((l - 500 nm) / 40 nm)^2) in the film"
    reference = "where the formula is written, or: engineering judgement"

    extinction: float = parameter("k0", unit="", lower=0.0, upper=0.02, off=0.0, one_sided=True)

    def rows(self, rows: StackRows) -> StackRows:
        band = 1j * self.extinction * np.exp(-(((rows.wavelength_nm - 500.0) / 40.0) ** 2))
        film = np.r_[False, rows.film, False]  # of all media: bulk, layers, bulk
        return replace(rows, index=rows.index + np.outer(band, film))
'''

SURFACE = '''"""{title}: less is recorded of light that comes in flat."""

from dataclasses import replace

import numpy as np

from containers.effect import SceneEffect, parameter, with_receiver
from containers.scene import Scene


class {Name}(SceneEffect):
    """What the receiver records of the light depends on the angle theta at which it comes in."""

    name = "{name}"
    stage = "surface"
    formula = "recorded light x (1 - q sin^2 theta)"
    reference = "where the formula is written, or: engineering judgement"

    flat_loss: float = parameter("q, lost at grazing incidence", unit="", lower=-0.4, upper=0.4, off=0.0)

    def scene(self, scene: Scene) -> Scene:
        if not self.flat_loss:
            return scene
        response = 1.0 - self.flat_loss * (1.0 - np.linspace(0.0, 1.0, 65) ** 2)
        return with_receiver(scene, lambda receiver: replace(receiver, response=response))
'''

VOLUME = '''"""{title}: the chip absorbs."""

from dataclasses import replace

from containers.effect import SceneEffect, parameter, with_chip
from containers.scene import Scene


class {Name}(SceneEffect):
    """Light is absorbed inside the chip, beyond what the environment says."""

    name = "{name}"
    stage = "volume"
    formula = "power along a path s: exp(-(a0 + a) s), Beer and Lambert"
    reference = "where the formula is written, or: engineering judgement"

    more_per_cm: float = parameter("a", unit="1/cm", lower=0.0, upper=500.0, off=0.0, one_sided=True)

    def scene(self, scene: Scene) -> Scene:
        per_um = scene.chip.absorption_per_um + 1e-4 * self.more_per_cm
        return with_chip(scene, lambda chip: replace(chip, absorption_per_um=per_um))
'''

EMISSION = '''"""{title}: the chip shines more on one side."""

import numpy as np

from containers.effect import SceneEffect, parameter, with_emission
from containers.scene import Scene


class {Name}(SceneEffect):
    """Light is born more on one side of the chip than on the other."""

    name = "{name}"
    stage = "emission"
    formula = "w -> w (1 + c x), x = -1 to 1 across the chip"
    reference = "where the formula is written, or: engineering judgement"

    lean: float = parameter("c, at the chip's edge", unit="", lower=-0.5, upper=0.5, off=0.0)

    def scene(self, scene: Scene) -> Scene:
        if not self.lean:
            return scene
        weights = 1.0 + self.lean * np.linspace(-1.0, 1.0, 16) * np.ones((16, 1))
        return with_emission(scene, lambda emission: emission.by_place(weights))
'''

GEOMETRY = '''"""{title}: the receiver stands elsewhere."""

from dataclasses import replace

from containers.effect import SceneEffect, parameter
from containers.scene import Scene


class {Name}(SceneEffect):
    """The receiver stands nearer or farther than it was said to."""

    name = "{name}"
    stage = "geometry"
    twin = True  # False: the twin cannot represent it (tilts, walls), so Monte Carlo predicts it, slower
    formula = "D -> D + d"
    reference = "where the formula is written, or: engineering judgement"

    gap_um: float = parameter("d, added to the distance", unit="um", lower=-15.0, upper=15.0, off=0.0)

    def scene(self, scene: Scene) -> Scene:
        return replace(scene, distance_um=scene.distance_um + self.gap_um)
'''

MODULE = '''"""{title}: the module is warm."""

from dataclasses import replace

from containers.effect import SceneEffect, parameter
from containers.scene import Scene


class {Name}(SceneEffect):
    """The module is warm: the receiver stands farther, the chips absorb more."""

    name = "{name}"
    stage = "module"  # may change everything; a narrower stage says more
    formula = "D -> D (1 + g), absorption of the chips + 100 g / cm"
    reference = "where the formula is written, or: engineering judgement"

    warmth: float = parameter("g", unit="", lower=0.0, upper=0.2, off=0.0, one_sided=True)

    def scene(self, scene: Scene) -> Scene:
        chip = replace(scene.chip, absorption_per_um=scene.chip.absorption_per_um + 0.01 * self.warmth)
        return replace(scene, chip=chip, distance_um=scene.distance_um * (1.0 + self.warmth))
'''

DETECTOR = '''"""{title}: the image is darker on one side."""

import numpy as np

from containers.effect import DetectorEffect, Real, parameter
from luxloop.camera import Camera


class {Name}(DetectorEffect):
    """The camera sees less on one side of its image; the other side is as it was."""

    name = "{name}"
    formula = "E -> E (1 - s (1 + x) / 2), x = -1 to 1 across the image"
    reference = "where the formula is written, or: engineering judgement"

    shade: float = parameter("s, lost at one edge", unit="", lower=0.0, upper=0.3, off=0.0, one_sided=True)

    def light(self, image: Real, camera: Camera) -> Real:
        if not self.shade:
            return image
        return image * (1.0 - self.shade * np.linspace(0.0, 1.0, image.shape[-1]))
'''

CURVE = '''"""{title}: the instrument reads too much or too little."""

from containers.effect import CurveEffect, Reading, Real, parameter


class {Name}(CurveEffect):
    """A constant is added to what a spectrometer reads; angles of an ellipsometer are as they were."""

    name = "{name}"
    formula = "R -> R + c, T -> T + c"
    reference = "where the formula is written, or: engineering judgement"

    offset: float = parameter("c", unit="", lower=-0.02, upper=0.02, off=0.0)

    def curve(self, value: Real, reading: Reading) -> Real:
        if not self.offset or reading.quantity not in ("R", "T"):
            return value
        return value + self.offset
'''

STAGES = {
    "stack": STACK, "film": FILM, "surface": SURFACE, "volume": VOLUME, "emission": EMISSION, "geometry": GEOMETRY,
    "module": MODULE, "detector": DETECTOR, "curve": CURVE,
}  # fmt: skip
"""By stage; `film` is of the stage `stack`, `curve` of the stage `detector`, both of films that are measured."""


def source_of(name: str, stage: str) -> str:
    """The file of a new effect of that name: a working example of the stage, to be changed."""
    words = name.split("_")
    text = STAGES[stage].replace("{title}", " ".join(words).capitalize())
    return text.replace("{Name}", "".join(word.capitalize() for word in words)).replace("{name}", name)
