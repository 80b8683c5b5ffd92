"""What can be hidden: each image effect of the catalogue, in another functional form, and what is outside it.

An amount runs from `off`, where nothing is hidden, to `most`. Ranges without a source are engineering judgement.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType

from validation.blind.words import Hidden, Kind, Place, within


def _known(name: str, place: Place, right: str, unit: str, off: float, most: float, says: str) -> Kind:
    return Kind(name, place, (right,), unit, off, most, False, says)


def _discrete(name: str, place: Place, right: str, says: str) -> Kind:
    return Kind(name, place, (right,), "", 0.0, 1.0, True, says)


def _outside(name: str, place: Place, unit: str, most: float, says: str) -> Kind:
    return Kind(name, place, (), unit, 0.0, most, False, says)


_STACK = (
    _known("lossy_layers", "module", "dbr_absorption", "", 0.0, 0.01,
           "AlN absorbs, k rising from layer to layer to twice its mean: defects pile up during growth."),
    _discrete("oscillator_dispersion", "module", "dbr_dispersion",
              "Indices of the layers follow one oscillator each (Wemple, DiDomenico, Phys. Rev. B 3, 1338, 1971)."),
    _known("porous_aln", "module", "dbr_index_error", "", 0.0, -0.1,
           "AlN is less dense: its index falls by Lorentz and Lorenz's law (sputtered AlN: 2.09 at 450 nm)."),
    _discrete("swapped_layers", "module", "dbr_layer_order",
              "The stack was grown the other way round: its first layer is of the other material."),
    _known("interdiffused_layers", "module", "dbr_roughness", "nm", 0.0, 8.0,
           "Layers mix at their faces: an error-function profile of this sd (J. Appl. Phys. 113, 183106, 2013)."),
    _known("growth_drift", "module", "dbr_thickness_error", "", 0.0, 0.05,
           "Layers grow ever too thick: by this share on the mean, by nothing at first and twice that at last."),
    _known("growth_wedge", "module", "dbr_thickness_gradient", "1/mm", 0.0, 0.05,
           "Layers are thicker on one side, by a profile that levels off, tanh(x / 1.5 mm): a wafer's growth."),
)  # fmt: skip
_CHIP = (
    Kind("thick_active_layer", "module", ("active_layer_thickness", "active_layer_depth"), "", 0.0, 0.35, False,
         "The emitting layer reaches down from its height by twice this share of T: a thick well region."),
    _known("binning", "module", "chip_power_spread", "", 0.0, 0.1,
           "Powers of chips are log-normal with this spread, each sample's its own: bins of micro-LEDs."),
    _known("current_tail", "module", "current_crowding", "", 0.0, 0.6,
           "Emission falls like exp(-a x / W) from a contact (Guo, Schubert, J. Appl. Phys. 90, 4191, 2001)."),
    _known("weak_chip", "module", "dead_chip", "", 0.0, 1.0,
           "One chip of each array, drawn, has lost this share of its power: failures after mass transfer."),
    _known("standing_dipoles", "module", "dipole_orientation", "", 0.0, 0.5,
           "Intensity inside the chip x exp(a sin^2 theta), normalised: a smooth preference of the dipoles."),
    _known("round_pad", "module", "electrode_shadow", "", 0.0, 0.3,
           "A quarter disc of this share of the chip's area is dark at a drawn corner: a round bond pad."),
    _known("etched_stripes", "module", "side_wall_roughness", "", 0.0, 0.5,
           "Side faces have upright ripples of this rms slope (Laplace's law): stripes of a dry etch."),
    _known("graded_loss", "module", "chip_absorption", "1/cm", 0.0, 300.0,
           "The chip absorbs more: this much on average, with the square of the height; p-GaN lies at its top."),
)  # fmt: skip
_MODULE = (
    _known("slant_response", "module", "receiver_btdf", "", 0.0, 0.4,
           "The receiver records light times cos^2a of its angle of incidence: it loses more of what comes aslant."),
    _known("glossy_receiver", "module", "receiver_specular", "", 0.0, 0.1,
           "The receiver's face reflects this share at normal incidence, more aslant by Schlick's formula (1994)."),
    _known("second_lobe", "module", "substrate_lobe", "", 0.0, 1.0,
           "This share of what the substrate sends back goes into a lobe of 30 deg: a coarse and a fine structure."),
    _known("plate_diffusion", "optics", "receiver_volume_scatter", "", 0.0, 0.5,
           "This share of the light spreads in the plate, exp(-r / l), l 0.12 mm (Opt. Express 24, 11727, 2016)."),
    _known("substrate_diffusion", "module", "substrate_leak", "", 0.0, 0.1,
           "This share of the light on the substrate comes out displaced by K0(r / L), L 0.25 mm: diffusion."),
    _known("shaken_chips", "module", "chip_position_errors", "um", 0.0, 10.0,
           "Chips stand aside by this rms along an axis, uniform in a square: pick and place."),
    _known("wrong_spacer", "module", "distance_error", "um", 0.0, 15.0,
           "The receiver stands farther by this: a spacer's tolerance."),
    _known("diffuse_frame", "module", "edge_walls", "", 0.0, 0.9,
           "Lambertian walls of this reflectance stand at the module's edge: a white frame."),
    _known("wedged_spacer", "module", "receiver_tilt", "1/mm", 0.0, 0.05,
           "D rises over the module, relative to D, in a drawn direction, about the module's centre."),
    _known("stray_daylight", "camera", "ambient_gradient", "", 0.0, 0.05,
           "Other light rises like a sine over the image, in a drawn direction, by this share of full scale."),
    _known("defocus", "optics", "camera_psf", "um", 0.0, 50.0,
           "Each point is a disc of this standard deviation along an axis: geometrical defocus."),
    _known("field_curvature", "optics", "off_axis_blur", "um", 0.0, 80.0,
           "Points are discs whose sd rises like 0.7 r^2 + 0.3 r^4 to this at the corner: a bent focal surface."),
    _known("astigmatism", "optics", "off_axis_blur", "um", 0.0, 80.0,
           "Points are even lines along the radius whose sd rises like r^2 to this at the corner: sagittal focus."),
    _known("tilted_lens", "optics", "focus_tilt", "um", 0.0, 80.0,
           "Points are discs whose sd rises from a line through the centre to this at the edge: drawn direction."),
    _known("division_distortion", "optics", "distortion", "", 0.0, 0.02,
           "What is seen at r lies at r / (1 + k r^2), r = 1 at the image's corner (Fitzgibbon, CVPR 2001)."),
    _known("wrong_scale", "optics", "magnification", "", 0.0, 0.01,
           "The image is larger by this share: scale of a calibrated camera."),
    _known("bending_sensor", "camera", "nonlinearity", "", 0.0, 0.05,
           "Signals follow a power law, ymax (y / ymax)^(1 + a): a bent characteristic (EMVA 1288)."),
    _known("full_wells", "camera", "saturation", "", 0.0, 5.0,
           "Signals y fall behind as y (1 + a (y / ymax)^24)^(-1/24): wells fill up just below full scale."),
    _known("lens_flare", "optics", "veiling_glare", "", 0.0, 0.1,
           "This share of all light is spread like (1 + r^2 / l^2)^(-3/2), l 0.9 mm: scatter in a lens (ISO 9358)."),
    _known("clipped_pupil", "optics", "vignetting", "", 0.0, 0.3,
           "Light x (1 - a (0.6 r^2 + 0.4 r^4)), r = 1 at the image's corner: a pupil that is clipped aslant."),
)  # fmt: skip
_OUTSIDE_OPTICS = (
    _outside("ghost_image", "optics", "", 0.1,
             "A share of the image appears again, upside down, 0.8 as large and blurred: two lens faces reflect."),
    _outside("lateral_colour", "optics", "", 0.06,
             "The scale spreads over the line by this share either way: lateral colour smears along the radius."),
    _outside("coma", "optics", "um", 120.0,
             "Points have a tail along x, this long at the upper edge, the other way at the lower: coma."),
    _outside("dust", "optics", "", 0.3,
             "Soft round shadows of 20 to 70 um, this deep, at drawn places on the cover glass."),
    _outside("hair", "optics", "", 0.3,
             "A soft dark line, this deep and 25 um wide, crosses the image in a drawn direction."),
    _outside("cover_fringes", "optics", "", 0.05,
             "Bent fringes of this amplitude, 90 to 60 um apart: interference in a cover glass."),
    _outside("shading_slope", "optics", "", 0.2,
             "Sensitivity rises over the image along a drawn direction by this share: an off-axis lens."),
)  # fmt: skip
_OUTSIDE_MODULE = (
    _outside("bowed_receiver", "module", "", 0.08,
             "D (1 + a r^2 / h^2), h 0.5 mm: the plate is bent (up to h, from there on it rises no more)."),
    _outside("saddle_substrate", "module", "", 0.06,
             "D (1 + a (x^2 - y^2) / h^2) likewise: a warped board lifts and lowers the receiver's height over it."),
    _outside("dark_joints", "module", "um", 60.0,
             "Black lines of this width lie on the substrate half-way between chips, 0.4 mm apart: joints of tiles."),
    _outside("textured_plate", "module", "", 0.05,
             "The plate passes on 1 + a cos cos of a square texture, 88 um and 7 deg: embossed prisms."),
    _outside("stained_plate", "module", "", 0.05,
             "The plate passes on 1 + a smooth random numbers of length 0.12 mm: stains."),
    _outside("one_sided_bezel", "module", "", 0.95,
             "A pane stands at x = 0.6 mm on one side only and reflects this share: a bezel that came loose."),
    _outside("tilted_chips", "module", "deg", 4.0,
             "All chips lean over by this angle along x: uneven solder (light leaves them in turned directions)."),
    _outside("turned_chips", "module", "deg", 45.0,
             "All chips are turned in their plane: a turned stamp of mass transfer."),
    _outside("glowing_rim", "module", "", 0.15,
             "A share of a chip's light comes out by Lambert's law from a ring of 30 to 70 um about it: phosphor."),
    _outside("metal_side", "module", "", 1.0,
             "This share of the side face at +x is a mirror of reflectance 0.85: solder that crept up."),
    _outside("chip_sizes", "module", "", 0.3,
             "Chips are narrower, right or wider by this share, drawn, at the same power: dicing."),
    _outside("resin_fillet", "module", "", 0.5,
             "The side faces meet resin, n = 1 + a, up to the chip's top, which light leaves as through clear air."),
    _outside("flux_ring", "module", "", 0.8,
             "The substrate is darker by this share in rings 30 to 90 um about the chips: residual flux."),
    _outside("substrate_slope", "module", "1/mm", 0.3,
             "The substrate's reflectance falls along x, R (1 - a (x + h)) from -h to h, h 0.5 mm: uneven paint."),
    _outside("substrate_rim", "module", "", 0.4,
             "The substrate's reflectance falls like r^2 by this share at 0.5 mm, no more from there on: ageing."),
)  # fmt: skip
_OUTSIDE_CAMERA = (
    _outside("row_banding", "camera", "DN", 20.0,
             "Each row has an offset of its own, new in each image, of this rms: noise of the reset (EMVA 1288)."),
    _outside("column_gains", "camera", "", 0.02,
             "Each column has a gain of its own, the same in all images, of this rms: column amplifiers."),
    _outside("hot_columns", "camera", "DN", 150.0,
             "Six drawn columns are too high by this in all images."),
    _outside("smear", "camera", "", 0.02,
             "This share of the mean of a column is added to all its pixels: shift through an open shutter."),
    _outside("one_way_crosstalk", "camera", "", 0.2,
             "This share of a signal goes to the pixels on its right, falling by halves: incomplete transfer."),
    _outside("flicker", "camera", "", 0.05,
             "Gain x (1 + a sin) along the rows, 42 rows long, its phase drawn for each image: a rolling shutter."),
    _outside("black_sag", "camera", "", 0.05,
             "The black level of a row sinks by this share of the row's mean: a clamp that is drawn along."),
    _outside("tap_gain", "camera", "", 0.03,
             "The right half of the image has another gain by this share: two taps read the sensor."),
    _outside("interlace", "camera", "px", 1.0,
             "Odd rows are shifted by this against the even ones: two fields read in turn."),
    _outside("adc_ripple", "camera", "DN", 25.0,
             "Signals ripple by this, four times over the full scale: integral non-linearity of a converter."),
)  # fmt: skip

KINDS: Mapping[str, Kind] = MappingProxyType(
    {kind.name: kind for kind in (*_STACK, *_CHIP, *_MODULE, *_OUTSIDE_OPTICS, *_OUTSIDE_MODULE, *_OUTSIDE_CAMERA)}
)
"""By name."""


def acting(hidden: Sequence[Hidden]) -> dict[str, Hidden]:
    """What is hidden and not off, by kind; ValueError for what is unknown, named twice or out of range."""
    found: dict[str, Hidden] = {}
    for one in hidden:
        kind = KINDS.get(one.kind)
        if kind is None:
            raise ValueError(f"hidden.kind = {one.kind!r}: one of {', '.join(KINDS)} is needed")
        within(f"hidden.amount of {one.kind}", one.amount, min(kind.off, kind.most), max(kind.off, kind.most))
        if kind.discrete and one.amount not in (kind.off, kind.most):
            raise ValueError(f"hidden.amount of {one.kind} = {one.amount}: {kind.off:g} or {kind.most:g} is needed")
        within(f"hidden.seed of {one.kind}", one.seed, 0, 2**63 - 1)
        if one.kind in found:
            raise ValueError(f"hidden.kind = {one.kind!r}: once is enough")
        if one.amount != kind.off:
            found[one.kind] = one
    return found
