"""A model and its data side by side: what is fitted, what is left, and whether that is more than noise.

`compared` fits what is nobody's fault (gain, offset, place and turn of every image, the scale of a goniometer) and,
where wanted, parameters of the model; then asks whether what is left has structure. The result document is what
commands print, pages show and journals keep.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from luxloop.model import Model
from validation.contrasts import Region, Structure, structure
from validation.curve_profiles import curve_regions, fourier
from validation.fit import CurveData, CurvesOf, Fit, fit
from validation.fit.result import MOST_HISTORIES
from validation.measured import MeasuredFarField, MeasuredSpectrum
from validation.observed import Observed
from validation.prediction import Anchored, Curve, FarView, PredictedCurve, Predictor
from validation.prediction.far_fields import HISTORIES
from validation.virtual_realistic import errors_of

Real = NDArray[np.float64]

SEEN = 0.01
"""A chance below which something is said to differ: each of n shots is held to an n-th of it."""
LEAST_P = 1e-4
"""Just above what a shot beyond all draws has: no smaller chance is told from it."""
ALL = "all images"
"""In place of a shot's id, where the images were summed up."""
REGIONS = 20
"""Told of all that were looked at."""
MOST_MODEL_NOISE = 0.3
"""Of a far field's Monte Carlo, rms in the measurement's sigma: its noise is not told to the fit, as that of images
is, so a tenth of the variance is all that it may have."""
FAR_BINS = 64, 64
"""Rows and columns of the worker's far fields, over the upper half."""
NULLS = "nulls"
"""Folder in the cache: the distribution of noise after a fit depends on its layout, not on its data."""


MANY = 8
"""Times as many histories as an anchor begins with: what a diagnosis lets the last one have (decision 43)."""


@dataclass(frozen=True)
class Solver:
    """How images are predicted: the twin alone, or the twin as a difference to Monte Carlo of so many histories."""

    histories: int | None
    seed: int = 1
    most_histories: int = 0
    """Up to which the last anchor is made anew with as many as its noise asks for."""

    @classmethod
    def of_diagnosis(cls, histories: int | None, seed: int, most_histories: int | None) -> Solver:
        """That of commands that name effects; None: the twin alone, and `MANY` times as many at last."""
        most = min(MANY * (histories or 0), MOST_HISTORIES) if most_histories is None else most_histories
        return cls(histories, seed, most)

    @property
    def anchor_at(self) -> Callable[[Model], Anchored | None] | None:
        """What a fit asks for its anchor; None for the twin alone."""
        return None if self.histories is None else self.anchor

    def anchor(self, model: Model) -> Anchored:
        """The anchor at a model; of the twin alone one without Monte Carlo, whose chips lend their exits."""
        return Anchored(model, self.histories or 0, self.seed)

    def curves_of(self, predictor: Predictor) -> CurvesOf:
        """What a fit asks for its curves: far fields with this seed, and no fewer histories than the anchors have."""
        return CurvesOf(_Curves(predictor, self))

    def document(self) -> dict[str, Any]:
        """For people and machines."""
        method = "twin" if self.histories is None else "anchored"
        most = {"most_histories": self.most_histories} if self.most_histories else {}
        return {"method": method, "histories": self.histories, "seed": self.seed, **most}


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
        found = self.structure
        return differing({shot: found.shots[shot].p for shot in self.observed.shots}, found.p)

    @property
    def sentence(self) -> str:
        """What to say first."""
        of, found = len(self.observed.shots), self.structure
        return sentence_of(len(self.differ), of, found.p, found.p_text, curves=bool(self.observed.curves))

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
                "place": found.place, "pattern": found.pattern,
                "draws": found.draws, "seed": found.seed, "chi2_per_pixel": self.fit.chi2_per_row,
                "variance_scale": found.variance_scale, "model_noise_share": self.model_noise_share,
                "family": worst.family if worst else "", "shot": worst.shot or ALL if worst else "",
                "region": worst.words if worst else "",
                "families": [{"name": one.name, "z": one.z, "p": one.p} for one in found.families],
            },
            "shots": [self._shot(shot) for shot in self.observed.shots],
            "regions": [region_document(region) for region in self.regions],
            "fourier": fourier(self.fit, found.variance_scale),
            "parameters": self._parameters(),
        }  # fmt: skip

    @property
    def regions(self) -> list[Region]:
        """Where it is least like noise, the least likely first: of images, and of curves by their coordinates."""
        of_curves = curve_regions(self.fit, self.structure.variance_scale)
        return sorted((*self.structure.where, *of_curves), key=lambda region: region.log_chance)[:REGIONS]

    @property
    def model_noise_share(self) -> float:
        """Rms of the model's own Monte Carlo noise in units of the measurement's, mean over rows."""
        return self.fit.noise_share

    def arrays(self) -> dict[str, Real]:
        """Measured, model and residual (standard deviations) of every shot, by "ID/NAME"; NaN where unused."""
        arrays: dict[str, Real] = {}
        residuals = self.fit.residual_images
        for image, model, z in zip(self.fit.problem.images, self.fit.signals_dn, residuals, strict=True):
            shot = image.shot.id
            arrays[f"{shot}/measured_dn"] = np.where(image.used, image.signal_dn, np.nan)
            arrays[f"{shot}/model_dn"] = np.asarray(model)
            arrays[f"{shot}/z"] = np.where(image.used, z, np.nan)
        sigmas, residuals = self.fit.whitening.curve_sigma, self.fit.residual_curves
        for curve, sigma, z in zip(self.fit.problem.curves, sigmas, residuals, strict=True):
            arrays |= _curve_arrays(curve, sigma, z)
        return arrays

    def residual_maps(self) -> dict[str, Real]:
        """Residuals in standard deviations, 0 where unused; a curve is a map of one row."""
        return maps_of(self.fit)

    def _shot(self, shot: str) -> dict[str, Any]:
        found = self.structure.shots[shot]
        same = {
            "id": shot, "chi2_per_pixel": found.chi2_per_pixel, "p": found.p, "p_text": found.p_text, "z": found.z,
            "worst_region": found.worst.words, "worst_z": found.worst.z,
        }  # fmt: skip
        for number, image in enumerate(self.fit.problem.images):
            if image.shot.id == shot:
                return same | self._image(number)
        number = [curve.id for curve in self.fit.problem.curves].index(shot)
        return same | self._curve(number, self.fit.residual_curves[number])

    def _image(self, number: int) -> dict[str, Any]:
        image, model_dn = self.fit.problem.images[number], np.asarray(self.fit.signals_dn[number])
        shot, used = image.shot.id, image.used
        measured, fitted = image.signal_dn[used], model_dn[used]
        level, variance = float(np.mean(fitted)), self.fit.variance_dn2(number)[used]
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
            "shift_um": list(pose.shift_um(image.pixel_um)),
            "rotation_deg": pose.rotation_deg, "saturated": image.saturated, "masked": image.masked,
            "pixel_um": image.pixel_um, "binning": image.binning, "centre_px": list(image.centre_px),
            "nuisances": self._nuisances(shot),
        }  # fmt: skip

    def _nuisances(self, shot: str) -> list[dict[str, Any]]:
        """What only this image has: values with errors; `pull`: from the mean of its prior, in its sds."""
        known = (one for one in self.fit.problem.unknowns.parameters if one.name.rpartition(".")[0] == shot)
        return [
            {
                "name": one.name.removeprefix(f"{shot}."), "value": self.fit.value(one.name),
                "error": self.fit.error(one.name) if np.isfinite(self.fit.error(one.name)) else None,
                "pull": (self.fit.value(one.name) - one.prior_mean) / one.prior_sd
                if np.isfinite(one.prior_sd) else None,
            }
            for one in known
        ]  # fmt: skip

    def _curve(self, number: int, z: Real) -> dict[str, Any]:
        curve, sigma = self.fit.problem.curves[number], self.fit.whitening.curve_sigma[number]
        difference, source = z * sigma, curve.source
        mean = float(np.mean(np.abs(curve.value))) or 1.0
        level = 100.0 if curve.is_angle else mean  # angles: percents are degrees
        of = {"sample": source.sample.id} if isinstance(source, MeasuredFarField) else {}
        if isinstance(source, MeasuredSpectrum):
            of = {"sample": source.film.id, "quantity": source.shot.quantity}
        return of | {
            "kind": "spectrum" if not curve.free_scale else "far_field", "pixels": int(curve.value.size),
            "rms_error": float(np.sqrt(np.mean(difference**2))), "noise": float(np.sqrt(np.mean(sigma**2))),
            "rms_error_percent": 100.0 * float(np.sqrt(np.mean(difference**2))) / level,
            "noise_percent": 100.0 * float(np.sqrt(np.mean(sigma**2))) / level,
            "model_noise_share": curve_noise_shares(self.fit)[curve.id],
            "unit": "deg" if curve.is_angle else "1",
        }  # fmt: skip

    def _parameters(self) -> list[dict[str, Any]]:
        """What was fitted beside the nuisances."""
        unknowns = self.fit.problem.unknowns
        names = (*unknowns.model_paths, *unknowns.other_paths)
        known = {one.name: one for one in unknowns.parameters}
        return [
            {
                "path": name, "value": self.fit.value(name), "error": error if math.isfinite(error) else None,
                "lower": known[name].lower, "upper": known[name].upper, "at_limit": name in self.fit.at_limit,
            }
            for name, error in ((name, self.fit.error(name)) for name in names)
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
        predict_curves=solver.curves_of(predictor),
        others=observed.films,
        start=observed.films_at,
        most_histories=solver.most_histories,
    )
    left = structure(found, seed=solver.seed, cache=cache)
    return Comparison(observed, found.doubted([*left.doubts, *noisy_curves(found, solver)]), left, solver)


def noisy_curves(found: Fit, solver: Solver) -> list[str]:
    """Why verdicts on far fields may not be used, whose Monte Carlo is as noisy as they are."""
    histories = max(HISTORIES, solver.histories or 0)
    doubts, alone = [], curve_noise_shares(found)
    for curve in found.problem.curves:
        share, alike = alone[curve.id], rows_alike(curve)
        if share * alike**0.5 > MOST_MODEL_NOISE:
            many = f", and {alike:.1f} of its rows have one number of it" if alike > 1.05 else ""
            wanted = float(f"{histories * alike * (share / MOST_MODEL_NOISE) ** 2:.1e}")
            doubts.append(
                f"the Monte Carlo's own noise in {curve.id} is {share:.2f} of its sigma{many}, together above"
                f" {MOST_MODEL_NOISE:g}: about {wanted:,.0f} histories would do"
            )
    return doubts


def rows_alike(curve: CurveData) -> float:
    """How many rows of a far field see one number of its Monte Carlo, on average; 1 of other curves, at least.

    The worker's bins are equal in cos(theta) and phi, and of a square module eight directions are one. What is summed
    up over so many rows errs as one of them, and the measurement's noise does not.
    """
    if not isinstance(curve.source, MeasuredFarField):
        return 1.0
    rows, columns = FAR_BINS
    table = curve.source.table
    up = np.minimum((np.cos(np.radians(table.theta_deg)) * rows).astype(int), rows - 1)
    turned = table.phi_deg % 90.0
    around = (np.minimum(turned, 90.0 - turned) * columns / 360.0).astype(int)
    return len(up) / len(np.unique(np.stack([up, around]), axis=1).T)


def curve_noise_shares(found: Fit) -> dict[str, float]:
    """Rms of the model's own noise in units of the measurement's, curve by curve."""
    sigmas = zip(found.problem.curves, found.whitening.curve_sigma, strict=True)
    return {one.id: float(np.sqrt(np.mean((sigma / one.sigma) ** 2 - 1.0))) for one, sigma in sigmas}


@dataclass(frozen=True)
class _Curves:
    """Predicts curves as the solver says: with its seed, far fields with no fewer histories than its anchors."""

    predictor: Predictor
    solver: Solver

    def spectra(self, model: Model, curves: Sequence[Curve], paths: Sequence[str] = ()) -> list[PredictedCurve]:
        return self.predictor.spectra(model, curves, paths)

    def far_fields(self, model: Model, views: Sequence[FarView], paths: Sequence[str] = ()) -> list[PredictedCurve]:
        histories = max(HISTORIES, self.solver.histories or 0)
        return self.predictor.far_fields(model, views, paths, histories, self.solver.seed)


def maps_of(found: Fit) -> dict[str, Real]:
    """Residuals of a fit in standard deviations, (row, column), 0 where unused, by shot; a curve is one row."""
    images = {image.shot.id: z for image, z in zip(found.problem.images, found.residual_images, strict=True)}
    curves = zip(found.problem.curves, found.residual_curves, strict=True)
    return images | {curve.id: z[None] for curve, z in curves}


def differing(p_of: Mapping[str, float], p: float) -> list[str]:
    """The shots that differ from the model by more than noise, from their p-values and that of all together.

    Of so many shots that an n-th of `SEEN` is below what draws can tell, those beyond all draws, where p is seen too.
    """
    level = SEEN / max(len(p_of), 1)
    if level < LEAST_P and p >= SEEN:
        return []
    return [shot for shot, own in p_of.items() if own < max(level, LEAST_P)]


def sentence_of(count: int, of: int, p: float, p_text: str, *, curves: bool) -> str:
    """The verdict in words, from how many of how many shots differ and the p-value of all together."""
    kind = "shots" if curves else "images"
    if count:
        return f"{count} of {of} {kind} differ from the model by more than noise"
    if p < SEEN:
        return f"together the {of} {kind} differ from the model by more than noise, each alone does not"
    return f"none of the {of} {kind} differs from the model by more than noise (p = {p_text})"


def region_document(region: Region) -> dict[str, Any]:
    """A region as plain values."""
    return {
        "family": region.family,
        "shot": region.shot or ALL,
        "region": region.words,
        "z": region.z,
        "log_chance": region.log_chance,
    }


def _curve_arrays(curve: CurveData, sigma: Real, z: Real) -> dict[str, Real]:
    """Columns of a curve, one entry a row."""
    table = getattr(curve.source, "table", None)
    axes = ("theta_deg", "phi_deg") if curve.free_scale else ("wavelength_nm", "aoi_deg")
    columns = {name: np.asarray(getattr(table, name), float) for name in axes}
    columns |= {"measured": curve.value, "model": curve.value - z * sigma, "sigma": sigma, "z": z}
    polarised = getattr(table, "polarisation", ())
    if len(set(polarised)) > 1:
        columns["polarisation"] = np.array(polarised)
    return {f"{curve.id}/{name}": column for name, column in columns.items()}
