"""A model and its data side by side: what is fitted, what is left, and whether that is more than noise.

`compared` fits what is nobody's fault (gain, offset, place and turn of every image, the scale of a goniometer) and,
where wanted, parameters of the model; then asks whether what is left has structure. The result document is what
commands print, pages show and journals keep.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from luxloop.model import Model
from validation.contrasts import Region, Structure, structure
from validation.fit import CurveData, CurvesOf, Fit, fit
from validation.measured import MeasuredImage
from validation.observed import Observed
from validation.prediction import Anchored, Predictor
from validation.virtual_realistic import errors_of

Real = NDArray[np.float64]

SEEN = 0.01
"""A p-value below which a shot is said to differ: one in a hundred shots does by chance."""
ALL = "all images"
"""In place of a shot's id, where the images were summed up."""
NULLS = "nulls"
"""Folder in the cache: the distribution of noise after a fit depends on its layout, not on its data."""


@dataclass(frozen=True)
class Solver:
    """How images are predicted: the twin alone, or the twin as a difference to Monte Carlo of so many histories."""

    histories: int | None
    seed: int = 1

    @property
    def anchor_at(self) -> Callable[[Model], Anchored | None] | None:
        """What a fit asks for its anchor; None for the twin alone."""
        return None if self.histories is None else self.anchor

    def anchor(self, model: Model) -> Anchored:
        """The anchor at a model; of the twin alone one without Monte Carlo, whose chips lend their exits."""
        return Anchored(model, self.histories or 0, self.seed)

    def document(self) -> dict[str, Any]:
        """For people and machines."""
        method = "twin" if self.histories is None else "anchored"
        return {"method": method, "histories": self.histories, "seed": self.seed}


@dataclass(frozen=True, eq=False)
class Comparison:
    """A fit and what it left."""

    observed: Observed
    fit: Fit
    structure: Structure
    solver: Solver

    @property
    def differ(self) -> list[str]:
        """The shots that differ from the model by more than noise."""
        return [shot for shot, found in self.structure.shots.items() if found.p < SEEN]

    @property
    def sentence(self) -> str:
        """What to say first."""
        count, of = len(self.differ), len(self.observed.shots)
        kind = "shots" if self.observed.curves else "images"
        if count:
            return f"{count} of {of} {kind} differ from the model by more than noise"
        if self.structure.p < SEEN:
            return f"together the {of} {kind} differ from the model by more than noise, each alone does not"
        return f"none of the {of} {kind} differs from the model by more than noise (p = {self.structure.p_text})"

    def document(self) -> dict[str, Any]:
        """Everything that is told, as plain values."""
        found, worst = self.structure, self.structure.where[0] if self.structure.where else None
        return {
            "sentence": self.sentence,
            "solver": self.solver.document(),
            "trusted": self.fit.trusted,
            "reason": "; ".join(self.fit.distrust),
            "structure": {
                "p": found.p, "p_text": found.p_text, "z": found.z, "statistic": found.statistic,
                "draws": found.draws, "seed": found.seed, "chi2_per_pixel": self.fit.chi2_per_row,
                "variance_scale": found.variance_scale, "model_noise_share": self.model_noise_share,
                "family": worst.family if worst else "", "shot": worst.shot or ALL if worst else "",
                "region": worst.words if worst else "",
                "families": [{"name": one.name, "z": one.z, "p": one.p} for one in found.families],
            },
            "shots": [self._shot(shot) for shot in self.observed.shots],
            "regions": [region_document(region) for region in found.where],
            "parameters": self._parameters(),
        }  # fmt: skip

    @property
    def model_noise_share(self) -> float:
        """Rms of the model's own Monte Carlo noise in units of the measurement's, mean over rows."""
        noise = self.fit.noise
        return float(np.sqrt((noise**2).sum(axis=0).mean())) if len(noise) else 0.0

    def arrays(self) -> dict[str, Real]:
        """Measured, model and residual (standard deviations) of every shot, by "ID/NAME"; NaN where unused."""
        arrays: dict[str, Real] = {}
        residuals = self.fit.residual_images
        for image, model, z in zip(self.fit.problem.images, self.fit.signals_dn, residuals, strict=True):
            shot = image.shot.id
            arrays[f"{shot}/measured_dn"] = np.where(image.used, image.signal_dn, np.nan)
            arrays[f"{shot}/model_dn"] = np.asarray(model)
            arrays[f"{shot}/z"] = np.where(image.used, z, np.nan)
        for curve, z in zip(self.fit.problem.curves, self._curve_residuals(), strict=True):
            arrays |= _curve_arrays(curve, z)
        return arrays

    def residual_maps(self) -> dict[str, Real]:
        """Residuals of the images in standard deviations, 0 where unused."""
        images = self.fit.problem.images
        return {image.shot.id: z for image, z in zip(images, self.fit.residual_images, strict=True)}

    def _shot(self, shot: str) -> dict[str, Any]:
        found = self.structure.shots[shot]
        same = {
            "id": shot, "chi2_per_pixel": found.chi2_per_pixel, "p": found.p, "p_text": found.p_text, "z": found.z,
            "worst_region": found.worst.words, "worst_z": found.worst.z,
        }  # fmt: skip
        for number, image in enumerate(self.fit.problem.images):
            if image.shot.id == shot:
                return same | self._image(image, np.asarray(self.fit.signals_dn[number]))
        number = [curve.id for curve in self.fit.problem.curves].index(shot)
        return same | self._curve(self.fit.problem.curves[number], self._curve_residuals()[number])

    def _image(self, image: MeasuredImage, model_dn: Real) -> dict[str, Any]:
        shot, used = image.shot.id, image.used
        measured, fitted = image.signal_dn[used], model_dn[used]
        level, variance = float(np.mean(fitted)), image.variance_dn2(model_dn)[used]
        predicted = (model_dn - self.fit.offsets_dn[shot]) / self.fit.gains[shot]
        mse, mse_dn2, _ = errors_of(image, predicted)
        pose = self.fit.poses[shot]
        return {
            "kind": "image", "sample": image.sample.id, "dbr_pairs": image.sample.dbr_pairs,
            "pixels": int(used.sum()),
            "rms_error_percent": 100.0 * float(np.sqrt(np.mean((measured - fitted) ** 2))) / level,
            "noise_percent": 100.0 * float(np.sqrt(np.mean(variance))) / level,
            "mse": mse, "mse_dn2": mse_dn2,
            "gain_dn_mm2": self.fit.gains[shot], "offset_dn": self.fit.offsets_dn[shot],
            "shift_um": [pose.shift_px[1] * image.pixel_um, pose.shift_px[0] * image.pixel_um],
            "rotation_deg": pose.rotation_deg, "saturated": image.saturated, "masked": image.masked,
            "pixel_um": image.pixel_um, "centre_px": list(image.centre_px),
        }  # fmt: skip

    def _curve(self, curve: CurveData, z: Real) -> dict[str, Any]:
        difference = z * curve.sigma
        level = 100.0 if curve.is_angle else float(np.mean(np.abs(curve.value)))  # angles: their own degrees
        return {
            "kind": "spectrum" if not curve.free_scale else "far_field", "pixels": int(curve.value.size),
            "rms_error": float(np.sqrt(np.mean(difference**2))), "noise": float(np.sqrt(np.mean(curve.sigma**2))),
            "rms_error_percent": 100.0 * float(np.sqrt(np.mean(difference**2))) / level,
            "noise_percent": 100.0 * float(np.sqrt(np.mean(curve.sigma**2))) / level,
            "unit": "deg" if curve.is_angle else "1",
        }  # fmt: skip

    def _curve_residuals(self) -> list[Real]:
        """Whitened residual of each curve."""
        rows = self.fit.residual[self.fit.whitening.count :]
        ends = np.cumsum([len(curve.value) for curve in self.fit.problem.curves])
        return [np.asarray(part) for part in np.split(rows, ends[:-1])] if len(ends) else []

    def _parameters(self) -> list[dict[str, Any]]:
        """What was fitted beside the nuisances."""
        unknowns = self.fit.problem.unknowns
        names = (*unknowns.model_paths, *unknowns.other_paths)
        known = {one.name: one for one in unknowns.parameters}
        return [
            {
                "path": name, "value": self.fit.value(name), "error": self.fit.error(name),
                "lower": known[name].lower, "upper": known[name].upper, "at_limit": name in self.fit.at_limit,
            }
            for name in names
        ]  # fmt: skip


def compared(
    model: Model,
    observed: Observed,
    predictor: Predictor,
    solver: Solver,
    *,
    free: Sequence[str] = (),
    cache: Path | None = None,
) -> Comparison:
    """Model and data side by side; `free`: paths of the model that move besides gains, offsets and places.

    Films move where the data set lets them. Raises InputError where there is nothing to compare.
    """
    found = fit(
        model,
        observed.images,
        predictor,
        free=free,
        anchor_at=solver.anchor_at,
        curves=observed.curves,
        predict_curves=CurvesOf(predictor),
        others=observed.films,
        start=observed.films_at,
    )
    return Comparison(observed, found, structure(found, seed=solver.seed, cache=cache), solver)


def region_document(region: Region) -> dict[str, Any]:
    """A region as plain values."""
    return {
        "family": region.family,
        "shot": region.shot or ALL,
        "region": region.words,
        "z": region.z,
        "log_chance": region.log_chance,
    }


def _curve_arrays(curve: CurveData, z: Real) -> dict[str, Real]:
    """Columns of a curve, one entry a row."""
    table = getattr(curve.source, "table", None)
    axes = ("theta_deg", "phi_deg") if curve.free_scale else ("wavelength_nm", "aoi_deg")
    columns = {name: np.asarray(getattr(table, name), float) for name in axes}
    columns |= {"measured": curve.value, "model": curve.value - z * curve.sigma, "sigma": curve.sigma, "z": z}
    return {f"{curve.id}/{name}": column for name, column in columns.items()}
