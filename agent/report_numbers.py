"""The numbers of a campaign's report that come from several evaluations: differences with errors, the whole grid."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from agent.recorded import Document, Told
from luxloop.campaign import Plan
from luxloop.design import Bounds, Design, DistanceFrom, SpacingIs

Estimated = Mapping[str, float]


def estimate(told: Told) -> Document:
    """Uniformity of a step with its standard error."""
    return {"value": told.step.uniformity, "standard_error": told.step.uniformity_error}


def difference(one: Document | None, other: Document | None) -> Document | None:
    """How far one design is above another, with combined errors; None where one is missing.

    Notes
    -----
    Errors add in quadrature: the two were evaluated with seeds of their own. Of the illuminances the ratio
    r = a / b, its error r sqrt((sa / a)^2 + (sb / b)^2).
    """
    if one is None or other is None:
        return None
    a, b = one["uniformity"], other["uniformity"]
    result: Document = {"uniformity": minus(a, b), "uniformity_ratio": ratio(a, b)}
    light = [row["mean_illuminance_lx"] for row in (one, other)]
    result["illuminance_ratio"] = ratio(*light) if all(light) else None
    return result


def grid_of(plan: Plan, designs: Sequence[Told]) -> Document:
    """The grid of the run's bounds, what it would take to compute all of it at the walk's cost, the walk's share."""
    bounds, environment = plan.bounds, plan.environment
    feasible = _feasible(bounds, environment.distance_from, environment.spacing_is)
    costs = [told.step.physics_s for told in designs if not told.step.cached]
    each_s = float(np.mean(costs)) if costs else None
    return {
        "designs": bounds.count,
        "feasible": feasible,
        "mean_physics_s": each_s,
        "projected_physics_s": None if each_s is None else each_s * feasible,
        "share": len(designs) / feasible if feasible else None,
    }


def _feasible(bounds: Bounds, distance_from: DistanceFrom, spacing_is: SpacingIs) -> int:
    """How many designs of the grid can be built: height and width decide for themselves."""
    low, values = bounds.low, {name: bounds.values(name) for name in Design.FIELDS}

    def count(room: str, part: str, roomy: Design) -> int:
        """Pairs that can be built: the larger the part, the larger is the least room for it."""
        first = total = 0
        for size in values[part]:
            of_size = roomy.model_copy(update={part: size})
            while first < len(values[room]):
                design = of_size.model_copy(update={room: values[room][first]})
                if design.feasibility(distance_from, spacing_is) is None:
                    break
                first += 1
            total += len(values[room]) - first
        return total

    high = bounds.high
    tall = low.model_copy(update={"spacing_um": 2.0 * high.width_um + high.spacing_um})
    wide = low.model_copy(update={"distance_um": 2.0 * high.thickness_um + high.distance_um + 100.0})
    heights = count("distance_um", "thickness_um", tall)
    return heights * count("spacing_um", "width_um", wide) * len(values["dbr_pairs"])


def minus(a: Estimated, b: Estimated) -> Document:
    """a - b with its standard error; the two are independent."""
    error = math.hypot(a["standard_error"], b["standard_error"])
    return {"value": a["value"] - b["value"], "standard_error": error}


def ratio(a: Estimated, b: Estimated) -> Document | None:
    """a / b with its standard error, None where one is 0; the two are independent."""
    if not a["value"] or not b["value"]:
        return None
    quotient = a["value"] / b["value"]
    error = quotient * math.hypot(a["standard_error"] / a["value"], b["standard_error"] / b["value"])
    return {"value": quotient, "standard_error": error}
