"""The words for a camera that looks at the receiver: its pixel grid, and all that it does to the light before noise.

Every departure from a perfect camera is a field whose default is its off value. Axes: x to the right along columns,
y along rows, row 0 at the lowest y, pixel centres at whole numbers; points in pixels are (row, column).
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from luxloop.words import Words

Pixel = Annotated[float, Field(ge=-10_000.0, le=10_000.0)]
Count = Annotated[int, Field(ge=1, le=4096)]
Signal = Annotated[float, Field(ge=-1e6, le=1e6)]


class Camera(Words):
    """How the irradiance of the receiver becomes the expected digital numbers of an image."""

    rows: Count = Field(128, description="Pixels along y.")
    columns: Count = Field(128, description="Pixels along x.")
    pixel_um: float = Field(8.0, gt=0.0, le=1000.0, description="Side of a pixel as seen on the receiver.")
    centre_px: tuple[Pixel, Pixel] | None = Field(None, description="Module's centre; none: the image's centre.")
    shift_px: tuple[Pixel, Pixel] = Field((0.0, 0.0), description="Image moved by this many rows and columns.")
    rotation_deg: float = Field(0.0, ge=-45.0, le=45.0, description="Image turned about the module, x towards y.")
    magnification_error: float = Field(0.0, ge=-0.5, le=0.5, description="e: image (1 + e) times as large.")
    distortion: float = Field(0.0, ge=-0.05, le=0.05, description="k1: r to r + k1 r^3, r = 1 at the image's corner.")
    psf: Literal["gaussian", "moffat2.5", "moffat3.5", "moffat4.5"] = Field("gaussian", description="Kind of blur.")
    psf_um: float = Field(0.0, ge=0.0, le=200.0, description="Its standard deviation along an axis, on the receiver.")
    vignetting: float = Field(0.0, ge=0.0, le=0.9, description="v: share of the light lost at the image's corner.")
    vignetting_law: Literal["quadratic", "cos4"] = Field("quadratic", description="1 - v r^2, or cos^4 of the angle.")
    glare: float = Field(0.0, ge=0.0, le=1.0, description="a: share of the light that is spread widely.")
    glare_um: float = Field(800.0, ge=100.0, le=5000.0, description="Standard deviation of that spread, on an axis.")
    gain_dn: float = Field(1.0, gt=0.0, le=1e9, description="Signal at an irradiance of 1/mm2.")
    offset_dn: Signal = Field(0.0, description="Added to the signal, the same in all pixels.")
    ambient_dn: tuple[Signal, Signal] = Field((0.0, 0.0), description="Plane: rise from centre to last row, column.")
    full_scale_dn: float = Field(4031.0, gt=0.0, le=1e6, description="ymax: largest signal above black.")
    nonlinearity: float = Field(0.0, ge=-0.25, le=0.25, description="b: y becomes y (1 - b y / ymax).")
    saturation_knee: float = Field(
        1.0, ge=0.5, le=1.0, description="Share of ymax where saturation sets in; 1: none."
    )
    black_level_dn: float = Field(0.0, ge=0.0, le=1e6, description="Digital number without light.")
