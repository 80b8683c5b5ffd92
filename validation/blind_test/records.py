"""Verdicts on record: where they lie, and that what is read is whole and of this version."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from luxloop.errors import InputError
from validation.blind_test.folders import VERDICTS, of_this_version, read_json

FIELDS: Mapping[str, tuple[type, ...]] = {
    "id": (str,), "verdict": (str,), "sentence": (str,), "seal": (str,), "dataset_sha256": (str,),
    "model_sha256": (str,),
    "shots": (list,), "set": (list,), "groups": (list,), "effects": (list,), "added": (list,), "among": (list,),
    "known": (int,), "structure": (dict,), "solver": (dict,), "seconds": (int, float), "first_of_light": (bool,),
    "scores_p": (int, float, type(None)), "next_measurement": (dict, type(None)),
}  # fmt: skip
"""Of a record, what marks and table read."""
WITHIN: Mapping[str, tuple[str, ...]] = {
    "effects": ("name", "size", "held_out_before", "held_out_after"), "added": ("name",),
}  # fmt: skip
"""Of each row in a list of a record."""
MEND = "the file is damaged: put it back as diagnose wrote it"


def record_path(folder: Path, name: str) -> Path:
    """Where the verdict on a set lies."""
    return folder / VERDICTS / f"{name}.json"


def maps_path(folder: Path, name: str) -> Path:
    """Where the residuals of a set lie."""
    return folder / VERDICTS / f"{name}.npz"


def read_record(folder: Path, name: str) -> dict[str, Any]:
    """The verdict on a set. Raises InputError where there is none, of another version, or a damaged one."""
    field, path = f"{name}: verdict", record_path(folder, name)
    record = read_json(path, field, "a verdict on record", f"luxloop blind diagnose {folder}")
    of_this_version(record, field, "a verdict")
    _check(record, field)
    return record


def _check(record: Mapping[str, Any], field: str) -> None:
    for name, kinds in FIELDS.items():
        if not isinstance(record.get(name, ...), kinds):
            words = " or ".join("null" if kind is type(None) else kind.__name__ for kind in kinds)
            raise InputError(f"{field}: {name}", record.get(name), words, MEND)
    for name, wanted in WITHIN.items():
        for row in record[name]:
            if not isinstance(row, dict) or not set(wanted) <= set(row):
                raise InputError(f"{field}: {name}", row, f"rows with {', '.join(wanted)}", MEND)
    if not {"p"} <= set(record["structure"]) or not _is_solver(record["solver"]):
        allowed = "structure with p, solver with method and seed, and histories where it is no twin"
        raise InputError(field, "structure or solver", allowed, MEND)
    if record["verdict"] in ("one_effect", "cannot_tell_apart") and not record["set"]:
        raise InputError(f"{field}: set", record["set"], f"names, for the verdict is {record['verdict']}", MEND)


def _is_solver(solver: Mapping[str, Any]) -> bool:
    return {"method", "seed"} <= set(solver) and (
        solver["method"] == "twin" or isinstance(solver.get("histories"), int)
    )
