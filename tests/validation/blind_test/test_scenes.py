"""Scenes: light that is used again is the light that would be traced; a hidden thing has the strength asked for."""

from __future__ import annotations

import signal
import subprocess
import sys
from threading import Barrier
from typing import Any

import numpy as np
import pytest

from luxloop.errors import InputError
from luxloop.model_file import find_model
from tests.validation.blind_test.test_blind_command import HISTORIES, PIXELS, PLAN
from validation import blind
from validation.blind_test.scenes import Lights, Scene, of_both
from validation.blind_test.strength import NotReached, sigma_of
from validation.blind_test.truths import Truth, camera_of, sample_of, truth_of
from validation.dataset.simulation_plan import Plan, read_plan


@pytest.fixture(scope="module")
def plan(tmp_path_factory: pytest.TempPathFactory) -> Plan:
    """Two small images."""
    path = tmp_path_factory.mktemp("plan") / "plan.toml"
    path.write_text(PLAN)
    return read_plan(path)


@pytest.fixture(scope="module")
def truth() -> Truth:
    """One of two images."""
    return truth_of(0, find_model("paper"), 2, seed=8)


@pytest.fixture(scope="module")
def lights(plan: Plan, truth: Truth) -> Lights:
    """Of that truth."""
    samples = [sample_of(one) for one in plan.samples]
    return Lights(truth, samples, camera_of(plan.camera, PIXELS), HISTORIES)


@pytest.mark.parametrize("kinds", [(), ("defocus",), ("clipped_pupil", "smear"), ("ghost_image", "coma")])
def test_maps_that_are_used_again_give_the_same_light(lights: Lights, kinds: tuple[str, ...]) -> None:
    """Through whatever optics, bit for bit, in both halves, whose random numbers differ."""
    hidden = [blind.Hidden(name, blind.KINDS[name].most / 2.0, 5) for name in kinds]
    found = lights.of(hidden)
    truth = lights.truth
    for half, images in enumerate(found):
        traced = blind.light(
            truth.surroundings, lights.samples, lights.camera, truth.poses, hidden, seed=truth.seed + half,
            histories=HISTORIES // 2,
        )  # fmt: skip
        assert all(np.array_equal(one, other) for one, other in zip(images, traced, strict=True))
    assert not np.array_equal(found[0][0], found[1][0])


@pytest.mark.parametrize(("whole", "coarse"), [(400_000, 100_000), (8_000_000, 2_000_000), (32_000_000, 2_000_000)])
def test_amounts_are_found_by_as_many_histories_as_ever(plan: Plan, truth: Truth, whole: int, coarse: int) -> None:
    """Those of the fixed sets, of runs by 8 million and of runs since: with others their seeds give other images."""
    nobody: Any = None
    assert Scene(truth, plan, PIXELS, whole, 20.0, nobody, nobody).coarse.histories == coarse


INTERRUPTED = """
import os
from time import sleep
import signal
from validation.blind_test.scenes import of_both

def traced(half):
    os.write(1, b"begun\\n")  # whole: what both threads print may be mixed
    sleep(600.0)

signal.signal(signal.SIGINT, signal.default_int_handler)  # where tests run in the background it is ignored
of_both(traced)
"""


def test_halves_are_traced_at_the_same_time() -> None:
    """Each waits for the other; what one cannot do is said."""
    both = Barrier(2)

    def traced(half: int) -> int:
        both.wait(timeout=60.0)
        return half

    assert of_both(traced) == (0, 1)
    with pytest.raises(ZeroDivisionError):
        of_both(lambda half: 1 / (1 - half))


def test_ctrl_c_does_not_wait_for_a_half() -> None:
    """Which takes minutes; the process ends with both under way."""
    with subprocess.Popen(
        [sys.executable, "-c", INTERRUPTED], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as made:
        assert made.stdout is not None
        try:
            assert made.stdout.readline() == made.stdout.readline() == b"begun\n"
            made.send_signal(signal.SIGINT)
            _, said = made.communicate(timeout=60.0)
        finally:
            made.kill()
    assert said.endswith(b"KeyboardInterrupt\n")


def test_the_camera_changes_no_light(lights: Lights) -> None:
    """What only the sensor does asks for no rays at all."""
    assert lights.of([blind.Hidden("smear", 0.01)]) is lights.plain


def test_light_that_cannot_be_traced_is_an_input_error(plan: Plan, truth: Truth) -> None:
    """An image that reaches far beyond the module's map."""
    far = plan.camera.model_copy(update={"pixel_um": 900.0})
    samples = [sample_of(one) for one in plan.samples]
    with pytest.raises(InputError, match="--plan"):
        _ = Lights(truth, samples, camera_of(far, PIXELS), HISTORIES).plain


class Flat:
    """Measures the change of the first pixel of the first image."""

    def left(self, change_dn: Any) -> Any:
        """A tenth of it, once."""
        return np.array([change_dn[0].mean() / 10.0])


def test_a_hidden_thing_has_the_strength_asked_for(plan: Plan, truth: Truth, lights: Lights) -> None:
    """By a made-up measure: the mean of an image, which daylight raises and dust cannot raise as much."""
    nobody: Any = None
    scene = Scene(truth, plan, PIXELS, HISTORIES, 4.0, nobody, nobody)
    scene.__dict__["lights"], scene.__dict__["ruler"] = lights, Flat()
    hidden, light, halves = scene.hide("stray_daylight", 7)
    assert light is lights.plain
    assert sigma_of(halves) == pytest.approx(4.0, rel=0.03)
    kind = blind.KINDS["stray_daylight"]
    assert kind.off < hidden.amount < kind.most
    assert (hidden.kind, hidden.seed) == ("stray_daylight", 7)
    with pytest.raises(NotReached):
        scene.hide("row_banding", 7)
