"""What commands on data say beside their verdict: that the data have faults, or errors that are stated too large."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.special import gammaincinv  # scipy.stats takes a second to import

from validation.dataset.checks import check
from validation.fit.whitening import HELD_SD, SCALE_PRIOR_SD

if TYPE_CHECKING:
    from validation.fit import Fit

IMPROBABLE = 1e-4
"""The chance below which the chi2 of a shot is too small for the errors that are stated."""


def faults_of(folder: Path) -> Iterator[str]:
    """A sentence where `luxloop dataset check` finds errors in a data set; nothing where it finds none."""
    errors = [finding for finding in check(folder) if finding.level == "error"]
    if errors:
        more = f", and {len(errors) - 1} more" if len(errors) > 1 else ""
        yield f"the data have errors, so the verdict may be wrong: {errors[0]}{more}; luxloop dataset check {folder}"


def overstated_of(found: Fit, shots: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """As `overstated`, for the shots of a document on a fit: all that was fitted is counted."""
    unknowns = found.problem.unknowns
    names = [one.name for one in unknowns.parameters]
    own = [{"nuisances": [name for name in names if name.rpartition(".")[0] == shot["id"]]} for shot in shots]
    fitted = len(unknowns.model_paths) + len(unknowns.other_paths)
    return overstated([{**shot, **more} for shot, more in zip(shots, own, strict=True)], fitted)


def overstated(shots: Sequence[Mapping[str, Any]], fitted: int) -> Iterator[str]:
    """A sentence for each shot whose chi2 is improbably small; `fitted`: parameters beside a shot's own nuisances.

    The quantile of chi2 with as many degrees of freedom as values are left, the variances as much smaller as the
    verdict lets them be (`validation.fit.whitening.held_scale`).
    """
    for shot in shots:
        freedom = shot["pixels"] - len(shot.get("nuisances", ())) - fitted
        least = 2.0 * gammaincinv(max(freedom, 0) / 2.0, IMPROBABLE) * np.exp(-HELD_SD * SCALE_PRIOR_SD)
        if shot["chi2_per_pixel"] * shot["pixels"] < least:
            image, chi2 = shot["kind"] == "image", f"{shot['chi2_per_pixel']:.2g}"
            mend = "the camera's gain, read noise, frames" if image else "sigma"
            yield (
                f"{shot['id']}: chi2/{'pixel' if image else 'value'} is {chi2} where noise leaves about 1: errors are"
                f" stated too large, which hides what the model lacks; look at {mend}"
            )
