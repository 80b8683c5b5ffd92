"""Groups of effects that six images at one distance hardly tell apart, as they are scored."""

from __future__ import annotations

GROUPS = {
    "lobe": (
        "dipole_orientation", "receiver_btdf", "chip_absorption", "distance_error", "receiver_volume_scatter",
        "camera_psf",
    ),
    "tail": ("veiling_glare", "substrate_lobe", "substrate_leak", "receiver_specular"),
    "mirror": ("dbr_roughness", "dbr_index_error", "dbr_absorption", "dbr_thickness_error", "side_wall_roughness"),
    "geometry": ("chip_position_errors", "magnification", "distortion"),
    "field": ("chip_power_spread", "vignetting"),
}  # fmt: skip
"""Fixed before any set was scored; an effect that is in none is a group of its own."""
_BY_NAME = {name: group for group, names in GROUPS.items() for name in names}


def group_of(effect: str) -> str:
    """The group of an effect: its own name where it is in none."""
    return _BY_NAME.get(effect, effect)
