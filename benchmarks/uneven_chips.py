"""Predictions of chips that shine unevenly, whose exits are those of an even chip, against Monte Carlo of them.

    python -m benchmarks.uneven_chips [--about 8000000] [--histories 32000000]

Monte Carlo walks every history from where it is born, so it shares neither weights nor symmetries with the
prediction. Told is what it says of the change from even chips, as a share of the predicted one, by the inverse
variance of both, and how far the two are apart in errors; and what Monte Carlo itself errs by, which loses the
symmetries of the square.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from containers.ray_tracing.exit_source import ExitSource
from containers.ray_tracing.worker import RayComputation
from luxloop.computation import Progress
from luxloop.ray import PredictionRequest, RayRequest
from luxloop.words import parse

Arrays = Mapping[str, NDArray[Any]]

DESIGN = {"distance_um": 180.0, "width_um": 28.0, "spacing_um": 500.0, "thickness_um": 35.0, "dbr_pairs": 0.0}
CAMERA = {"rows": 24, "columns": 24, "pixel_um": 24.0}
MODULES: Mapping[str, Mapping[str, Any]] = {
    "one chip": {"rows": 1, "columns": 1, "half_um": 500.0}, "3 x 3": {"rows": 3, "columns": 3},
}  # fmt: skip
EFFECTS: Mapping[str, Sequence[Mapping[str, Any]]] = {
    "even": (),
    "dark corner 0.2": ({"name": "electrode_shadow", "parameters": {"dark_share": 0.2, "corner": "left_low"}},),
    "rise 0.5, rim 0.2": ({"name": "current_crowding", "parameters": {"rise": 0.5, "rim": 0.2}},),
}


def module(array: Mapping[str, Any], effects: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """A module without films, whose chips absorb, so that walks are short."""
    environment = {"chip_absorption_per_cm": 200.0}
    return {"environment": environment, "design": DESIGN, "array": array, "effects": effects}


def asked(of: RayComputation, kind: type[PredictionRequest] | type[RayRequest], wanted: Mapping[str, Any]) -> Arrays:
    """The arrays of an answer."""
    return dict(of.compute(json.loads(parse(kind, wanted).model_dump_json()), Progress())[1])


def main(argv: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--about", type=int, default=8_000_000, help="histories of the predictions' anchors")
    parser.add_argument("--histories", type=int, default=32_000_000, help="of Monte Carlo")
    options = parser.parse_args(argv)

    def no_film(sha256: str, size: int) -> bytes:
        raise AssertionError((sha256, size))

    of = RayComputation(no_film, ExitSource())
    even: dict[str, NDArray[Any]] = {}
    print(f"{'chips':18}  {'module':8}  change, rms  Monte Carlo says  z, rms  error told  of Monte Carlo")
    for name, effects in EFFECTS.items():
        shots = [module(array, effects) | {"camera": CAMERA} for array in MODULES.values()]
        anchor = {"histories": options.about, "seed": "3"}
        found = asked(of, PredictionRequest, {"shots": shots, "anchor": anchor, "exit_seed": "2"})
        for number, (label, array) in enumerate(MODULES.items()):
            image, noise = found["images_per_mm2"][number], found["noise_per_mm2"][:, number].astype(float)
            wanted = {"histories": options.histories, "seed": "99", "exit_seed": "7", "images": [CAMERA]}
            seen = asked(of, RayRequest, module(array, effects) | wanted)
            error = np.sqrt((noise**2).sum(axis=0))
            weight = 1.0 / (error**2 + seen["image_error_0"] ** 2)
            change = image - even.setdefault(label, image)
            told = np.sum(change**2 * weight)
            says = ""
            if told:
                share = np.sum(change * (seen["image_0"] - even[label]) * weight) / told
                says = f"{share:.3f} +- {1.0 / np.sqrt(told):.3f}"
            z = np.sqrt(np.mean((image - seen["image_0"]) ** 2 * weight))
            rms = [100.0 * np.sqrt(np.mean(one**2)) / image.mean() for one in (change, error, seen["image_error_0"])]
            print(f"{name:18}  {label:8}  {rms[0]:9.2f} %  {says:16}  {z:6.2f}  {rms[1]:8.2f} %  {rms[2]:12.2f} %")


if __name__ == "__main__":
    main()
