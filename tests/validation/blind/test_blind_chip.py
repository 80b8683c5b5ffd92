"""A chip of the blind truth: what is born leaves or is absorbed, and identities of its laws."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from tests.validation.blind.truths import PAPER, SINGLE
from validation.blind import Hidden, Real, maps
from validation.blind.rays import cosine_law, decay, fresnel, lobe
from validation.blind.scenes import body_of, ground_of, layout_of, lone
from validation.blind.tracing import POINTS, lone_chip, scratch

WIDE_UM = 400.0
"""Of bins that reach 400 mm: nothing lands beyond."""


def landed(there: dict[str, Hidden], histories: int = 40_000, **changes: Any) -> Real:
    """A lone chip's first light (y, x), per flux, in wide bins."""
    around = replace(PAPER, **changes)
    layout = layout_of(SINGLE, there)
    ground = lone(ground_of(around, SINGLE, layout, there), SINGLE.width_um / 2.0)
    tally = np.zeros((1, 2048, 2048))
    steps, shift = maps.recurrence(POINTS, (5,))
    lone_chip(
        ground,
        body_of(around, SINGLE, there),
        0.0,
        np.uint64(5),
        0,
        histories,
        steps,
        shift,
        WIDE_UM,
        tally,
        scratch(),
    )
    return np.asarray(tally[0] / histories)


LOSSLESS = {"substrate_reflectance": 1.0, "chip_absorption_per_cm": 0.0}


def test_loss_that_rises_goes_with_the_square_of_the_height() -> None:
    """A path slantwise from 0.2 to 0.9 of the height, against a sum over 10,000 pieces of it."""
    body = body_of(PAPER, SINGLE, {"graded_loss": Hidden("graded_loss", 150.0)})
    heights = 0.2 + 0.7 * (np.arange(10_000) + 0.5) / 10_000
    per_um = 1e-4 * (PAPER.chip_absorption_per_cm + 3.0 * 150.0 * heights**2)
    expected = np.exp(-60.0 * per_um.mean())
    assert decay(body.loss, body.rise, 0.2, 0.9, 60.0) == pytest.approx(expected, rel=1e-7)
    assert decay(body.loss, body.rise, 0.9, 0.2, 60.0) == decay(body.loss, body.rise, 0.2, 0.9, 60.0)


def test_in_a_white_furnace_all_light_leaves() -> None:
    """Nothing absorbs and the substrate scatters: all that is born comes to the receiver."""
    found = landed({}, 15_000, chip_bottom="contact", active_layer_depth=None, **LOSSLESS)
    assert found.sum() == pytest.approx(1.0, abs=6e-3)


@pytest.mark.parametrize("bottom", ["contact", "mirror"])
def test_without_scatter_the_escape_cones_leave(bottom: str) -> None:
    """6 (1 - cos 23.71 deg) / 2 = 0.253 of isotropic light, whichever way light is born."""
    found = landed({}, chip_bottom=bottom, substrate_sigma_deg=0.0, active_layer_depth=None, **LOSSLESS)
    assert found.sum() == pytest.approx(0.2532, abs=2e-3)


@pytest.mark.parametrize(
    ("kind", "amount", "wanted"),
    [("glowing_rim", 0.15, 0.2532), ("tilted_chips", 4.0, 0.2532), ("turned_chips", 30.0, 0.2532),
     ("current_tail", 0.6, 0.2532), ("round_pad", 0.3, 0.2532), ("resin_fillet", 0.5, 0.4891)],
)  # fmt: skip
def test_hidden_chips_keep_the_light(kind: str, amount: float, wanted: float) -> None:
    """What moves or turns light loses none of it; beside resin the four cones of the sides are wider."""
    found = landed({kind: Hidden(kind, amount)}, substrate_sigma_deg=0.0, **LOSSLESS)
    assert found.sum() == pytest.approx(wanted, abs=3e-3)


def test_ripples_keep_the_light() -> None:
    """Rippled sides turn trapped light into the cones, and make none."""
    smooth, rippled = (landed(there, 20_000, **LOSSLESS | {"chip_absorption_per_cm": 20.0}).sum()
                       for there in ({}, {"etched_stripes": Hidden("etched_stripes", 0.3)}))  # fmt: skip
    assert smooth + 0.05 < rippled < 1.0


def test_a_lone_chips_light_is_as_bright_from_all_sides() -> None:
    """The eight symmetries of the square, to the noise; a mirror on one side breaks them."""
    plain = landed({})
    quarters = [plain[:, :1024].sum(), plain[:, 1024:].sum(), plain[:1024].sum(), plain[1024:].sum()]
    assert np.ptp(quarters) < 0.02 * np.mean(quarters)
    metal = landed({"metal_side": Hidden("metal_side", 1.0)})
    assert metal[:, 1024:].sum() < 0.9 * metal[:, :1024].sum()


def test_fresnels_powers() -> None:
    """Normal incidence, Brewster's angle (s alone), total reflection."""
    assert fresnel(1.0, 1.5)[0] == pytest.approx(0.04)
    brewster = np.arctan(1.5)
    assert fresnel(np.cos(brewster), 1.5)[0] == pytest.approx(0.5 * np.cos(2.0 * brewster) ** 2)
    assert fresnel(0.5, 1.0 / 1.5)[0] == 1.0


def test_the_lobe_is_the_specifications() -> None:
    """Rayleigh's law of the polar angle about the mirror direction; Lambert's mean direction is (0, 0, 2/3)."""
    at = (np.arange(2000) + 0.5) / 2000
    into = np.array([0.6, 0.0, 0.8])
    angle = [np.arccos(min(1.0, float(into @ lobe(0.05, *into, u, 0.3, np.uint64(1), 0)))) for u in at]
    assert np.mean(np.square(angle)) == pytest.approx(2.0 * 0.05**2, rel=1e-2)
    few = (np.arange(50) + 0.5) / 50
    mean = np.mean([cosine_law(u, v) for u in few for v in few], axis=0)
    np.testing.assert_allclose(mean, [0.0, 0.0, 2.0 / 3.0], atol=1e-3)
    down = [lobe(0.5, 0.999, 0.0, 0.0447, u, v, np.uint64(2), 0)[2] for u in at[::40] for v in at[::40]]
    assert min(down) > 0.0
