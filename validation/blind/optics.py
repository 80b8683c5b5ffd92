"""What a camera's lens makes of a map of light: means over pixels, and all that is hidden in plate and lens.

    map x plate --geometry, blur by displaced samples--> means over pixels --shadows, vignetting--> image

A pixel is the mean of nine samples (Gauss and Legendre), each read from a quintic spline at its own place, so that
turned and distorted pixels are what they are. Blurs may
change over the field: they are samples displaced about that place.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import fft, ndimage, special

from validation.blind.maps import Grid
from validation.blind.scenes import There
from validation.blind.words import Camera, Hidden, Pose, Real

ORDER = 5
DIFFUSION_UM, FLARE_UM = 120.0, 900.0
GHOST_SCALE, GHOST_UM = 0.8, 60.0
TEXTURE_UM, TEXTURE_DEG = 88.0, 7.0
STAIN_UM, STAIN_WAVES = 120.0, 60
HAIR_UM, DUST, DUST_UM = 12.5, 9, (20.0, 70.0)
FRINGES_UM = (90.0, 60.0)

Displaced = list[tuple[float, Real, Real]]
"""Weight, and displacement along x and y in um of each sample about a place."""


@dataclass(frozen=True, eq=False)
class Field:
    """A pixel grid's places: in um from the image's centre on the sensor, and as shares of its half sides."""

    x_um: Real
    y_um: Real
    x: Real
    y: Real
    corner: Real
    """Square of the radius, 1 at the corner."""


def image_of(light: Real, grid: Grid, half_um: float, camera: Camera, pose: Pose, there: There) -> Real:
    """The image (row, column) of a map (y, x), in the map's unit, mean over each pixel.

    half_um : the module's edge, beyond which the receiver is dark. Raises ValueError for pixels off the map.
    """
    _refuse_outside(grid, camera, pose)
    plate = _plate(light, grid, half_um, there)
    found = np.zeros((camera.rows, camera.columns))
    node, weight = np.polynomial.legendre.leggauss(3)
    for (down, of_down), (across, of_across) in itertools.product(zip(node, weight, strict=True), repeat=2):
        found += of_down * of_across / 4.0 * _seen(plate, camera, pose, there, down / 2.0, across / 2.0)
    field = _field(camera, 0.0, 0.0)
    for kind, shadow in SHADOWS.items():
        if kind in there:
            found = found * shadow(field, there[kind])
    return found


def _refuse_outside(grid: Grid, camera: Camera, pose: Pose) -> None:
    px = np.hypot(camera.rows, camera.columns) / 2.0 + np.hypot(pose.shift_row_px, pose.shift_column_px)
    if px * camera.pixel_um > grid.size / 2 * grid.step_um:
        raise ValueError(f"camera.pixel_um = {camera.pixel_um}: the image would reach {px * camera.pixel_um:.0f} um, "
                         f"up to {grid.size / 2 * grid.step_um:.0f} um is needed")  # fmt: skip


def _field(camera: Camera, down: float, across: float) -> Field:
    """Pixels moved by shares of a pixel."""
    row = np.arange(camera.rows)[:, None] + down - (camera.rows - 1) / 2.0 + np.zeros((1, camera.columns))
    column = np.arange(camera.columns)[None] + across - (camera.columns - 1) / 2.0 + np.zeros((camera.rows, 1))
    corner = (row**2 + column**2) / (np.hypot(camera.rows, camera.columns) / 2.0) ** 2
    return Field(
        camera.pixel_um * column,
        camera.pixel_um * row,
        2.0 * column / camera.columns,
        2.0 * row / camera.rows,
        corner,
    )


def _seen(
    plate: Callable[[Real, Real], Real], camera: Camera, pose: Pose, there: There, down: float, across: float
) -> Real:
    """One sample of each pixel."""
    field = _field(camera, down, across)
    x, y = _on_receiver(field, field.x_um, field.y_um, camera, pose, there)
    blurs = [blur(field, there[kind]) for kind, blur in BLURS.items() if kind in there]
    found = np.zeros(x.shape)
    for parts in itertools.product(*blurs):
        weight = float(np.prod([one[0] for one in parts]))
        found += weight * plate(x + sum(one[1] for one in parts), y + sum(one[2] for one in parts))
    if "lateral_colour" in there:
        found = _coloured(plate, x, y, there["lateral_colour"].amount)
    if "ghost_image" in there:
        amount = there["ghost_image"].amount
        x, y = _on_receiver(field, -field.x_um / GHOST_SCALE, -field.y_um / GHOST_SCALE, camera, pose, there)
        ghost = sum(weight * plate(x + dx, y + dy) for weight, dx, dy in _disc(GHOST_UM * np.ones_like(x)))
        found = (1.0 - amount) * found + amount * ghost
    return found


def _on_receiver(field: Field, x_um: Real, y_um: Real, camera: Camera, pose: Pose, there: There) -> tuple[Real, Real]:
    """Places on the receiver of places on the sensor; the module is shifted and turned in the image."""
    if "division_distortion" in there:
        inwards = 1.0 / (1.0 + there["division_distortion"].amount * field.corner)
        x_um, y_um = x_um * inwards, y_um * inwards
    x, y = x_um - camera.pixel_um * pose.shift_column_px, y_um - camera.pixel_um * pose.shift_row_px
    scale = 1.0 / (1.0 + there["wrong_scale"].amount) if "wrong_scale" in there else 1.0
    cos, sin = scale * np.cos(np.radians(pose.rotation_deg)), scale * np.sin(np.radians(pose.rotation_deg))
    return x * cos + y * sin, y * cos - x * sin


# The plate


def _plate(light: Real, grid: Grid, half_um: float, there: There) -> Callable[[Real, Real], Real]:
    """What the receiver shows at places in um."""
    inside = light * grid.inside(half_um)
    main, veil = light, None
    if "plate_diffusion" in there:
        share = there["plate_diffusion"].amount
        main = (1.0 - share) * main + share * _spread(inside, grid, lambda k: (1.0 + (DIFFUSION_UM * k) ** 2) ** -1.5)
        inside = main * grid.inside(half_um)
    if "lens_flare" in there:
        share = there["lens_flare"].amount
        main = (1.0 - share) * main
        veil = _reader(share * _spread(inside, grid, lambda k: np.exp(-FLARE_UM * k)), grid)
    read = _reader(main, grid)

    def plate(x_um: Real, y_um: Real) -> Real:
        found = np.where((np.abs(x_um) <= half_um) & (np.abs(y_um) <= half_um), read(x_um, y_um), 0.0)
        for kind, pattern in PATTERNS.items():
            if kind in there:
                found = found * pattern(x_um, y_um, there[kind])
        return found if veil is None else found + veil(x_um, y_um)

    return plate


def _reader(light: Real, grid: Grid) -> Callable[[Real, Real], Real]:
    """A map between its samples."""
    spline = ndimage.spline_filter(light, order=ORDER, mode="mirror")
    middle = grid.size // 2 - 0.5

    def read(x_um: Real, y_um: Real) -> Real:
        at = [y_um / grid.step_um + middle, x_um / grid.step_um + middle]
        return np.asarray(ndimage.map_coordinates(spline, at, order=ORDER, mode="nearest", prefilter=False))

    return read


def _spread(light: Real, grid: Grid, transform: Callable[[Real], Real]) -> Real:
    y, x = grid.waves()
    return np.asarray(fft.irfft2(fft.rfft2(light) * transform(np.sqrt(y**2 + x**2)), light.shape))


def _texture(x_um: Real, y_um: Real, hidden: Hidden) -> Real:
    turn = np.radians(TEXTURE_DEG)
    u, v = x_um * np.cos(turn) + y_um * np.sin(turn), y_um * np.cos(turn) - x_um * np.sin(turn)
    return np.asarray(
        1.0 + hidden.amount * np.cos(2.0 * np.pi * u / TEXTURE_UM) * np.cos(2.0 * np.pi * v / TEXTURE_UM)
    )


def _stains(x_um: Real, y_um: Real, hidden: Hidden) -> Real:
    random = np.random.default_rng((hidden.seed, 37))
    waves, phases = random.standard_normal((STAIN_WAVES, 2)) / STAIN_UM, 2.0 * np.pi * random.random(STAIN_WAVES)
    total = np.zeros_like(x_um)
    for (kx, ky), phase in zip(waves, phases, strict=True):
        total += np.cos(kx * x_um + ky * y_um + phase)
    return np.asarray(1.0 + hidden.amount * np.sqrt(2.0 / STAIN_WAVES) * total)


PATTERNS = {"textured_plate": _texture, "stained_plate": _stains}

# Blurs


def _disc(sd_um: Real) -> Displaced:
    """A disc whose standard deviation along an axis is `sd_um`: two rings of eight, exact to the fifth power."""
    found = []
    for square in ((3.0 - np.sqrt(3.0)) / 6.0, (3.0 + np.sqrt(3.0)) / 6.0):
        for angle in np.pi * (np.arange(8) + 0.5) / 4.0:
            radius = 2.0 * sd_um * np.sqrt(square)
            found.append((1.0 / 16.0, radius * np.cos(angle), radius * np.sin(angle)))
    return found


def _defocus(field: Field, hidden: Hidden) -> Displaced:
    return _disc(hidden.amount * np.ones_like(field.x))


def _tilted_lens(field: Field, hidden: Hidden) -> Displaced:
    along, _ = _along(field, hidden, 61)
    return _disc(hidden.amount * np.abs(along) / np.abs(along).max())


def _field_curvature(field: Field, hidden: Hidden) -> Displaced:
    return _disc(hidden.amount * (0.7 * field.corner + 0.3 * field.corner**2))


def _coma(field: Field, hidden: Hidden) -> Displaced:
    """A tail that thins out linearly, about its centroid."""
    node, weight = special.roots_jacobi(4, 1.0, 0.0)
    length, none = hidden.amount * field.y, np.zeros_like(field.y)
    return [
        (float(w), length * ((t + 1.0) / 2.0 - 1.0 / 3.0), none)
        for t, w in zip(node, weight / weight.sum(), strict=True)
    ]


def _astigmatism(field: Field, hidden: Hidden) -> Displaced:
    """An even line along the radius."""
    node, weight = np.polynomial.legendre.leggauss(6)
    half = np.sqrt(3.0) * hidden.amount * field.corner / np.maximum(np.hypot(field.x_um, field.y_um), 1e-9)
    return [(float(w) / 2.0, t * half * field.x_um, t * half * field.y_um) for t, w in zip(node, weight, strict=True)]


BLURS = {
    "defocus": _defocus, "tilted_lens": _tilted_lens, "field_curvature": _field_curvature, "coma": _coma,
    "astigmatism": _astigmatism,
}  # fmt: skip


def _coloured(plate: Callable[[Real, Real], Real], x: Real, y: Real, amount: float) -> Real:
    """The mean over scales from 1 - a to 1 + a."""
    node, weight = np.polynomial.legendre.leggauss(5)
    scales = zip(1.0 + amount * node, weight / 2.0, strict=True)
    return np.asarray(sum(w * plate(scale * x, scale * y) for scale, w in scales))


# Shadows


def _clipped_pupil(field: Field, hidden: Hidden) -> Real:
    return np.asarray(1.0 - hidden.amount * (0.6 * field.corner + 0.4 * field.corner**2))


def _along(field: Field, hidden: Hidden, purpose: int) -> tuple[Real, Real]:
    """Places in um along a drawn direction and across it."""
    angle = 2.0 * np.pi * np.random.default_rng((hidden.seed, purpose)).random()
    cos, sin = np.cos(angle), np.sin(angle)
    return field.x_um * cos + field.y_um * sin, field.y_um * cos - field.x_um * sin


def _shading_slope(field: Field, hidden: Hidden) -> Real:
    along, _ = _along(field, hidden, 41)
    return np.asarray(1.0 + hidden.amount * along / np.abs(along).max())


def _cover_fringes(field: Field, hidden: Hidden) -> Real:
    along, across = _along(field, hidden, 43)
    reach = np.abs(along).max()
    low, high = (1.0 / one for one in FRINGES_UM)
    turns = along * (low + high) / 2.0 + along**2 * (high - low) / (4.0 * reach) + across**2 * low / (8.0 * reach)
    return np.asarray(1.0 + hidden.amount * np.cos(2.0 * np.pi * turns))


def _hair(field: Field, hidden: Hidden) -> Real:
    along, across = _along(field, hidden, 47)
    offset = np.random.default_rng((hidden.seed, 53)).uniform(-0.3, 0.3) * np.abs(along).max()
    return np.asarray(1.0 - hidden.amount * np.exp(-0.5 * ((across - offset) / HAIR_UM) ** 2))


def _dust(field: Field, hidden: Hidden) -> Real:
    random = np.random.default_rng((hidden.seed, 59))
    left = np.ones_like(field.x_um)
    for x, y, radius in zip(*random.uniform(-0.9, 0.9, (2, DUST)), random.uniform(*DUST_UM, DUST), strict=True):
        square = (field.x_um - x * field.x_um.max()) ** 2 + (field.y_um - y * field.y_um.max()) ** 2
        left *= 1.0 - hidden.amount * np.exp(-((square / radius**2) ** 2))
    return left


SHADOWS: dict[str, Callable[[Field, Hidden], Real]] = {
    "clipped_pupil": _clipped_pupil, "shading_slope": _shading_slope, "cover_fringes": _cover_fringes,
    "hair": _hair, "dust": _dust,
}  # fmt: skip
"""In the sensor's own frame."""
