"""Copies what a run of the blind test has on record: its index; seals, answers and verdicts of sets with a verdict.

    python -m benchmarks.blind_records RUN docs/blind/NAME

`luxloop blind score` counts the copies as it counts the run. Images and residuals stay behind, and so do answers of
sets that nobody has judged yet.
"""

from __future__ import annotations

import argparse
import shutil
from collections.abc import Sequence
from pathlib import Path

from luxloop.errors import InputError
from validation.blind_test.folders import (
    ANSWERS,
    ASKED,
    CHAIN,
    INDEX,
    OPENED,
    SEAL,
    SETS,
    VERDICTS,
    WEAK,
    read_index,
    write_whole,
)
from validation.blind_test.records import record_path


def keep(run: Path, into: Path) -> int:
    """How many sets are now in `into`. Raises InputError where no set has a verdict, or `into` has another run's."""
    index = read_index(run)
    judged = tuple(one for one in index.sets if record_path(run, one.id).exists())
    if not judged:
        raise InputError("RUN", str(run), "a run with verdicts", f"luxloop blind diagnose {run}")
    there = read_index(into).sets if into.exists() else ()
    for name in [f"{VERDICTS}/{one.id}.json" for one in there if record_path(into, one.id).exists()]:
        if not (run / name).exists() or (run / name).read_bytes() != (into / name).read_bytes():
            raise InputError("INTO", str(into), "a new folder, or one with records of this run", "name another")
    others = [CHAIN, *(f"{OPENED}/{one.id}.json" for one in judged)]
    if len(judged) == len(index.sets):  # seed and code open all seals, those of sets without a verdict, too
        others += [f"{ANSWERS}/{ASKED}", f"{ANSWERS}/{WEAK}"]
    names = [name for name in others if (run / name).exists()]
    for one in judged:
        names += [f"{SETS}/{one.id}/{SEAL}", f"{ANSWERS}/{one.id}.json", f"{VERDICTS}/{one.id}.json"]
    for name in names:
        (into / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(run / name, into / name)
    write_whole(into / INDEX, index.text())
    return len(judged)


def main(argv: Sequence[str] | None = None) -> None:
    """Copy them; exit code 2 and a sentence where that cannot be."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path)
    parser.add_argument("into", type=Path)
    asked = parser.parse_args(argv)
    try:
        kept = keep(asked.run, asked.into)
    except InputError as error:
        parser.error(str(error))
    print(f"{asked.into}: {kept} sets with verdicts")


if __name__ == "__main__":
    main()
