"""By what verdicts were given: model, solver, effects to choose from. Unlike ones are no sample of one thing."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from luxloop.model_file import SHIPPED, find_model
from validation.blind_test.marks import Marked


def judged_by(sets: Sequence[Marked]) -> list[dict[str, Any]]:
    """Each way in which verdicts were given, the most frequent first, with how many sets have it."""
    found = Counter(words_of(one.record) for one in sets)
    return [{"by": words, "sets": count} for words, count in found.most_common()]


def sentence(by: Sequence[Mapping[str, Any]]) -> str:
    """What to say first: one way, or that verdicts are unlike, and all ways."""
    if len(by) == 1:
        return f"by {by[0]['by']}"
    return "UNLIKE verdicts, " + "; ".join(f"{one['sets']} by {one['by']}" for one in by)


def words_of(record: Mapping[str, Any]) -> str:
    """Model, solver with its seed, and the effects to choose from, of a verdict."""
    solver, among = record["solver"], sorted(record["among"])
    how = "the twin" if solver["method"] == "twin" else f"Monte Carlo of {solver['histories']:,} histories"
    most = solver.get("most_histories")
    how += f" (the last anchor up to {most:,})" if most else ""
    effects = f"{len(among)} chosen effects ({', '.join(among)})" if among else f"all {record['known']} effects"
    known = f"with priors of each set, {how}, a seed of each light by" if record.get("fit_sha256") else f"{how},"
    return f"{_model(str(record['model_sha256']))}, {known} seed {solver['seed']}, {effects}"


def _model(sha256: str) -> str:
    """The name of a model that luxloop ships; the hash of another one."""
    name = next((name for name in SHIPPED if find_model(name).sha256 == sha256), sha256[:12])
    return f"model {name}"
