"""A camera whose lens has several blurs or vignettings: its own, as a request words it, and those that effects add.

    image, each pixel blurred by its own  * PSF * PSF' ...  x  law(r) law'(r) ...

Products do not depend on their order and are smooth where one of their factors vanishes; so are variances, that add.
"""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from luxloop.camera import Camera

Psf = Literal["gaussian", "moffat2.5", "moffat3.5", "moffat4.5"]
Law = Literal["quadratic", "cos4"]
Uneven = Literal["round", "radial", "tangential", "tilted"]
"""Blurs that change over the image like r^2, all ways, along the radius or across it; or all ways, like one axis."""
BlurUm = Annotated[float, Field(ge=0.0, le=200.0)]


class Lens(Camera):
    """A camera with more than its own blur and vignetting."""

    more_psf: tuple[tuple[Psf, float], ...] = Field((), description="Kinds and standard deviations in um.")
    more_vignetting: tuple[tuple[Law, float], ...] = Field((), description="Laws and losses at the corner.")
    uneven_psf: tuple[tuple[Uneven, BlurUm, float], ...] = Field(
        (), description="Laws, standard deviations in um at r = 1, and directions in deg from x towards y."
    )


def blurred(camera: Camera, psf: Psf, psf_um: float) -> Camera:
    """The camera with one more blur (luxloop.camera: `psf`, `psf_um`): two Gaussians are one of both variances."""
    if not camera.psf_um:
        return camera.model_copy(update={"psf": psf, "psf_um": psf_um})
    if camera.psf == psf == "gaussian":
        return camera.model_copy(update={"psf_um": float(np.hypot(camera.psf_um, psf_um))})
    lens = _lens(camera)
    return lens.model_copy(update={"more_psf": (*lens.more_psf, (psf, psf_um))})


def unevenly_blurred(camera: Camera, law: Uneven, sd_um: float, direction_deg: float = 0.0) -> Camera:
    """The camera with one more blur of this standard deviation on the receiver as far from the axis as the corner."""
    lens = _lens(camera)
    return lens.model_copy(update={"uneven_psf": (*lens.uneven_psf, (law, sd_um, direction_deg))})


def darkened(camera: Camera, law: Law, loss: float) -> Camera:
    """The camera with one more vignetting (luxloop.camera: `vignetting_law`, `vignetting`)."""
    if not camera.vignetting:
        return camera.model_copy(update={"vignetting": loss, "vignetting_law": law})
    lens = _lens(camera)
    return lens.model_copy(update={"more_vignetting": (*lens.more_vignetting, (law, loss))})


def blurs(camera: Camera) -> tuple[tuple[Psf, float], ...]:
    """Kind and standard deviation in um of each blur that has a width."""
    more = camera.more_psf if isinstance(camera, Lens) else ()
    return tuple(one for one in ((camera.psf, camera.psf_um), *more) if one[1])


def vignettings(camera: Camera) -> tuple[tuple[Law, float], ...]:
    """Law and loss at the corner of each vignetting; the camera's own first."""
    more = camera.more_vignetting if isinstance(camera, Lens) else ()
    return ((camera.vignetting_law, camera.vignetting), *more)


def uneven_blurs(camera: Camera) -> tuple[tuple[Uneven, float, float], ...]:
    """Law, standard deviation in um at the corner and direction in deg of each blur that changes over the image."""
    return camera.uneven_psf if isinstance(camera, Lens) else ()


def corner_px(camera: Camera) -> float:
    """Distance in px of the image's corner from its centre: r = 1."""
    return float(np.hypot(camera.rows, camera.columns)) / 2


def _lens(camera: Camera) -> Lens:
    return camera if isinstance(camera, Lens) else Lens(**camera.model_dump())
