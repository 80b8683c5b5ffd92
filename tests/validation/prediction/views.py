"""Samples and coarse images of them, for predictions."""

from __future__ import annotations

from typing import Any

from validation.dataset.manifest import Sample
from validation.prediction import Pose, View

CHIP: dict[str, Any] = {"distance_um": 180.0, "width_um": 40.0, "spacing_um": 400.0, "thickness_um": 20.0}
SINGLE = Sample(id="one", layout="single", dbr_pairs=0.0, module_half_um=800.0, **CHIP)
FOUR = Sample(id="four", layout="array", rows=2, columns=2, dbr_pairs=2.5, **CHIP)
SUBSTRATE, RECEIVER = "environment.substrate.reflectance", "environment.receiver.reflectance"
SIGMA, LOSS = "environment.substrate.sigma_deg", "environment.chip_absorption_per_cm"
LAYER = "environment.active_layer_depth"


def view(sample: Sample = SINGLE, size: int = 12, pose: Pose | None = None) -> View:
    """A coarse image, the module's centre in its middle."""
    return View(sample, size, size, 50.0, ((size - 1) / 2, (size - 1) / 2), pose or Pose())
