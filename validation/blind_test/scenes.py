"""A truth before its camera: its light, how it is exposed, and what a hidden thing changes of it.

The light is traced in two halves (`strength`), at the same time. Amounts are looked for by a quarter of the
histories, 2 million at most, with the same random numbers with and without the hidden thing; the data are traced with
all of them.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from threading import Thread
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from luxloop import __version__
from luxloop.errors import InputError
from validation import blind
from validation.blind_test.strength import TOLERANCE, Halves, NoAmount, NotReached, Ruler, amount_for, sigma_of
from validation.blind_test.truths import Truth, camera_of, sample_of
from validation.dataset.folder import read_dataset, write_sums
from validation.dataset.images import write_tiff
from validation.dataset.manifest import ImageShot, Manifest
from validation.dataset.manifest_file import MANIFEST
from validation.dataset.manifest_file import to_toml as manifest_text
from validation.dataset.simulated_images import expected_images, views_of
from validation.dataset.simulation_plan import Plan
from validation.diagnose.score import Projected
from validation.effects.known import Known, for_chips
from validation.measured import MeasuredImage, measured_images
from validation.prediction import Predictor

Real = NDArray[np.float64]
Light = tuple[list[Real], list[Real]]
"""Of all samples, (row, column) in 1/mm^2, by two halves of the histories."""
Found = TypeVar("Found")

COARSER, MOST_COARSE = 4, 2_000_000
"""How many times fewer histories find an amount, and how many will do. Amounts of sets on record hang on both."""


@dataclass(eq=False)
class Lights:
    """The light of a truth by so many histories a sample: what only optics or camera do asks for no new rays."""

    truth: Truth
    samples: Sequence[blind.Sample]
    camera: blind.Camera
    histories: int

    @cached_property
    def plain(self) -> Light:
        """With nothing hidden."""
        return self.of(())

    def of(self, hidden: Sequence[blind.Hidden]) -> Light:
        """With these things hidden. Raises InputError for what the blind forward model cannot trace."""
        places = {blind.KINDS[one.kind].place for one in hidden}
        if places == {"camera"}:
            return self.plain
        try:
            if "module" in places:
                return of_both(lambda half: self._traced(hidden, half))
            return self._seen(hidden, 0), self._seen(hidden, 1)
        except ValueError as error:
            raise InputError("--plan", self.truth.model.name, "what the blind model traces", str(error)) from None

    def _traced(self, hidden: Sequence[blind.Hidden], half: int) -> list[Real]:
        return blind.light(
            self.truth.surroundings, self.samples, self.camera, self.truth.poses, hidden,
            seed=self.truth.seed + half, histories=self._of_half,
        )  # fmt: skip

    def _seen(self, hidden: Sequence[blind.Hidden], half: int) -> list[Real]:
        """The plain module's maps through these optics."""
        from validation.blind.kinds import acting
        from validation.blind.module import PER_UM2
        from validation.blind.optics import image_of

        there = acting(hidden)
        return [
            image_of(light * PER_UM2, grid, sample.module_half_um, self.camera, pose, there)
            for sample, pose, (light, grid) in zip(self.samples, self.truth.poses, self._maps[half], strict=True)
        ]

    @cached_property
    def _maps(self) -> tuple[list[Any], list[Any]]:
        """The plain light on the receiver and its grid, of each sample, by halves."""
        from validation.blind.module import Tracer

        def traced(half: int) -> list[Any]:
            tracer = Tracer(self.truth.surroundings, self.samples, {}, self.truth.seed + half, self._of_half)
            return [tracer.light(sample) for sample in self.samples]

        return of_both(traced)

    @property
    def _of_half(self) -> int:
        return -(-self.histories // 2)


def of_both(traced: Callable[[int], Found]) -> tuple[Found, Found]:
    """Both halves, each on a core: kernels let go of the interpreter, and share nothing.

    What was begun ends with the process, so Ctrl-C does not wait for it: a half takes minutes.
    """
    first, second = Future[Found](), Future[Found]()

    def trace(half: int, found: Future[Found]) -> None:
        try:
            found.set_result(traced(half))
        except BaseException as error:  # noqa: BLE001  # raised where the light is waited for, else for ever
            found.set_exception(error)

    threads = [Thread(target=trace, args=one, daemon=True) for one in enumerate((first, second))]
    for thread in threads:
        thread.start()
    for thread in threads:
        while thread.is_alive():  # a wait without an end would miss a signal that comes just before it
            thread.join(1.0)
    return first.result(), second.result()


@dataclass(frozen=True, eq=False)
class Scene:
    """A truth before its camera."""

    truth: Truth
    plan: Plan
    pixels: int
    histories: int
    asked_sigma: float
    predictor: Predictor
    known: Known

    @cached_property
    def camera(self) -> blind.Camera:
        """The declared one."""
        return camera_of(self.plan.camera, self.pixels)

    @cached_property
    def lights(self) -> Lights:
        """As the data have it."""
        return self._lights(self.histories)

    @cached_property
    def coarse(self) -> Lights:
        """To look for amounts by."""
        return self._lights(min(-(-self.histories // COARSER), MOST_COARSE))

    def _lights(self, histories: int) -> Lights:
        return Lights(self.truth, [sample_of(one) for one in self.plan.samples], self.camera, histories)

    @cached_property
    def exposure(self) -> tuple[list[float], float]:
        """Exposures in ms and DN per ms at 1/mm^2, by which the plain images peak at a share of full scale."""
        views = views_of(self.plan, 0, self.pixels, self.pixels)
        expected = expected_images(views, mean_of(self.lights.plain), self.plan.camera)
        lit = expected[0]
        dn_per_ms = float(lit.signal_dn.max() / lit.irradiance_per_mm2.max()) / lit.exposure_ms
        return [one.exposure_ms for one in expected], dn_per_ms

    def signals(self, light: Sequence[Real], hidden: Sequence[blind.Hidden] = ()) -> list[Real]:
        """Expected signals (row, column) in DN above black."""
        exposures, dn_per_ms = self.exposure
        return blind.signals(light, exposures, dn_per_ms, self.camera, hidden)

    @cached_property
    def ruler(self) -> Ruler:
        """A perfect fit of the plain images."""
        with tempfile.TemporaryDirectory() as folder:
            raw = [image + self.camera.black_level_dn for image in self.signals(mean_of(self.lights.plain))]
            write_images(Path(folder), self.plan, "plain", raw, self.exposure[0], np.float32)
            images: list[MeasuredImage] = measured_images(read_dataset(Path(folder)))
        return Ruler.at(self.truth, images, self.predictor)

    @cached_property
    def rivals(self) -> Projected:
        """The columns of all effects that these samples can have."""
        chips = max(one.rows * one.columns for one in self.plan.samples)
        specs = [for_chips(one, chips) for one in self.known.specs if "modules" in one.acts_on]
        return self.ruler.rivals(self.predictor, self.known, specs)

    def change(self, lights: Lights, light: Light, hidden: Sequence[blind.Hidden]) -> Halves:
        """What these hidden things change, by each half of the light."""
        first, second = (
            self.ruler.left(
                [a - b for a, b in zip(self.signals(there, hidden), self.signals(here), strict=True)]
            )
            for there, here in zip(light, lights.plain, strict=True)
        )  # fmt: skip
        return first, second

    def hide(self, name: str, seed: int) -> tuple[blind.Hidden, Light, Halves]:
        """A thing of a kind at the asked strength, its light, what it changes. Raises NotReached, NoAmount."""
        kind, asked = blind.KINDS[name], self.asked_sigma
        lights = self.lights if kind.place != "module" else self.coarse

        def measure(amount: float) -> float:
            return sigma_of(self._with(lights, blind.Hidden(name, amount, seed))[1])

        amount = amount_for(kind, asked, measure)
        for _ in range(2):
            hidden = blind.Hidden(name, amount, seed)
            light, halves = self._with(self.lights, hidden)
            sigma = sigma_of(halves)
            if kind.discrete or abs(sigma / asked - 1.0) <= TOLERANCE:
                return hidden, light, halves
            ratio, most = asked / max(sigma, 0.1 * asked), (kind.most - kind.off) / (amount - kind.off)
            # so few histories were not enough
            amount = kind.off + ratio * (amount - kind.off) if ratio < most else kind.most
        if hidden.amount == kind.most and sigma < asked:
            raise NotReached(name, sigma)
        raise NoAmount(name)

    def _with(self, lights: Lights, hidden: blind.Hidden) -> tuple[Light, Halves]:
        light = lights.of([hidden])
        return light, self.change(lights, light, [hidden])


def mean_of(light: Light) -> list[Real]:
    """Of both halves."""
    return [(one + other) / 2.0 for one, other in zip(*light, strict=True)]


def write_images(
    folder: Path, plan: Plan, name: str, raw: Sequence[NDArray[Any]], exposures_ms: Sequence[float], kind: type
) -> None:
    """An ordinary data set: an image of each sample, manifest, hashes."""
    shots = []
    for sample, image, exposure in zip(plan.samples, raw, exposures_ms, strict=True):
        file = f"images/{sample.id}.tif"
        write_tiff(folder / file, image.astype(kind))
        shots.append(ImageShot(id=sample.id, kind="image", sample=sample.id, file=file, exposure_ms=exposure))
    manifest = Manifest(
        name=f"blind {name}", licence=plan.licence, camera=plan.camera, samples=plan.samples, shots=tuple(shots),
        notes=f"Made by luxloop {__version__} blind make. Something may be hidden in it.",
    )  # fmt: skip
    (folder / MANIFEST).write_text(manifest_text(manifest), encoding="utf-8")
    write_sums(folder)
