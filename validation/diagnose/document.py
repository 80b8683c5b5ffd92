"""A diagnosis as plain values: what `diagnose --json` prints, pages draw and journals keep."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from luxloop import __version__
from validation.contrasts.structure import Structure
from validation.diagnose.explanation import Explanation
from validation.diagnose.in_words import limits
from validation.diagnose.proposal import Proposal
from validation.diagnose.rounds import Diagnosis, Step
from validation.fit import Fit
from validation.sample_values import LEAD

REGIONS = 8


def document(found: Diagnosis, seed: int) -> dict[str, Any]:
    """Of the whole diagnosis; of its first round in detail, of the others what they added."""
    first = found.steps[0]
    return {
        "verdict": found.verdict.word,
        "sentence": found.verdict.sentence,
        "structure": structure_document(first.ground.structure),
        "effects": [effect_document(first, one) for one in ranked(first)],
        "scores": [
            {
                "name": one.name, "stage": one.largest.candidate.effect.stage, "z": one.largest.z, "p": one.p,
                "chi2_drop": one.largest.drop, "size": one.largest.size, "error": finite(one.largest.error),
                "score_variable": one.largest.candidate.parameter.score_variable,
                "parameter": one.largest.candidate.words, "left": one.largest.left,
            }
            for one in first.scores.effects
        ],
        "scores_p": first.scores.p,
        "untestable": list(first.scores.untestable),
        "set": list(found.set),
        "rivals": list(first.verdict.rivals) if found.verdict.names else [],
        "groups": [list(group) for group in first.confounding.groups if len(group) > 1],
        "confounding": {
            "names": [first.confounding.names[k] for k in first.confounding.order],
            "cosines": [
                [float(first.confounding.cosines[i, j]) for j in first.confounding.order]
                for i in first.confounding.order
            ],
        },
        "added": [
            {"name": one.best.name, "size": one.best.size, "p_left": one.best.p_left, "share": one.best.share.value,
                "share_error": finite(one.best.share.error), "leads_on": one.leads_to is not None,
                "rivals": list(one.verdict.rivals),
                "beside": None if one.beside is None else list(one.beside)}
            for one in found.steps if one.verdict.names
        ],
        "next_measurement": _next(found.proposals),
        "candidates": [one.document() for one in found.proposals],
        "limits": [
            {"name": name, "parameter": parameter, "value": value, "unit": unit}
            for name, parameter, value, unit in limits(first.scores)
        ],
        "known": found.known,
        "distrust": list(first.ground.fit.distrust),
        "shots": shot_documents(first.ground.fit),
        "parameters": parameters_document(found),
        "seed": seed,
        "versions": {"luxloop": __version__},
    }  # fmt: skip


def shot_documents(fit: Fit) -> list[dict[str, Any]]:
    """The images and the curves of a fit, and what is left in them."""
    images = [
        {
            "id": image.shot.id, "kind": "image", "sample": image.sample.id, "pixel_um": image.pixel_um,
            "dbr_pairs": image.sample.dbr_pairs, "centre_px": list(image.centre_px), "binning": image.binning,
            "shift_um": list(fit.poses[image.shot.id].shift_um(image.pixel_um)),
            "pixels": int(image.used.sum()), "chi2_per_pixel": float(np.sum(z**2)) / int(image.used.sum()),
        }
        for image, z in zip(fit.problem.images, fit.residual_images, strict=True)
    ]  # fmt: skip
    curves = [
        {
            "id": curve.id, "kind": "far_field" if curve.free_scale else "spectrum", "pixels": int(curve.value.size),
            "chi2_per_pixel": float(np.mean(z**2)),
        }
        for curve, z in zip(fit.problem.curves, fit.residual_curves, strict=True)
    ]  # fmt: skip
    return images + curves


def structure_document(found: Structure) -> dict[str, Any]:
    """What is left before any effect is added, and where."""
    return {
        "p": found.p, "p_text": found.p_text, "z": found.z, "statistic": found.statistic, "draws": found.draws,
        "where": [
            {"shot": one.shot or "all images", "family": one.family, "region": one.words, "z": one.z}
            for one in found.where[:REGIONS]
        ],
    }  # fmt: skip


def ranked(step: Step) -> list[Explanation]:
    """Effects that were added, those that may be first."""
    return sorted(step.explanations, key=lambda one: (not one.plausible, -one.drop))


def effect_document(step: Step, one: Explanation) -> dict[str, Any]:
    """What an effect came to."""
    score = step.scores.of(one.name)
    spec = score.best.candidate.effect if score is not None else None
    held = one.held_out
    before, after = one.held_out_percent or (None, None)
    return {
        "name": one.name,
        "stage": spec.stage if spec is not None else "",
        "size": {one.parameter: {"value": one.value, "error": finite(one.error), "unit": one.unit}},
        "shape": dict(one.shape),
        "fits_as_well": [list(words) for words in one.as_well],
        "chi2_drop": one.drop,
        "explained_share": one.share.value,
        "explained_share_error": finite(one.share.error),
        "held_out_before": before,
        "held_out_after": after,
        "held_out_density_change": None if held is None else held.value,
        "held_out_density_error": None if held is None else held.error,
        "log_evidence": one.log_evidence,
        "plausible": one.plausible,
        "why_not": one.why_not,
        "at_end": one.at_end,
        "has_members": one.has_members,
        "by_place": one.by_place,
        "distrust": list(one.distrust),
        "p_left": one.p_left,
        "sigma": one.sigma,
        "sigma_rival": one.sigma_rival,
        "numbers": one.numbers,
        "group": [name for name in step.confounding.group_of(one.name) if name != one.name],
    }


def parameters_document(found: Diagnosis) -> list[dict[str, Any]]:
    """The model's own parameters without any effect and with the best one: where they move back to."""
    first = found.steps[0]
    fit = first.ground.fit
    best = first.kept if found.verdict.names else None
    rows = []
    for path in (path for path in fit.problem.unknowns.model_paths if not path.startswith(LEAD)):
        limits_at = fit.model.fit[path]
        row = {
            "path": path, "value": fit.value(path), "error": finite(fit.error(path)),
            "at_limit": path in fit.at_limit,
            "prior_mean": limits_at.prior_mean, "prior_sd": limits_at.prior_sd, "with": None, "with_error": None,
        }  # fmt: skip
        if best is not None and best.fit is not None:
            row |= {"with": best.fit.value(path), "with_error": finite(best.fit.error(path))}
        rows.append(row)
    return rows


def finite(value: float) -> float | None:
    """JSON has no infinity: an error that is not known is null."""
    return value if math.isfinite(value) else None


def _next(proposals: Sequence[Proposal]) -> dict[str, Any] | None:
    if not proposals:
        return None
    best = proposals[0]
    return {
        "sample": best.sample.model_dump(mode="json", exclude_defaults=True), "words": best.words,
        "exposure_ratio": best.exposure_ratio, "expected_sigma": best.expected_sigma, "now_sigma": best.now_sigma,
        "stanza": best.document()["stanza"],
    }  # fmt: skip
