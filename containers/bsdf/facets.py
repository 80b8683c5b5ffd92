"""A rough clear face: small plane facets, each a Fresnel face, with Gaussian slopes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from containers.bsdf.specular import Fresnel
from containers.bsdf.surface import Bsdf, Real
from containers.checked import within
from luxloop.errors import InputError


@dataclass(frozen=True)
class Facets(Bsdf):
    """A face between two clear media made of facets whose slope has the root mean square `slope`.

    Parameters
    ----------
    slope : sqrt of the mean of tan^2 of the facets' tilt (Beckmann's width; sqrt(1/2) of it along an axis).

    Notes
    -----
    Light goes from facet to facet until it leaves (`facet_kernel`): nothing is lost, and light goes as easily from b
    to a as from a to b, times n^2. `intensity` is closed for light that meets one facet (Walter, Marschner, Li,
    Torrance, EGSR 2007, with Smith's separable masking); what meets several is in the samples and the albedo only:
    at normal incidence and a slope of 0.5 it is 1 % of the light from outside, 6 % from inside GaN.
    """

    n_in: float
    n_out: float
    slope: float

    def __post_init__(self) -> None:
        Fresnel(self.n_in, self.n_out)
        within("slope", self.slope, 0.0, 1.0, "a root mean square slope; use Fresnel for 0", above=True)
        if self.n_in == self.n_out:
            raise InputError("n_out", self.n_out, "another index than n_in", "a face that is none cannot be rough")

    @property
    def index_ratio(self) -> float:
        """n_in / n_out."""
        return self.n_in / self.n_out

    @property
    def deviation(self) -> float:
        """Standard deviation of the slope along one axis."""
        return float(self.slope / np.sqrt(2.0))

    def _draw(self, u: Real, theta_in: Real) -> Real:
        from containers.ray_tracing.facet_kernel import walk_many  # numba takes 0.4 s to load; descriptions need none

        # each ray's own key, so that it depends on its own numbers alone
        bits = np.ascontiguousarray(u).view(np.uint64)
        seeds = bits[:, 0] * np.uint64(3) ^ (bits[:, 1] << np.uint64(1)) ^ (bits[:, 2] * np.uint64(5))
        out = np.zeros((theta_in.size, 3))
        walk_many(self.n_in, self.n_out, self.deviation, np.array(theta_in), seeds, out)
        return out

    def _intensity(self, theta_in: Real, direction: Real) -> Real:
        i = np.stack([-np.sin(theta_in), np.zeros_like(theta_in), np.cos(theta_in)], axis=-1)
        reflected = direction[..., 2] > 0.0
        n_o = np.where(reflected, self.n_in, self.n_out)
        h = self.n_in * i + n_o[..., None] * direction
        h = h * np.where(h[..., 2:] < 0.0, -1.0, 1.0) / np.maximum(np.linalg.norm(h, axis=-1, keepdims=True), 1e-300)
        i_h, o_h = (i * h).sum(axis=-1), (direction * h).sum(axis=-1)
        lit = (i_h > 0.0) & np.where(reflected, o_h > 0.0, o_h < 0.0) & (h[..., 2] > 0.0)
        R, T = Fresnel(self.n_in, self.n_out).deltas(np.arccos(np.clip(i_h, 0.0, 1.0)))
        jacobian = np.abs(o_h) * n_o**2 / np.maximum((self.n_in * i_h + n_o * o_h) ** 2, 1e-300)
        jacobian = np.where(reflected, 1.0 / np.maximum(4.0 * i_h, 1e-300), jacobian)
        masks = self._unmasked(i[..., 2]) * self._unmasked(np.abs(direction[..., 2]))
        value = np.where(reflected, R, T) * self._facets(h[..., 2]) * i_h * jacobian * masks
        return np.asarray(np.where(lit, value / np.maximum(i[..., 2], 1e-300), 0.0))

    def _albedo(self, theta_in: Real) -> Real:
        return np.ones(theta_in.shape)

    def _facets(self, cosine: Real) -> Real:
        """Beckmann's distribution: area of facets per solid angle of their normals, over that of the face."""
        c2 = np.maximum(cosine, 1e-6) ** 2
        return np.asarray(np.exp(-(1.0 - c2) / (c2 * self.slope**2)) / (np.pi * self.slope**2 * c2**2))

    def _unmasked(self, cosine: Real) -> Real:
        from containers.ray_tracing.facet_kernel import unmasked

        return np.asarray(np.vectorize(unmasked, otypes=[float])(cosine, self.deviation))
