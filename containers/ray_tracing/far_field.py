"""The far field: radiant intensity of a chip or a module against direction, from histograms of directions.

Directions are points on the sphere, z towards the receiver. The bins are equal in cos(theta) and in phi, so all have
one solid angle; theta is measured from +z, phi from +x towards +y. Row 0 lies at the lowest cos(theta), column 0 at
phi = 0. A histogram over the upper half has rows from cos(theta) = 0, one over the whole sphere from -1.

A bin holds the mean intensity over itself; it is placed at the middle of its cos(theta), where an intensity that is
linear in cos(theta), a Lambertian one for instance, has exactly that value. Between the middles it is interpolated
linearly in cos(theta) and phi. What is neglected: curvature within a bin, and that a far field whose intensity jumps
at the horizon (a chip on its substrate, on the whole sphere) is smeared over the two rows beside it.

Every standard error is the spread between the groups, which are independent and identically distributed, over the
square root of their number; sums over bins are taken in each group first, so their correlations are in it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from containers.checked import Real, reals, within
from luxloop.errors import InputError
from luxloop.photometry import luminous_efficacy_lm_per_w

CUTS_DEG = (0.0, 45.0, 90.0)
LOWEST_COS = (0.0, -1.0)


@dataclass(frozen=True)
class Curve:
    """Intensity along an angle."""

    theta_rad: Real
    """(theta,), ascending from the direction of the receiver."""
    intensity_per_sr: Real
    """(theta,), 1/sr per chip flux: W/sr after multiplication by the flux of a chip in W."""
    standard_error_per_sr: Real


@dataclass(frozen=True)
class FarField:
    """Radiant intensity per chip flux, 1/sr."""

    groups_per_sr: Real
    """(group, cos theta, phi), each group's own estimate of the whole far field."""
    lowest_cos: float
    """cos(theta) at which row 0 begins: 0 or -1."""

    @property
    def intensity_per_sr(self) -> Real:
        """(cos theta, phi), the mean over the groups."""
        return np.asarray(self.groups_per_sr.mean(axis=0))

    @property
    def standard_error_per_sr(self) -> Real:
        """(cos theta, phi), of each bin's intensity."""
        return _standard_error(self.groups_per_sr)

    @property
    def cos_theta(self) -> Real:
        """(cos theta,), the middles of the rows."""
        count = self.groups_per_sr.shape[1]
        return np.asarray(self.lowest_cos + (1.0 - self.lowest_cos) * (np.arange(count) + 0.5) / count)

    @property
    def phi_rad(self) -> Real:
        """(phi,), the middles of the columns."""
        count = self.groups_per_sr.shape[2]
        return np.asarray(2.0 * np.pi * (np.arange(count) + 0.5) / count)

    @property
    def bin_sr(self) -> float:
        """Solid angle of every bin."""
        _, rows, columns = self.groups_per_sr.shape
        return float(2.0 * np.pi * (1.0 - self.lowest_cos) / (rows * columns))

    def flux(self) -> tuple[float, float]:
        """The integral over all directions, and its standard error: what leaves, of what one chip emitted."""
        totals = self.groups_per_sr.sum(axis=(1, 2)) * self.bin_sr
        return float(totals.mean()), float(_standard_error(totals))

    def folded(self) -> FarField:
        """The mean over the eight images of a square: quarter turns, and mirrored at the x axis.

        Notes
        -----
        Right for a scene that has this symmetry (a square chip in a square lattice); the standard errors then fall by
        up to sqrt(8). Exactly symmetric afterwards, and as before where it was so. Needs columns in multiples of 4.
        """
        columns = self.groups_per_sr.shape[2]
        if columns % 4:
            raise InputError("phi bins", columns, "a multiple of 4 to be folded", "take 8, 16, 32, ... bins over phi")
        quarters = self.groups_per_sr.reshape(*self.groups_per_sr.shape[:2], 4, columns // 4).mean(axis=2)
        octants = 0.5 * (quarters + quarters[..., ::-1])
        return replace(self, groups_per_sr=np.tile(octants, 4))

    def curve(self) -> Curve:
        """Intensity against theta, the mean over phi."""
        return self._curve(self.groups_per_sr.mean(axis=2))

    def cut(self, phi_deg: float) -> Curve:
        """Intensity against theta in one half plane, interpolated between the two nearest columns.

        Notes
        -----
        phi = 0 lies on the border of two columns, so the cut is their mean: a far field that varies as cos(4 phi) is
        flattened there by (4 bin width)^2 / 6, 2.6 % of the variation for 64 columns.
        """
        columns = self.groups_per_sr.shape[2]
        place = reals("phi_deg", phi_deg) / 360.0 * columns - 0.5
        if not np.isfinite(place):
            raise InputError("phi_deg", phi_deg, "a finite angle")
        left = int(np.floor(place))
        share = float(place) - left
        first, second = (self.groups_per_sr[:, :, (left + k) % columns] for k in (0, 1))
        return self._curve((1.0 - share) * first + share * second)

    def cuts(self) -> dict[float, Curve]:
        """The cuts along the lattice, across its diagonal, and along its other axis: phi in degrees to curve."""
        return {phi_deg: self.cut(phi_deg) for phi_deg in CUTS_DEG}

    def at(self, theta_rad: ArrayLike, phi_rad: ArrayLike) -> Real:
        """Intensity (1/sr per chip flux) in given directions, in their broadcast shape.

        Parameters
        ----------
        theta_rad : 0 to pi (to pi/2 for the upper half), from the direction of the receiver.
        phi_rad : any.

        Notes
        -----
        Interpolated in cos(theta) and phi. Towards the poles and, for the upper half, the horizon the last two rows
        are continued linearly by half a row, not below 0; a pole has one value, the mean over phi.
        """
        steepest = float(np.arccos(self.lowest_cos))
        theta = within("theta_rad", theta_rad, 0.0, steepest * (1 + 1e-12), "directions that the histogram holds")
        theta, phi = np.broadcast_arrays(theta, reals("phi_rad", phi_rad))
        nodes, values = self._continued()
        columns = values.shape[1]
        place = phi / (2.0 * np.pi) * columns - 0.5
        left = np.floor(place).astype(np.int64)
        share = place - left
        cosine = np.clip(np.cos(theta), self.lowest_cos, 1.0)
        row = np.clip(np.searchsorted(nodes, cosine, side="right") - 1, 0, nodes.size - 2)
        up = (cosine - nodes[row]) / (nodes[row + 1] - nodes[row])
        first, second = left % columns, (left + 1) % columns
        below = (1.0 - share) * values[row, first] + share * values[row, second]
        above = (1.0 - share) * values[row + 1, first] + share * values[row + 1, second]
        return np.asarray((1.0 - up) * below + up * above)

    def _continued(self) -> tuple[Real, Real]:
        """cos(theta) from end to end, and the mean intensity there, (cos theta, phi)."""
        mean = self.intensity_per_sr
        bottom, top = (np.maximum(1.5 * mean[a] - 0.5 * mean[b], 0.0) for a, b in ((0, 1), (-1, -2)))
        top = np.full_like(top, max(float((1.5 * mean[-1] - 0.5 * mean[-2]).mean()), 0.0))
        if self.lowest_cos == -1.0:
            bottom = np.full_like(bottom, max(float((1.5 * mean[0] - 0.5 * mean[1]).mean()), 0.0))
        nodes = np.concatenate([[self.lowest_cos], self.cos_theta, [1.0]])
        return nodes, np.vstack([bottom, mean, top])

    def _curve(self, groups: Real) -> Curve:
        """A curve from (group, cos theta), turned so that theta ascends."""
        backwards = groups[:, ::-1]
        return Curve(np.arccos(self.cos_theta[::-1]), backwards.mean(axis=0), _standard_error(backwards))


def far_field(weights: ArrayLike, histories: int, lowest_cos: float = 0.0) -> FarField:
    """The far field of a histogram of directions.

    Parameters
    ----------
    weights : (group, cos theta, phi), summed weight that left into each bin; at least 2 groups and 2 rows.
    histories : of each group, each emitted with weight 1.
    lowest_cos : cos(theta) where row 0 begins, 0 (upper half) or -1 (sphere).

    Raises
    ------
    InputError : a histogram of another shape, negative or not finite, no histories, another lowest cosine.

    Notes
    -----
    I = weight / histories / solid angle of the bin. For a module whose chips each emitted `histories`, the result is
    per flux of one chip.
    """
    if lowest_cos not in LOWEST_COS:
        raise InputError("lowest_cos", lowest_cos, "0 (upper half) or -1 (sphere)")
    if histories < 1:
        raise InputError("histories", histories, "at least 1")
    sums = within("weights", weights, 0.0, np.finfo(float).max, "sums of weights are finite and not negative")
    if sums.ndim != 3 or sums.shape[0] < 2 or sums.shape[1] < 2 or sums.shape[2] < 1:
        allowed = "(group, cos theta, phi), at least 2 groups and 2 rows"
        raise InputError("weights", sums.shape, allowed, "a standard error needs groups")
    field = FarField(sums, float(lowest_cos))
    return replace(field, groups_per_sr=sums / (histories * field.bin_sr))


def luminous_flux_lm(flux_w: float, peak_nm: float, fwhm_nm: float) -> float:
    """Luminous flux of a chip whose line emits `flux_w`; x intensity in 1/sr per chip flux it is the intensity in cd.

    Raises InputError for a flux that is not finite and above 0, and for a line outside the visible.
    """
    flux = within("flux_w", flux_w, 0.0, np.finfo(float).max, "the radiant flux of a chip in W", above=True)
    return float(flux) * luminous_efficacy_lm_per_w(peak_nm, fwhm_nm)


def _standard_error(groups: Real) -> Real:
    return np.asarray(groups.std(axis=0, ddof=1) / np.sqrt(groups.shape[0]))
