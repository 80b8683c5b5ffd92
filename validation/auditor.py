"""Levels 2 and 3 of a replay of comparisons: what was told, anew from what is on record.

2 re-derive    chi2 of every image and curve from its map of residuals
3 re-decide    whether the data are still those that were compared; from the p-values of the shots: which of them
               differ, and the sentence; from the counts of draws the p-values in words; the order of families and
               regions; from the MSE of all candidates the least; verdicts and ladders (`redeciding`)
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from luxloop.audit import Compared, Place
from luxloop.errors import InputError
from luxloop.journal.image import frame_of
from luxloop.journal.reader import RunJournal
from luxloop.model_file import parse_toml
from validation.asked import COMMAND as ASKED
from validation.asked import asked_in
from validation.dataset.folder import read_dataset
from validation.dataset.manifest_file import MANIFEST
from validation.redeciding import changed_model, diagnosis, shots_in_words

ROUNDING = 1e-3
"""Relative, of chi2: maps are kept to five digits."""
NO_MAP = "no map of residuals on record"


def re_derive(journal: RunJournal, say: Callable[[Compared], None], *, same_machine: bool) -> None:
    """Compares chi2 of every image by pixel, and of every curve by value, with the residuals that it comes from.

    The same on any machine; says nothing of runs that compare nothing.
    """
    del same_machine
    maps = {frame_of(entry.data): entry.value for entry in journal.records("/map/residual")}
    for entry in journal.records("/validation"):
        step = entry.value
        if step.command == ASKED:
            continue
        compared(step.document, maps, Place(say, entry.sequence, f"{step.command} of {step.dataset_sha256[:12]}"))


def compared(document: Mapping[str, Any], maps: Mapping[str, NDArray[Any]], at: Place) -> None:
    """Compares the shots of a document with maps (row, column) by shot, in standard deviations, 0 where unused."""
    for shot in document.get("shots", []):
        what = f"chi2 per {'pixel' if shot['kind'] == 'image' else 'value'}, {shot['id']}"
        if shot["id"] not in maps:
            at.nothing(what, NO_MAP)
            continue
        z = np.asarray(maps[shot["id"]], float)
        at.near(
            what, shot["chi2_per_pixel"], float((z**2).sum() / shot["pixels"]), ROUNDING * shot["chi2_per_pixel"],
            "maps are kept to five digits",
        )  # fmt: skip


def re_decide(journal: RunJournal, say: Callable[[Compared], None], *, same_machine: bool) -> None:
    """Compares what was decided with what follows from the numbers that were told with it, and requests with ids.

    The same on any machine: nothing is computed anew but counts and orders.
    """
    del same_machine
    model = journal.attachments().get("model.toml")
    for one in asked_in(journal):
        Place(say, one.sequence, f"request {one.task_id[:12]}").exact("request, id", one.task_id, one.task.id)
    for entry in journal.records("/validation"):
        step = entry.value
        if step.command == ASKED:
            continue
        at = Place(say, entry.sequence, f"{step.command} of {step.dataset_sha256[:12]}")
        before = None if model is None else parse_toml(model.decode(), "model.toml")
        if before is not None:
            at.exact("model", step.model_sha256, before.sha256)
        same_data(step.document, step.dataset_sha256, at)
        decided(step.document, at)
        if step.command == "diagnose":
            diagnosis(step.document, at)
        if step.command in ("add", "remove"):
            changed_model(step.document, step.command, before, at)


def same_data(document: Mapping[str, Any], sha256: str, at: Place) -> bool:
    """Compares the data set with its files as they lie there now; whether they are the same."""
    folder = Path(document.get("dataset", {}).get("path", ""))
    if not (folder / MANIFEST).is_file():
        at.nothing("data set", f"there is none at {folder} any more")
        return False
    try:
        now = read_dataset(folder).sha256
    except InputError as error:
        at.exact("data set", sha256, f"{error}"[:300], str(folder))
        return False
    return at.exact("data set", sha256, now, str(folder))


def decided(document: Mapping[str, Any], at: Place) -> None:
    """Compares the decisions of a comparison's or calibration's document with its numbers."""
    structure, shots = document.get("structure"), document.get("shots", [])
    for name, one in {"all": structure, **{shot["id"]: shot for shot in shots}}.items():
        if one is not None and structure is not None and "p_text" in one:
            at.exact("p in words", one["p_text"], p_text(one["p"], structure["draws"]), name)
    for stage in document.get("stages", []):
        at.exact(f"least MSE, {stage['name']}", stage["best"], least(stage["curves"]))
    if structure is None or "regions" not in document:
        return
    at.exact("sentence", document["sentence"], shots_in_words(document, document["sentence"]))
    at.exact("trusted", document["trusted"], not document["reason"])
    z = [one["z"] for one in structure["families"]]
    # older records lack what single places and fine patterns have: there the statistic may be theirs
    others = [structure[name] for name in ("place", "pattern")] if "place" in structure else [structure["statistic"]]
    largest = max(one for one in (*z, *others) if one is not None)
    at.exact("families, the largest first", structure["statistic"], largest)
    chances = [one["log_chance"] for one in document["regions"]]
    at.exact("regions, the least likely first", chances, sorted(chances))


def p_text(p: float, draws: int) -> str:
    """How a p-value counted among draws is printed: p = (1 + b) / (1 + draws)."""
    above = round(p * (1 + draws)) - 1
    return f"{p:.2g}" if above else f"< 1/{draws}"


def least(curves: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """The candidate of the least MSE (Eq. 2) among curves of kinds of scatter."""
    rows = [(mse, one["label"], x) for one in curves for mse, x in zip(one["mse"], one["x"], strict=True)]
    mse, label, x = min(rows, key=lambda row: row[0])
    return {"label": label, "x": x, "mse": mse}
