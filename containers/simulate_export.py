"""The files that `luxloop simulate` writes: arrays, the module's far field, the light that leaves a chip."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from containers.ray_tracing.exports import RaySet, photometric_web, tm25
from containers.ray_tracing.exports import ies as ies_text
from containers.ray_tracing.far_field import FarField, luminous_flux_lm
from luxloop.bus.frame import Array
from luxloop.files import whole
from luxloop.ray import RayRequest

Document = dict[str, Any]


def write_npz(document: Document, arrays: Mapping[str, Array], request: RayRequest, file: Path) -> None:
    """All arrays by name, compressed, with the document and the request as JSON text beside them."""
    texts = {"document_json": json.dumps(document), "request_json": request.model_dump_json()}
    held: dict[str, Any] = {**arrays, **{name: np.array(text) for name, text in texts.items()}}
    with whole(file) as fresh, fresh.open("wb") as opened:  # numpy would put .npz at the end of another name
        np.savez_compressed(opened, **held)


def write_ies(document: Document, arrays: Mapping[str, Array], request: RayRequest, file: Path) -> None:
    """Luminous intensity of the light on its way to the receiver: of the finite module, or of a chip in the cell."""
    environment, far = request.environment, document["far_field"]
    field = FarField(arrays["far_module_per_sr"][None], far["module"]["lowest_cos"])
    flux_lm = luminous_flux_lm(environment.flux_per_chip_w, environment.peak_nm, environment.fwhm_nm)
    (x0, x1), (y0, y1) = document["map"]["x_um"], document["map"]["y_um"]
    web = photometric_web(field, flux_lm, (y1 - y0) * 1e-6, (x1 - x0) * 1e-6, eightfold=far["eightfold"])
    finite = document["array"] is not None
    remark = "finite module" if finite else "one chip of an endless array"
    model = document["model"]["name"].encode("ascii", "replace").decode()  # such files know no other letters
    keywords = {
        "LUMINAIRE": f"{request.design}",
        "OTHER": f"{remark}, light at its first arrival at the receiver, model {model}"[:120],
    }
    text = ies_text(replace(web, keywords=keywords), datetime.now(UTC).date())
    with whole(file) as fresh:
        fresh.write_text(text, encoding="ascii", newline="")


def write_rays(document: Document, arrays: Mapping[str, Array], request: RayRequest, file: Path) -> None:
    """The rays that leave a chip, origin below the chip's centre on the substrate, z towards the receiver."""
    direction = arrays["ray_direction"].astype(float)
    wavelength_nm = arrays["ray_wavelength_nm"].astype(float)
    rays = RaySet(
        position_mm=arrays["ray_position_um"].astype(float) * 1e-3,
        direction=direction / np.linalg.norm(direction, axis=1, keepdims=True),
        flux_w=arrays["ray_flux_ratio"].astype(float) * request.environment.flux_per_chip_w,
        wavelength_nm=wavelength_nm[0] if np.ptp(wavelength_nm) == 0.0 else wavelength_nm,
        descriptions={
            "light source": f"micro-LED chip, {request.design}",
            "ray file creator": "luxloop",
            "remarks": f"model {document['model']['name']}, seed {document['exit_seed']}",
            "geometry": "x, y from the chip's centre, z from the substrate towards the receiver",
        },
    )
    with whole(file) as fresh:
        fresh.write_bytes(tm25(rays, datetime.now(UTC)))


WRITERS: dict[str, Callable[[Document, Mapping[str, Array], RayRequest, Path], None]] = {
    "npz": write_npz,
    "ies": write_ies,
    "rays": write_rays,
}
