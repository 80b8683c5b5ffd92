"""How much of an effect's column is the noise of its walk: what two walks agree about of it.

    python -m benchmarks.column_noise [EFFECT ...]

On the six example images of `luxloop effects confusion`, beside what a fit takes anyway (gains, offsets, places, the
free parameters of model `paper`): the cosine between the columns of two walks is the share of the chi2 that a score
by one of them finds. Before: 131,072 exits, and of what acts by chance a tenth of the range as a step; now: as a
diagnosis has them (decision 70). Of a leak that was drawn ray by ray (before decision 71) it tells nothing.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace

import numpy as np

from benchmarks.processes import table
from luxloop.client import Client
from luxloop.effect import EffectSpec
from luxloop.model import Model
from luxloop.model_file import find_model
from luxloop.settings import load_settings
from validation.effects.confusing import Ground, image_ground
from validation.effects.known import Known
from validation.effects.signatures import RUNS, projected, signature
from validation.prediction import Predictor, images

EFFECTS = (
    "substrate_leak", "distance_error", "chip_absorption", "substrate_lobe", "receiver_btdf", "receiver_specular",
    "receiver_volume_scatter", "dipole_orientation", "dbr_index_error",
)  # fmt: skip
HEADS = ("before", "now", "s for two, before", "now")
BEFORE_EXITS, BEFORE_STEP = 131_072, 0.2
"""The step as a share of today's: of effects that act by chance, half the range."""
PATIENCE_S = 600.0


def agreement(ground: Ground, model: Model, spec: EffectSpec, scale: float) -> float:
    """The cosine between an effect's columns by two walks, whitened, less what a fit takes."""
    first, second = (
        projected(
            signature(replace(ground.sight, run=run, _known={}), model, spec, scale=scale)[:1], ground.projection
        )[0]
        for run in range(RUNS)
    )
    return float(first @ second / np.linalg.norm(first) / np.linalg.norm(second))


def main() -> None:
    """Ask, print."""
    asked = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    asked.add_argument("effects", nargs="*", default=EFFECTS, help="names; default: those it is worth looking at")
    names, model, rows = asked.parse_args().effects, find_model("paper"), []
    with Client(load_settings(), patience_s=PATIENCE_S) as client:
        known, predictor = Known.ask(client), Predictor(client)
        ground, exits = image_ground(model, predictor, known), images.COLUMN_EXITS
        for name in names:
            spec, told, taken = known.spec(name), [], []
            for count, scale in ((BEFORE_EXITS, BEFORE_STEP if spec.by_chance else 1.0), (exits, 1.0)):
                images.COLUMN_EXITS, begin_s = count, time.perf_counter()
                told.append(f"{agreement(ground, model, spec, scale):.2f}")
                taken.append(f"{time.perf_counter() - begin_s:.1f}")
            rows.append((name, *told, *taken))
    table("what two walks agree about of a column, beside what a fit takes", rows, ("effect", *HEADS))


if __name__ == "__main__":
    main()
