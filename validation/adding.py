"""What `add` and `remove` do to a model, without files and commands: the fit before, the fit after, what is told."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from luxloop.model_file import diff, to_toml
from luxloop.units import unit_of
from validation.diagnose.document import finite, shot_documents
from validation.diagnose.ladder import BEFORE, Rung
from validation.sample_values import members, without

if TYPE_CHECKING:
    from luxloop.model import Model
    from validation.diagnose.ground import Ground
    from validation.diagnosing import Diagnosing
    from validation.fit import Fit


def changed(engine: Diagnosing, command: str, effect: str) -> tuple[Ground, Ground]:
    """The fits before and after an effect was added, or removed, with their structures."""
    if command == "add":
        spec = engine.spec(effect)
        before = engine.ground(engine.fitted(engine.model))
        return before, engine.ground(engine.added(before.fit, spec))
    before = engine.ground(engine.fitted(engine.model))
    return before, engine.ground(engine.fitted(without(engine.model, effect)))


def told_of(model: Model, before: Ground, after: Ground) -> dict[str, Any]:
    """What came of it, as plain values; `model`: as it was."""
    by_sample = bool(before.fit.model.samples or after.fit.model.samples)
    rungs = Rung.of(before, by_sample), Rung.of(after, by_sample)
    return {
        "before": vars(rungs[0]),
        "after": vars(rungs[1]),
        "errors": rungs[1].errors() | rungs[0].errors(BEFORE),
        "trusted": after.fit.trusted,
        "reason": "; ".join(after.fit.distrust),
        "fitted": _fitted(after.fit),
        "shots": shot_documents(after.fit),
        "diff": [str(one) for one in diff(model, after.fit.model)],
        "after_sha256": after.fit.model.sha256,
        "after_model": to_toml(after.fit.model),
    }


def _fitted(found: Fit) -> list[dict[str, Any]]:
    own = {path: member for path, (member, _) in members(found.model).items()}
    return [
        {
            "path": path, "value": found.value(path), "error": finite(found.error(path)),
            "unit": unit_of(own[path].parameter if path in own else path),
            "group": own[path].path.rpartition(".")[0] if path in own and own[path].chip is not None else None,
        }
        for path in found.problem.unknowns.model_paths
    ]  # fmt: skip
