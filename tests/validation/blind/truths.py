"""Small truths that the tests of the blind test's forward model look at."""

from __future__ import annotations

from dataclasses import replace

from validation.blind import Camera, Pose, Sample, Surroundings

PAPER = Surroundings(
    substrate_reflectance=0.97, substrate_sigma_deg=5.0, receiver_reflectance=0.35, chip_absorption_per_cm=200.0,
    active_layer_depth=0.99, chip_bottom="mirror", n_gan=2.4869, n_aln=2.1793, gan_nm=45.2, aln_nm=51.6,
    layer_order="gan_first", peak_nm=445.0, fwhm_nm=18.0,
)  # fmt: skip
CAMERA = Camera(
    rows=24, columns=24, pixel_um=40.0, bit_depth=12, gain_dn_per_e=0.38, read_noise_e=6.0, full_well_e=1e4,
    black_level_dn=64.0,
)  # fmt: skip
SINGLE = Sample("single", 1, 1, 180.0, 40.0, 400.0, 20.0, 2.5, 900.0)
ARRAY = replace(SINGLE, id="array", rows=3, columns=3, module_half_um=600.0)
STRAIGHT = [Pose(), Pose()]
