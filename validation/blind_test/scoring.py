"""The score of folders of blind sets, as one document: the table, who was taken for whom, what was missed."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from luxloop import __version__
from luxloop.errors import InputError
from validation.blind_test.bound import end_of, gone
from validation.blind_test.folders import read_index
from validation.blind_test.groups import GROUPS, group_of
from validation.blind_test.judged_by import judged_by
from validation.blind_test.judged_by import sentence as said_by
from validation.blind_test.left_out import no_amounts, weak_kinds
from validation.blind_test.marks import Marked, marked
from validation.blind_test.records import maps_path
from validation.blind_test.table import Confused, Row, table


def score(folders: Sequence[Path]) -> dict[str, Any]:
    """Everything that is told; seals are opened. Raises InputError as `marks.marked` does."""
    sets = marked(folders)
    rows, by = table(sets), judged_by(sets)
    first = [one for one in sets if not one.answer.follows]
    hidden = [one for one in first if not one.is_nothing and not one.is_two]
    return {
        "folders": [str(folder) for folder in folders],
        "names": names_of([str(folder) for folder in folders]),
        "sets": len(first),
        "further": len(sets) - len(first),
        "without_verdict": sum(len(read_index(folder).sets) for folder in folders) - len(sets),
        "roots": {str(folder): read_index(folder).root for folder in folders},
        "last_verdicts": {str(folder): end_of(folder, read_index(folder)) for folder in folders},
        "gone": {str(folder): gone(folder, read_index(folder)) for folder in folders},
        "codes": sorted({str(code) for one in sets if (code := one.record.get("code_sha256"))}),
        "without_code": sum(not one.record.get("code_sha256") for one in sets),
        "not_checked": sum(not one.is_checked for one in sets),
        "sentence": sentence(rows, len(first), said_by(by)),
        "by": by,
        "table": [row.document() for row in rows],
        "confusion": {
            "effects": Confused.of([(one.truth, one.said) for one in hidden]).document(),
            "groups": Confused.of([(_group(one), group_of(one.said)) for one in hidden]).document(),
        },
        "groups": {group: list(names) for group, names in GROUPS.items()},
        "misses": [one.document() for one in first if one.is_missed],
        "marks": [one.document() for one in sets],
        "too_weak": _weak(folders),
        "no_amount": sorted({kind for folder in folders for kind in no_amounts(folder)}),
        "seconds": {
            "made": _spread(one.answer.seconds for one in first),  # a further set's are those of its first
            "diagnosed": _spread(one.record["seconds"] for one in sets if one.record["first_of_light"]),
            "diagnosed_again": _spread(one.record["seconds"] for one in sets if not one.record["first_of_light"]),
        },
        "among": sorted({len(one.record["among"]) or one.record["known"] for one in sets}),
        "solvers": sorted({str(one.record["solver"]["method"]) for one in sets}),
        "versions": {"luxloop": __version__},
    }


def sentence(rows: Sequence[Row], sets: int, by: str) -> str:
    """What to say first: how many sets, by what they were judged, how many targets are met."""
    judged = [row for row in rows if row.said in ("shown", "met", "short")]
    shown, short = (sum(row.said == word for row in judged) for word in ("shown", "short"))
    return (
        f"{sets} sets, {by}: of {len(judged)} targets that they can judge {len(judged) - short} are met"
        f" ({shown} of them shown: the whole 95 % interval), {short} fall short."
    )


def names_of(folders: Sequence[str]) -> dict[str, str]:
    """Each folder by the end of its path, as long as it takes to tell all of them apart."""
    parts = {folder: Path(folder).parts for folder in folders}
    for count in range(1, max(map(len, parts.values()), default=0) + 1):
        ends = {folder: str(Path(*several[-count:])) for folder, several in parts.items()}
        if len(set(ends.values())) == len(ends):
            return ends
    return {folder: folder for folder in folders}


def maps_of(misses: Iterable[dict[str, Any]]) -> dict[str, NDArray[np.float64]]:
    """Residuals in sigma of what was missed, by "FOLDER/ID/SHOT/z" and "/z_with".

    Raises InputError for a file that is damaged.
    """
    found: dict[str, NDArray[np.float64]] = {}
    for one in misses:
        path = maps_path(Path(one["folder"]), one["id"])
        if path.exists():
            before = f"{one['folder']}/{one['id']}"
            found |= {f"{before}/{name}": array for name, array in _maps(path, one["id"]).items()}
    return found


def _maps(path: Path, name: str) -> dict[str, NDArray[np.float64]]:
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as maps:
            return {shot: maps[shot].astype(np.float64) for shot in maps}
    except (OSError, ValueError, EOFError, BadZipFile, AttributeError, TypeError) as error:
        mend = "remove the file: the page goes without, the score does not need it"
        raise InputError(f"{name}: residuals", f"{path.name}: {error}", "maps of diagnose", mend) from None


def _group(one: Marked) -> str:
    if one.is_outside:
        return f"outside: {one.answer.hidden[0].place}"
    return group_of(one.right[0])


def _weak(folders: Sequence[Path]) -> dict[str, float]:
    found: dict[str, float] = {}
    for folder in folders:
        found |= {kind: min(sigma, found.get(kind, sigma)) for kind, sigma in weak_kinds(folder).items()}
    return found


def _spread(seconds: Iterable[float]) -> dict[str, float] | None:
    several = sorted(seconds)
    if not several:
        return None
    return {"sets": len(several), "median": float(np.median(several)), "most": several[-1], "sum": sum(several)}
