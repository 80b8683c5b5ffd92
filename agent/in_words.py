"""A step as plain values, and plain values as a line for a person."""

from __future__ import annotations

from typing import Any

from luxloop.campaign import Step
from luxloop.design import Design


def plain(step: Step | None) -> dict[str, Any] | None:
    """What a person or a program wants to know of a step; None for none."""
    if step is None:
        return None
    return {
        "design": step.design.model_dump(),
        "uniformity": step.uniformity,
        "uniformity_error": step.uniformity_error,
        "figures": step.figures,
        "feasible": step.feasible,
        "final": step.final,
        "lane": step.lane,
        "number": step.number,
        "failure": step.failure.text() if step.failure else "",
    }


def line(one: dict[str, Any] | None) -> str:
    """Uniformity and mean illuminance with their errors, the design; why there are none."""
    if one is None:
        return "-"
    if one["failure"]:
        return f"failed: {one['failure']}"
    design = Design(**one["design"])
    if not one["feasible"]:
        return f"cannot be built: {design}"
    lux = one["figures"].get("mean_illuminance_lx")
    light = f", {lux['value']:,.0f} +- {lux['standard_error']:,.0f} lx" if lux else ""
    return f"{100.0 * one['uniformity']:.2f} +- {100.0 * one['uniformity_error']:.2f} %{light}  {design}"
