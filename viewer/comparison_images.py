"""The images of a comparison: measured, model, residual in sigma, cuts through the chips; each gives SVG.

All residuals are measured minus model. A map of residuals has one scale, ±4 sigma, and beside it stands what noise
alone looks like, so that two maps can be compared by eye.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib import colormaps, rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from numpy.typing import NDArray

from viewer.comparison_curves import SCALE, sigma_pane
from viewer.look import BLUE, GREY, ORANGE, TEXT, svg

Document = Mapping[str, Any]
Arrays = Mapping[str, NDArray[Any]]
Values = NDArray[np.float64]

LARGEST_PX = 128  # of a side on the page; larger images are drawn with pixels joined
NOISE_SEED = 1
SMALL = (3.3, 2.75)
MEASURED, MODEL, RESIDUAL, NOISE = "measured (DN)", "model (DN)", "residual (sigma)", "noise alone, an example"
RESIDUALS = colormaps["RdBu_r"].resampled(33).with_extremes(bad=GREY)
UNUSED = colormaps["inferno"].resampled(128).with_extremes(bad=GREY)


@dataclass(frozen=True, eq=False)
class Image:
    """An image as measured and as modelled; NaN where a pixel is unused, row 0 at the lowest y."""

    measured_dn: Values
    model_dn: Values
    z: Values
    pixel_um: float
    centre_px: tuple[float, float]  # (row, column), where the fit found the module's centre

    @property
    def cut(self) -> tuple[int, int]:
        """Row and column through chips: of those where the model is brightest the nearest to the centre."""
        bright = np.where(np.isfinite(self.measured_dn), self.model_dn, np.nan)
        return _brightest(bright, self.centre_px[0]), _brightest(bright.T, self.centre_px[1])

    def at_mm(self, axis: int) -> Values:
        """Where the centres of the rows (0) or columns (1) lie, from the module's centre."""
        pixels = np.arange(self.z.shape[axis], dtype=np.float64) - self.centre_px[axis]
        return pixels * (self.pixel_um / 1000.0)


def image_of(shot: Document, arrays: Arrays) -> Image:
    """The image of a shot of the document."""
    names = ("measured_dn", "model_dn", "z")
    measured_dn, model_dn, z = (np.asarray(arrays[f"{shot['id']}/{name}"], dtype=np.float64) for name in names)
    pixel_um = float(shot["pixel_um"])
    shift_um = shot.get("shift_um") or (0.0, 0.0)  # earlier diagnoses do not tell it
    row, column = (at_px + um / pixel_um for at_px, um in zip(shot["centre_px"], reversed(shift_um), strict=True))
    return Image(measured_dn, model_dn, z, pixel_um, (float(row), float(column)))


def joined(image: Image) -> int:
    """How many pixels along a side are drawn as one."""
    return -(-int(max(image.z.shape)) // LARGEST_PX)


def joined_sigma(z: Values, side: int) -> Values:
    """Residuals of squares of pixels in sigma of the squares: their sum over the root of their number."""
    total, count = _joined(z, side)
    return total / np.sqrt(count)


def joined_signal(signal_dn: Values, side: int) -> Values:
    """Mean signal of squares of pixels."""
    total, count = _joined(signal_dn, side)
    return total / count


def image_pictures(image: Image, wanted: Collection[str] | None = None) -> dict[str, bytes]:
    """Measured, model, residual; cuts along x and y; what noise alone looks like; or those `wanted`. {title: SVG}"""
    maps: dict[str, Callable[[Figure, Axes], None]] = {
        MEASURED: lambda figure, axes: _signal(figure, axes, image, image.measured_dn),
        MODEL: lambda figure, axes: _signal(figure, axes, image, image.model_dn),
        RESIDUAL: lambda figure, axes: residuals(figure, axes, image, image.z),
        NOISE: lambda figure, axes: residuals(figure, axes, image, noise_like(image)),
    }
    cuts = {"cut along x": 1, "cut along y": 0}
    titles = [title for title in (MEASURED, MODEL, RESIDUAL, *cuts, NOISE) if wanted is None or title in wanted]
    return {title: _cut_picture(image, cuts[title]) if title in cuts else _small(title, maps[title])
            for title in titles}  # fmt: skip


def noise_like(image: Image) -> Values:
    """Unit noise on the same pixels, always the same: what z is where the model is right."""
    noise: Values = np.random.default_rng(NOISE_SEED).standard_normal(image.z.shape)
    return np.where(np.isfinite(image.z), noise, np.nan)


def worst(image: Image, title: str) -> Figure:
    """The picture that says most of an image: measured, model, residual and noise, and the cut along x."""
    with rc_context(TEXT):
        figure = Figure(figsize=(12.0, 6.2), layout="constrained")
        grid = figure.add_gridspec(3, 4, height_ratios=(3.0, 1.4, 1.0))
        tops = [figure.add_subplot(grid[0, column]) for column in range(4)]
        _signal(figure, tops[0], image, image.measured_dn)
        _signal(figure, tops[1], image, image.model_dn)
        residuals(figure, tops[2], image, image.z)
        residuals(figure, tops[3], image, noise_like(image))
        for axes, name in zip(tops, (MEASURED, MODEL, RESIDUAL, NOISE), strict=True):
            axes.set_title(name)
        upper = figure.add_subplot(grid[1, :])
        _cut(upper, figure.add_subplot(grid[2, :], sharex=upper), image, 1)
        figure.suptitle(title, fontsize=11, x=0.01, ha="left")
        return figure


def residuals(figure: Figure, axes: Axes, image: Image, z: Values) -> None:
    """A map of residuals in sigma, ±4; joined pixels keep a sigma of 1."""
    side = joined(image)
    shown = axes.imshow(
        joined_sigma(z, side), origin="lower", extent=_extent(image, side), cmap=RESIDUALS,
        interpolation="none", vmin=-SCALE, vmax=SCALE,
    )  # fmt: skip
    _scale(figure, axes, shown, extend="both")
    _millimetres(axes)


def _small(title: str, draw: Any) -> bytes:
    """A square picture; nothing is measured to lay it out, which would take most of the time."""
    with rc_context(TEXT):
        figure = Figure(figsize=SMALL)
        axes = figure.add_axes((0.16, 0.14, 0.7, 0.78))
        draw(figure, axes)
        axes.set_title(title)
        return svg(figure)


def _signal(figure: Figure, axes: Axes, image: Image, signal_dn: Values) -> None:
    """False colours on the scale of the model, so that both images share it."""
    side = joined(image)
    shown = axes.imshow(
        joined_signal(signal_dn, side), origin="lower", extent=_extent(image, side), cmap=UNUSED,
        interpolation="none", vmin=float(np.nanmin(image.model_dn)), vmax=float(np.nanmax(image.model_dn)),
    )  # fmt: skip
    _scale(figure, axes, shown)
    _millimetres(axes)


def _cut_picture(image: Image, axis: int) -> bytes:
    with rc_context(TEXT):
        figure = Figure(figsize=SMALL)
        upper = figure.add_axes((0.17, 0.48, 0.8, 0.44))
        _cut(upper, figure.add_axes((0.17, 0.15, 0.8, 0.27), sharex=upper), image, axis)
        return svg(figure)


def _cut(upper: Axes, lower: Axes, image: Image, axis: int) -> None:
    """Measured and model through the chips along x (axis 1) or y (0), the residual in sigma below."""
    at = image.cut[1 - axis]
    place = at if axis else (slice(None), at)
    mm, z = image.at_mm(axis), image.z[place]
    upper.plot(mm, image.measured_dn[place], ".", color=BLUE, markersize=3.0, label="measured")
    upper.plot(mm, image.model_dn[place], color=ORANGE, linewidth=1.1, label="model")
    upper.tick_params(labelbottom=False)
    upper.set_ylabel("signal (DN)")
    upper.legend(loc="lower right", bbox_to_anchor=(1.02, 0.97), ncols=2, handlelength=0.9, columnspacing=0.8)
    upper.grid(alpha=0.25)
    along, across = ("x", "y") if axis else ("y", "x")
    upper.set_title(f"cut at {across} = {image.at_mm(1 - axis)[at]:.3f} mm")
    lower.plot(mm, z, color=BLUE, linewidth=0.7)
    sigma_pane(lower, z)
    lower.set_xlim(mm[0], mm[-1])
    lower.set_xlabel(f"{along} (mm)")


def _scale(figure: Figure, axes: Axes, shown: AxesImage, extend: str = "neither") -> None:
    """The colours as a bar; as pixels, since 256 rectangles are larger than the image."""
    bar = figure.colorbar(shown, ax=axes, extend=extend, fraction=0.05, pad=0.03)
    assert bar.solids is not None  # noqa: S101  # matplotlib has drawn them a moment ago
    bar.solids.set_rasterized(True)


def _millimetres(axes: Axes) -> None:
    axes.set_xlabel("x (mm)", labelpad=1.0)
    axes.set_ylabel("y (mm)", labelpad=1.0)
    for spine in axes.spines.values():
        spine.set_visible(False)


def _extent(image: Image, side: int) -> tuple[float, float, float, float]:
    """Where the drawn pixels end, left, right, bottom, top; joined pixels may pass the image's last one."""
    left, bottom = (-0.5 - image.centre_px[axis] for axis in (1, 0))
    rows, columns = (-(-n // side) * side for n in image.z.shape)
    scale = image.pixel_um / 1000.0
    return left * scale, (left + columns) * scale, bottom * scale, (bottom + rows) * scale


def _joined(values: Values, side: int) -> tuple[Values, Values]:
    """Sum and number of the used pixels of squares of pixels; NaN where none is used."""
    rows, columns = (-(-n // side) for n in values.shape)
    padded = np.full((rows * side, columns * side), np.nan)
    padded[: values.shape[0], : values.shape[1]] = values
    squares = padded.reshape(rows, side, columns, side).swapaxes(1, 2).reshape(rows, columns, side * side)
    count = np.isfinite(squares).sum(axis=-1).astype(np.float64)
    return np.nansum(squares, axis=-1), np.where(count > 0, count, np.nan)


def _brightest(rows: Values, centre: float) -> int:
    """The row nearest the centre among those within 3 % of the largest mean; mostly unused ones do not count."""
    count = np.isfinite(rows).sum(axis=1)
    mean = np.where(2 * count >= count.max(), np.nansum(rows, axis=1) / np.maximum(count, 1), -np.inf)
    (bright,) = np.nonzero(mean >= mean.max() - 0.03 * abs(mean.max()))
    return int(bright[np.argmin(np.abs(bright - centre))])
