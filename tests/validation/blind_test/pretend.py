"""Answers and records that are made up, sealed as `blind make` seals them."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from luxloop import __version__
from luxloop.model_file import find_model
from luxloop.words import sha256_of
from validation.blind_test.bound import Chain, close
from validation.blind_test.folders import (
    ANSWERS,
    INDEX,
    SCHEMA,
    SETS,
    VERDICTS,
    Entry,
    Index,
    read_index,
    write_whole,
)
from validation.blind_test.marks import Marked
from validation.blind_test.seals import Answer, Hiding, seal


def hiding(*right: str, kind: str = "", sigma: float = 20.0, **changes: Any) -> Hiding:
    """A hidden thing, whose right answers are these."""
    return Hiding(
        kind=kind or (right[0] if right else "dust"), place="optics", amount=0.1, unit="", seed=5, right=right,
        sigma=sigma, **changes,
    )  # fmt: skip


def answer(name: str, *hidden: Hiding, **changes: Any) -> Answer:
    """What a set hides."""
    sigma = max((one.sigma for one in hidden), default=0.0)
    data = sha256_of({"id": name, "kinds": [one.kind for one in hidden]})
    values: dict[str, Any] = {
        "id": name, "hidden": hidden, "asked_sigma": sigma, "sigma": sigma, "truth": {"number": 0},
        "light": f"of-{name}", "seed": 1, "histories": 1000, "dataset_sha256": data, "seconds": 2.0,
    }  # fmt: skip
    return Answer(**(values | changes))


def record(verdict: str, *named: str, **changes: Any) -> dict[str, Any]:
    """What a diagnosis said."""
    return {
        "schema": SCHEMA, "version": __version__, "verdict": verdict,
        "sentence": f"{verdict}: {', '.join(named)}", "set": list(named), "groups": [],
        "effects": [], "added": [{"name": name} for name in named[:1]], "seconds": 30.0, "first_of_light": True,
        "structure": {"p": 0.001}, "scores_p": 0.001, "dataset_sha256": "",
        "model_sha256": find_model("paper").sha256, "seal": "", "id": "", "next_measurement": None,
        "known": 32, "among": [], "shots": [{"id": f"shot-{k}"} for k in range(6)],
        "solver": {"method": "twin", "histories": None, "seed": 1},
    } | changes  # fmt: skip


def marked(found: dict[str, Any], *hidden: Hiding, name: str = "set-1", **changes: Any) -> Marked:
    """A verdict beside an answer."""
    return Marked(Path("folder"), answer(name, *hidden, **changes), found)


def folder_of(path: Path, *sets: tuple[Answer, dict[str, Any] | None]) -> Path:
    """A folder of sets, sealed; those with a record have a verdict."""
    entries = tuple(Entry(id=one.id, light=one.light) for one, _ in sets)
    write_whole(path / INDEX, Index(plan="pretend", sets=entries).text())
    for one, found in sets:
        sealed = seal(path, path / SETS / one.id, one)
        if found is not None:
            write_whole(
                path / VERDICTS / f"{one.id}.json",
                found | {"id": one.id, "seal": sealed, "dataset_sha256": one.dataset_sha256},
            )
    return path


def bound_folder_of(path: Path, *sets: tuple[Answer, dict[str, Any] | None]) -> Path:
    """The same as `make` and `diagnose` leave it: with a root, and verdicts in a chain."""
    folder_of(path, *sets)
    close(path, read_index(path))
    return chained(path, [one.id for one, found in sets if found is not None])


def chained(path: Path, names: Iterable[str]) -> Path:
    """Put the verdicts on these sets into a chain."""
    end = Chain()
    for name in names:
        file = path / VERDICTS / f"{name}.json"
        placed = end.added(json.loads(file.read_text()))
        write_whole(file, placed)
        end = Chain(placed["number"], placed["sha256"])
    end.write(path)
    return path


def change(path: Path, **changes: Any) -> None:
    """Change a JSON file."""
    path.write_text(json.dumps(json.loads(path.read_text()) | changes))


def change_answer(folder: Path, name: str, **changes: Any) -> None:
    """Change an answer after it was sealed."""
    path = folder / ANSWERS / f"{name}.json"
    data = json.loads(path.read_text())
    data["answer"] |= changes
    path.write_text(json.dumps(data))
