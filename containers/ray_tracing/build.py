"""From an environment and a design to a `Scene`: every reading of the paper becomes a surface, a table, a length."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from containers.bsdf import Bsdf, Fresnel, GaussianLobe, Lambertian, Mirror, SpecularTable
from containers.checked import within
from containers.materials import material
from containers.ray_tracing.packing import node_angles
from containers.scene import LEAST_INDEX, MOST_INDEX, Array, Cell, Chip, Emission, Face, Receiver, Scene
from containers.thin_film.angles import powers_of_both
from containers.thin_film.table import FilmTable, Powers, Side
from luxloop.design import Design
from luxloop.errors import InputError
from luxloop.model import Environment, Surface

Real = NDArray[np.float64]

PER_CM_PER_UM = 1e-4
AIR = 1.0


def scene_of(environment: Environment, design: Design, film: FilmTable | None, layout: Cell | Array) -> Scene:
    """The scene of a design.

    Parameters
    ----------
    film : the table of the design's DBR, as PC2 computed it; None: a bare top face.
    layout : `cell_of` or `array_of` the same design.

    Raises
    ------
    InputError for a design that cannot be built, or a film that is not between the chip's material and air.
    """
    problem = design.feasibility(environment.distance_from, environment.spacing_is)
    if problem is not None:
        raise InputError("design", str(design), "a module that can be built", problem)
    line = _Line(environment, film)
    sides = Face(tuple(Fresnel(n, AIR) for n in line.index), tuple(Fresnel(AIR, n) for n in line.index))
    chip = Chip(
        width_um=design.width_um,
        thickness_um=design.thickness_um,
        index=line.index,
        top=sides if film is None else film_faces(environment, film),
        sides=sides,
        bottom=environment.chip_bottom,
        mirror=Mirror(environment.substrate.reflectance) if environment.chip_bottom == "mirror" else None,
        absorption_per_um=environment.chip_absorption_per_cm * PER_CM_PER_UM,
    )
    lift_um = design.thickness_um if environment.distance_from == "chip_top" else 0.0
    return Scene(
        layout=layout,
        chip=chip,
        distance_um=design.distance_um + lift_um,
        emission=emission_of(environment),
        substrate=surface_of(environment.substrate),
        receiver=Receiver(surface_of(environment.receiver)),
        wavelength_weight=line.weight,
    )


def pitch_um(environment: Environment, design: Design) -> float:
    """From chip centre to chip centre."""
    return design.spacing_um + (design.width_um if environment.spacing_is == "gap" else 0.0)


def cell_of(environment: Environment, design: Design) -> Cell:
    """The endless array of a design."""
    return Cell(pitch_um(environment, design))


def array_of(
    environment: Environment, design: Design, rows: int, columns: int, half_um: float | None = None
) -> Array:
    """A finite array of a design with open edges, half a pitch beyond the outer chips unless `half_um` is given."""
    return Array.regular(rows, columns, pitch_um(environment, design), half_um)


def surface_of(surface: Surface) -> Bsdf:
    """The surface that an environment names."""
    if surface.scatter == "lambertian":
        return Lambertian(surface.reflectance)
    return GaussianLobe(surface.reflectance, np.radians(surface.sigma_deg or 0.0))


def emission_of(environment: Environment) -> Emission:
    """Isotropic, or dipoles in the plane of the wells (3 / 16 pi (1 + cos^2), c-plane); volume or a thin layer."""
    depth = environment.active_layer_depth
    if environment.emission == "isotropic":
        return Emission(layer_depth=depth)
    cosine = np.linspace(-1.0, 1.0, 401)
    return Emission(layer_depth=depth, cosine=cosine, intensity=1.0 + cosine**2)


def film_faces(environment: Environment, film: FilmTable) -> Face:
    """The top face of a chip with a film; the latest are kept, for a fit asks for the same ones again and again."""
    arrays = (film.wavelength_nm, film.weight, film.n_inside, film.n_outside)
    chip = (environment.indices, environment.n_gan, environment.peak_nm, environment.spectrum)
    return _faces(_Top((film.stack, *chip, *(one.tobytes() for one in arrays)), environment, film))


@dataclass(frozen=True)
class _Top:
    """A film on a chip; two are alike where all that decides their faces is."""

    decides: tuple[object, ...]
    environment: Environment = field(compare=False)
    film: FilmTable = field(compare=False)


@lru_cache(maxsize=32)
def _faces(top: _Top) -> Face:
    line = _Line(top.environment, top.film)
    return Face(line.film_from("inside"), line.film_from("outside"))


def _fixed_index(environment: Environment) -> Real:
    """Of the chip, as (wavelength,). Raises InputError by the name that a request and a model file have for it."""
    mend = "unfolding needs n^2 of at least 2"
    return within("environment.n_gan", [environment.n_gan], LEAST_INDEX, MOST_INDEX, mend)


class _Line:
    """The wavelengths of a scene, and what its chip and film are at each of them.

    They are those of the film's table. Without a film there is the peak alone, be the spectrum sampled or not: all
    lines of dispersive GaN move the mean illuminance of S_b3 by 0.03 %.
    """

    def __init__(self, environment: Environment, film: FilmTable | None) -> None:
        self._film = film
        fixed = environment.indices == "fixed"
        at = np.array([environment.peak_nm])
        n = _fixed_index(environment) if fixed else material("GaN").index(at).real
        self.index, self.weight = n, np.ones(1)
        self._sampled = environment.spectrum == "sampled" and film is not None
        if film is None:
            return
        peak = int(np.argmax(film.weight))
        if abs(float(film.n_inside[peak]) - float(n[0])) > 1e-9 or abs(float(film.n_outside[peak]) - AIR) > 1e-9:
            between = (float(film.n_inside[peak]), float(film.n_outside[peak]))
            raise InputError("film", between, f"a film between n = {float(n[0]):g} and air", "ask PC2 for the DBR")
        if self._sampled:
            self.index, self.weight = film.n_inside, film.weight / film.weight.sum()

    def film_from(self, side: Side) -> tuple[Bsdf, ...]:
        """The film from one side, mean of s and p: of the whole line, or at each wavelength.

        In a scene of one wavelength the chip has one index, so the film lies on that index at every wavelength of the
        line: light comes and goes by the same angles, and T is the same from both sides.
        """
        film = self._film
        if film is None:
            raise ValueError("a film's faces without a film")
        if not self._sampled:
            of_line = replace(film, n_inside=np.full(film.n_inside.shape, self.index[0]))
            return (_specular(of_line, float(self.index[0]), side),)
        return tuple(_specular(_at(film, wave), float(n), side) for wave, n in enumerate(self.index))


def _at(film: FilmTable, wave: int) -> FilmTable:
    """What `powers_at` reads of a film, at one of its wavelengths."""
    one = slice(wave, wave + 1)
    return replace(
        film,
        wavelength_nm=film.wavelength_nm[one],
        weight=np.ones(1),
        n_inside=film.n_inside[one],
        n_outside=film.n_outside[one],
    )


def _specular(film: FilmTable, n: float, side: Side) -> SpecularTable:
    """The powers of a film on a chip of index n, from one side: mean of its wavelengths, and of s and p.

    They are computed at the very nodes that the kernels interpolate between. What rough faces scatter goes on as the
    specular light does: lobes of faces that are even over more than about a micrometre are narrower than 4 deg. As
    much of it goes on from one side as from the other, and none from total reflection.
    """
    theta = np.unique(node_angles(n, side == "inside"))
    powers, back = powers_of_both(film, side, theta)
    onward = _scattered_onward(powers, back)
    both = (powers.R + powers.S_R + powers.S_T - onward, powers.T + onward)
    R, T = (np.clip(np.tensordot(film.weight, of.mean(axis=1), axes=1), 0.0, 1.0) for of in both)
    return SpecularTable(theta, R, T, n / AIR if side == "inside" else AIR / n)


def _scattered_onward(one: Powers, back: Powers) -> Real:
    """What a film scatters onward, the harmonic mean of light from both sides: the same of both, 0 at grazing, and
    beyond the critical angle, where no light comes back."""
    total = one.S_T + back.S_T
    return np.divide(2.0 * one.S_T * back.S_T, total, out=np.zeros_like(total), where=total > 0.0)
