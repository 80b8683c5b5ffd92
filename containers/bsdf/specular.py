"""Light in one direction: a plain mirror, a Fresnel face, and a table of powers such as a thin film's."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from containers.bsdf.surface import HALF_PI, Bsdf, Deltas, Real, checked_angle, checked_share, pick
from containers.checked import within
from luxloop.errors import InputError


class Specular(Bsdf):
    """A surface with delta parts only: R into the mirror, T into the refracted direction, the rest absorbed.

    Beyond the critical angle of `index_ratio` nothing can be refracted: what interpolation still calls T there is
    reflected, so that no power is lost between two nodes of a table.
    """

    @abstractmethod
    def _powers(self, theta_in: Real) -> tuple[Real, Real]: ...

    def deltas(self, theta_in_rad: ArrayLike) -> Deltas:
        """R and T at each angle."""
        theta = checked_angle(theta_in_rad)
        return totally_reflected(Deltas(*self._powers(theta)), theta, self.index_ratio)

    def _draw(self, u: Real, theta_in: Real) -> Real:
        part, _ = pick(u[:, 0], np.stack(self.deltas(theta_in), axis=-1))
        return specular_direction(part == 1, theta_in, self.index_ratio)

    def _intensity(self, theta_in: Real, direction: Real) -> Real:  # noqa: ARG002  # nothing is spread
        return np.zeros(direction.shape[:-1])

    def _albedo(self, theta_in: Real) -> Real:
        return np.asarray(sum(self.deltas(theta_in)))


@dataclass(frozen=True)
class Mirror(Specular):
    """The same reflectance at every angle, nothing transmitted."""

    reflectance: float

    def __post_init__(self) -> None:
        checked_share("reflectance", self.reflectance)

    def _powers(self, theta_in: Real) -> tuple[Real, Real]:
        return np.full(theta_in.shape, self.reflectance), np.zeros(theta_in.shape)


@dataclass(frozen=True)
class Fresnel(Specular):
    """The bare face between two transparent media, unpolarised: mean of s and p."""

    n_in: float
    n_out: float

    def __post_init__(self) -> None:
        for field, n in (("n_in", self.n_in), ("n_out", self.n_out)):
            within(field, n, 0.0, 20.0, "a real index; absorbing media: use a film table", above=True)

    @property
    def index_ratio(self) -> float:
        """n_in / n_out."""
        return self.n_in / self.n_out

    def _powers(self, theta_in: Real) -> tuple[Real, Real]:
        c = np.cos(theta_in)
        # imaginary beyond the critical angle, where both ratios have modulus 1
        ct = np.sqrt(1.0 - (self.index_ratio * np.sin(theta_in)) ** 2 + 0j)
        s, p = self.n_in * c - self.n_out * ct, self.n_out * c - self.n_in * ct
        r_s, r_p = s / (self.n_in * c + self.n_out * ct), p / (self.n_out * c + self.n_in * ct)
        R = np.asarray((np.abs(r_s) ** 2 + np.abs(r_p) ** 2) / 2.0)
        return R, 1.0 - R


@dataclass(frozen=True)
class SpecularTable(Specular):
    """Powers R, T (node,) against theta_in_rad (node,), linear between the nodes, constant beyond them."""

    theta_in_rad: Real
    R: Real
    T: Real
    index_ratio: float = 1.0

    def __post_init__(self) -> None:
        theta = within("theta_in_rad", self.theta_in_rad, 0.0, HALF_PI, "increasing angles")
        if theta.ndim != 1 or not theta.size or not np.all(np.diff(theta) > 0.0):
            raise InputError("theta_in_rad", theta, "increasing angles from 0 to pi/2", "sort them")
        for field in ("R", "T"):
            power = within(field, getattr(self, field), 0.0, 1.0 + 1e-9, "a share of the incident power")
            if power.shape != theta.shape:
                raise InputError(field, power.shape, f"powers of shape {theta.shape}", "one for each angle")
            object.__setattr__(self, field, power)
        object.__setattr__(self, "theta_in_rad", theta)
        if np.any(self.R + self.T > 1.0 + 1e-9):
            row = int(np.argmax(self.R + self.T))
            at = f"{(self.R + self.T)[row]:.6f} at theta_in {np.degrees(theta[row]):.3f} deg (row {row})"
            raise InputError("R + T", at, "at most 1", "this row would create energy")
        within("index_ratio", self.index_ratio, 0.0, 20.0, "n_in / n_out", above=True)

    def _powers(self, theta_in: Real) -> tuple[Real, Real]:
        return np.interp(theta_in, self.theta_in_rad, self.R), np.interp(theta_in, self.theta_in_rad, self.T)


def totally_reflected(deltas: Deltas, theta_in: Real, index_ratio: float) -> Deltas:
    """The same powers with T moved to R where there is no refracted direction."""
    total = index_ratio * np.sin(theta_in) >= 1.0
    mirror, refracted = deltas
    return Deltas(np.where(total, mirror + refracted, mirror), np.where(total, 0.0, refracted))


def specular_direction(refracted: NDArray[np.bool_], theta_in: Real, ratio: float) -> Real:
    """Mirror directions (n, 3), or refracted ones where `refracted` (n,) says so."""
    sine = np.where(refracted, np.minimum(ratio * np.sin(theta_in), 1.0), np.sin(theta_in))
    cosine = np.sqrt(1.0 - sine**2)
    return np.stack([sine, np.zeros_like(sine), np.where(refracted, -cosine, cosine)], axis=-1)
