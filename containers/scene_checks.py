"""What is said of a scene before it is traced: tables that create energy are refused, one-way ones warned about.

Light that can go from a to b can go from b to a (Helmholtz). A table that breaks this is still traced, forward, as it
is; but its albedo and its shape then cannot both be right, and nothing that traces backwards will agree. The Gaussian
lobe is exempt: it is defined so.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from containers.bsdf import (
    Bsdf,
    Coated,
    Fresnel,
    Lambertian,
    Mixture,
    Tabulated,
    check_energy,
    one_way_share,
    transmission_defect,
)
from containers.scene import Array, Face, Scene
from luxloop.errors import InputError

ONE_WAY_TOLERANCE = 0.02
"""Of the reflected light. Tables of reciprocal lobes of 5 to 40 deg on steps of 1 to 5 deg show up to 0.017, tables
of the Gaussian lobe, which is not reciprocal, 0.046 and more."""
TRANSMISSION_TOLERANCE = 1e-3
"""Of the incident power. Our own films of 0.5 to 9.5 pairs, rough and absorbing ones too, show up to 1.0e-4, with
their scattered light up to 4.2e-4 (all between their nodes; at them 6e-7)."""
ANGLES_RAD = np.linspace(0.0, np.pi / 2, 181)


def scene_warnings(scene: Scene) -> tuple[str, ...]:
    """What is doubtful about the surfaces of a scene, a sentence each; none for a scene without tables.

    Raises
    ------
    InputError : a table that would create energy, naming surface and angle.

    Notes
    -----
    Reflection is checked for each table of each surface (`one_way_share`; of a chip's faces at the heaviest
    wavelength), part by part where it is a mixture, together with its coat; refraction at every wavelength
    (`transmission_defect`). Not checked: light that is scattered through a face, against its other side.
    """
    wave = int(np.argmax(scene.wavelength_weight))
    found: list[str] = []
    for name, bsdf in _surfaces(scene, wave):
        for where, part in _scattering(name, bsdf):
            _refuse_energy(where, part)
            found += _one_way(where, part)
    for name, face in (("chip.top", scene.chip.top), ("chip.sides", scene.chip.sides)):
        found += _unlike_transmission(name, face)
    return tuple(found)


def _surfaces(scene: Scene, wave: int) -> Iterator[tuple[str, Bsdf]]:
    """Every surface by name, one that is met in several places only once."""
    chip, layout = scene.chip, scene.layout
    every = {
        "substrate": scene.substrate,
        "receiver": scene.receiver.bsdf,
        "chip.mirror": chip.mirror,
        "wall": layout.wall if isinstance(layout, Array) else None,
        "chip.top.inside": chip.top.inside[wave],
        "chip.top.outside": chip.top.outside[wave],
        "chip.sides.inside": chip.sides.inside[wave],
        "chip.sides.outside": chip.sides.outside[wave],
    }
    seen: set[int] = set()
    for name, bsdf in every.items():
        if bsdf is not None and id(bsdf) not in seen:
            seen.add(id(bsdf))
            yield name, bsdf


def _scattering(where: str, bsdf: Bsdf) -> Iterator[tuple[str, Bsdf]]:
    """The parts that spread light and must be reciprocal, each under its coat; mirrors are by themselves."""
    if isinstance(bsdf, Mixture):
        for number, part in enumerate(bsdf.parts, 1):
            yield from _scattering(f"{where}, part {number}", part)
    elif isinstance(bsdf, Coated):
        for of, part in _scattering(where, bsdf.base):
            yield of, Coated(bsdf.coat, part)
    elif isinstance(bsdf, Lambertian | Tabulated):
        yield where, bsdf


def _refuse_energy(where: str, bsdf: Bsdf) -> None:
    if isinstance(bsdf, Coated):
        _refuse_energy(where, bsdf.base)
    elif isinstance(bsdf, Tabulated):
        try:
            check_energy(bsdf, bsdf.theta_in_rad)
        except InputError as error:
            raise InputError(f"{where}: {error.field}", error.value, error.allowed, error.mend) from None


def _one_way(where: str, bsdf: Bsdf) -> Iterator[str]:
    if isinstance(bsdf, Lambertian):
        return
    share = one_way_share(bsdf)
    if share > ONE_WAY_TOLERANCE:
        which, first = ("the coated surface", "tabulate it, then ") if isinstance(bsdf, Coated) else ("the table", "")
        yield (
            f"{where}: {which} reflects {100.0 * share:.2g} % of its light in directions that it would not come back "
            f"from (Helmholtz reciprocity; up to {100.0 * ONE_WAY_TOLERANCE:g} % is what a table's cells cost); "
            f"it is traced so; {first}containers.bsdf.symmetrised makes it reciprocal if all rows then stay below 1"
        )


def _unlike_transmission(name: str, face: Face) -> Iterator[str]:
    pairs = [
        (outside, inside)
        for outside, inside in zip(face.outside, face.inside, strict=True)
        if not _bare(outside, inside)
    ]
    defect = max((transmission_defect(outside, inside, ANGLES_RAD) for outside, inside in pairs), default=0.0)
    if defect > TRANSMISSION_TOLERANCE:
        yield (
            f"{name}: T from outside and from inside differ by up to {defect:.2g} of the incident power (Helmholtz "
            f"reciprocity; up to {TRANSMISSION_TOLERANCE:g} is what a film's nodes cost); it is traced so; compute "
            "both sides from one stack"
        )


def _bare(outside: Bsdf, inside: Bsdf) -> bool:
    """Both sides of one clear face, alike by Fresnel's equations."""
    if not (isinstance(outside, Fresnel) and isinstance(inside, Fresnel)):
        return False
    return (outside.n_in, outside.n_out) == (inside.n_out, inside.n_in)
