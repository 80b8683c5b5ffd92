"""From a sample in its surroundings, and what is hidden, to what the kernels know: chips and their ground."""

from __future__ import annotations

import math
import zlib
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from validation.blind.chip import Body
from validation.blind.ground import Ground
from validation.blind.stack import film_of
from validation.blind.words import Hidden, Real, Sample, Surroundings

There = Mapping[str, Hidden]

PER_UM = 1e-4
"""Of 1/cm."""
SECOND_LOBE_DEG = 30.0
DIFFUSION_UM = 250.0
PANE_UM = 600.0
ENDLESS = 1e12
FILMS = frozenset(
    ("lossy_layers", "oscillator_dispersion", "porous_aln", "swapped_layers", "interdiffused_layers", "growth_drift",
     "growth_wedge")
)  # fmt: skip
LEFT_AND_RIGHT = frozenset(("current_tail", "tilted_chips", "metal_side"))
LOPSIDED_CHIPS = LEFT_AND_RIGHT | {"round_pad"}
"""Their light lacks the symmetries of the square; that of the first is still its own mirror image in y."""
LOPSIDED_GROUND = frozenset(
    ("turned_chips", "wedged_spacer", "saddle_substrate", "one_sided_bezel", "substrate_slope")
)
OF_SEVERAL = frozenset(("binning", "weak_chip", "shaken_chips", "chip_sizes", "growth_wedge"))
"""A single chip has none of these."""
UNEVEN_GROUND = frozenset(
    ("wedged_spacer", "bowed_receiver", "saddle_substrate", "dark_joints", "flux_ring", "substrate_slope",
     "substrate_rim", "diffuse_frame", "one_sided_bezel")
)  # fmt: skip
"""What a lone chip on an endless even substrate does not have."""


@dataclass(frozen=True, eq=False)
class Layout:
    """The chips of a sample."""

    centres_um: Real
    """(chip, 2), x and y, row by row from the lowest y."""
    power: Real
    """(chip,)"""
    halves_um: Real
    """(chip,), half the side of each."""


def layout_of(sample: Sample, there: There) -> Layout:
    """Places, powers and sizes of a sample's chips; what is drawn is each sample's own."""
    x = (np.arange(sample.columns) - (sample.columns - 1) / 2.0) * sample.spacing_um
    y = (np.arange(sample.rows) - (sample.rows - 1) / 2.0) * sample.spacing_um
    centres = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    power, halves = np.ones(sample.chips), np.full(sample.chips, sample.width_um / 2.0)
    if sample.chips == 1:
        return Layout(centres, power, halves)
    if "shaken_chips" in there:
        reach = math.sqrt(3.0) * there["shaken_chips"].amount
        centres = centres + _drawn(there["shaken_chips"], sample).uniform(-reach, reach, centres.shape)
    if "binning" in there:
        power = np.exp(there["binning"].amount * _drawn(there["binning"], sample).standard_normal(sample.chips))
    if "weak_chip" in there:
        power[_drawn(there["weak_chip"], sample).integers(sample.chips)] *= 1.0 - there["weak_chip"].amount
    if "chip_sizes" in there:
        steps = _drawn(there["chip_sizes"], sample).integers(-1, 2, sample.chips)
        halves = halves * (1.0 + there["chip_sizes"].amount * steps)
    return Layout(centres, power, halves)


def _drawn(hidden: Hidden, sample: Sample) -> np.random.Generator:
    return np.random.default_rng((hidden.seed, 17, zlib.crc32(sample.id.encode())))


def _amount(there: There, kind: str) -> float:
    """Of a kind whose off value is 0."""
    return there[kind].amount if kind in there else 0.0


def body_of(surroundings: Surroundings, sample: Sample, there: There, x_um: float = 0.0) -> Body:
    """A chip of a sample whose centre is at x, which matters where films differ."""
    film = film_of(surroundings, sample.dbr_pairs, there, x_um)
    low, high = _layer(surroundings.active_layer_depth, _amount(there, "thick_active_layer"))
    loss, rise = surroundings.chip_absorption_per_cm * PER_UM, 3.0 * _amount(there, "graded_loss") * PER_UM
    corner = (
        np.random.default_rng((there["round_pad"].seed, 19)).integers(0, 2, 2) if "round_pad" in there else (0, 0)
    )
    lean, ripple, dipoles = (
        math.radians(_amount(there, "tilted_chips")),
        _amount(there, "etched_stripes"),
        _amount(there, "standing_dipoles"),
    )
    mirrored = surroundings.chip_bottom == "mirror"
    return Body(
        thickness=sample.thickness_um, n=surroundings.n_gan, beside=1.0 + _amount(there, "resin_fillet"),
        loss=loss, rise=rise, mirrored=mirrored, reflectance=surroundings.substrate_reflectance,
        sigma=math.radians(surroundings.substrate_sigma_deg), second_share=_amount(there, "second_lobe"),
        second_sigma=math.radians(SECOND_LOBE_DEG), ripple=ripple, metal=_amount(there, "metal_side"),
        low=low * sample.thickness_um, high=high * sample.thickness_um,
        dipoles=dipoles, dipoles_mean=_dipoles_mean(dipoles), crowding=_amount(there, "current_tail"),
        pad=2.0 * math.sqrt(_amount(there, "round_pad") / math.pi),
        pad_x=2.0 * corner[0] - 1.0, pad_y=2.0 * corner[1] - 1.0,
        sphere=not mirrored or ripple > 0.0, lean_cos=math.cos(lean), lean_sin=math.sin(lean),
        rim=_amount(there, "glowing_rim"),
        inside=film.inside, passed=film.passed, beyond=film.beyond, outside=film.outside,
    )  # fmt: skip


def _layer(depth: float | None, share: float) -> tuple[float, float]:
    """The emitting layer as shares of T; a thick one reaches down by twice the share."""
    if depth is None:
        return 0.0, 1.0 - share
    return max(0.0, depth - 2.0 * share), depth


def _dipoles_mean(a: float) -> float:
    """The mean of exp(a sin^2 theta) over all directions."""
    node, weight = np.polynomial.legendre.leggauss(32)
    return float(np.sum(weight * np.exp(a * (1.0 - node**2))) / 2.0)


def ground_of(surroundings: Surroundings, sample: Sample, layout: Layout, there: There) -> Ground:
    """A module with all that is hidden in it."""
    direction = 0.0
    if "wedged_spacer" in there:
        direction = 2.0 * math.pi * _drawn(there["wedged_spacer"], sample).random()
    turn = math.radians(_amount(there, "turned_chips"))
    return Ground(
        distance=sample.distance_um + _amount(there, "wrong_spacer"),
        tilt_x=1e-3 * _amount(there, "wedged_spacer") * math.cos(direction),
        tilt_y=1e-3 * _amount(there, "wedged_spacer") * math.sin(direction),
        bow=_amount(there, "bowed_receiver"), saddle=_amount(there, "saddle_substrate"),
        reflectance=surroundings.substrate_reflectance, sigma=math.radians(surroundings.substrate_sigma_deg),
        second_share=_amount(there, "second_lobe"), second_sigma=math.radians(SECOND_LOBE_DEG),
        joints=_amount(there, "dark_joints"), ring=_amount(there, "flux_ring"),
        slope=_amount(there, "substrate_slope"),
        rim=_amount(there, "substrate_rim"), leak_share=_amount(there, "substrate_diffusion"), leak=DIFFUSION_UM,
        half=sample.module_half_um, frame=_amount(there, "diffuse_frame"),
        pane=_amount(there, "one_sided_bezel"), pane_x=PANE_UM,
        gloss=_amount(there, "glossy_receiver"), most_gloss=max(surroundings.receiver_reflectance, 1e-9),
        pitch=sample.spacing_um, turn_cos=math.cos(turn), turn_sin=math.sin(turn), rows=sample.rows,
        columns=sample.columns, centres=layout.centres_um, halves=layout.halves_um,
    )  # fmt: skip


def lone(ground: Ground, half_um: float) -> Ground:
    """The same with one chip at the origin, on an endless even substrate below an even receiver."""
    return _even(ground)._replace(rows=1, columns=1, centres=np.zeros((1, 2)), halves=np.array([half_um]))


def bare(ground: Ground) -> Ground:
    """The same without chips."""
    return _even(ground)._replace(rows=0, columns=0, centres=np.zeros((1, 2)), halves=np.zeros(1))


def _even(ground: Ground) -> Ground:
    return ground._replace(
        tilt_x=0.0, tilt_y=0.0, bow=0.0, saddle=0.0, joints=0.0, ring=0.0, slope=0.0, rim=0.0, frame=0.0, pane=0.0,
        half=ENDLESS,
    )  # fmt: skip
