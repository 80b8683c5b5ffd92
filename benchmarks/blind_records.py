"""Copies what a run of the blind test has on record: index, seals, answers and verdicts, of sets with a verdict only.

    python -m benchmarks.blind_records RUN docs/blind/NAME

`luxloop blind score` counts the copies as it counts the run. Images and residuals stay behind, and so do answers of
sets that nobody has judged yet.
"""

from __future__ import annotations

import argparse
import shutil
from pathlib import Path

from luxloop.errors import InputError
from validation.blind_test.folders import ANSWERS, INDEX, SEAL, SETS, VERDICTS, read_index, write_whole
from validation.blind_test.judging import record_path
from validation.blind_test.making import ASKED, WEAK


def keep(run: Path, into: Path) -> int:
    """How many sets are now in `into`. Raises InputError where no set has a verdict, or `into` has another run's."""
    index = read_index(run)
    judged = tuple(one for one in index.sets if record_path(run, one.id).exists())
    if not judged:
        raise InputError("RUN", str(run), "a run with verdicts", f"luxloop blind diagnose {run}")
    for name in [f"{VERDICTS}/{one.id}.json" for one in read_index(into).sets] if into.exists() else []:
        if not (run / name).exists() or (run / name).read_bytes() != (into / name).read_bytes():
            raise InputError("INTO", str(into), "a new folder, or one with records of this run", "name another")
    names = [f"{ANSWERS}/{name}" for name in (ASKED, WEAK) if (run / ANSWERS / name).exists()]
    for one in judged:
        names += [f"{SETS}/{one.id}/{SEAL}", f"{ANSWERS}/{one.id}.json", f"{VERDICTS}/{one.id}.json"]
    for name in names:
        (into / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(run / name, into / name)
    write_whole(into / INDEX, index.model_copy(update={"sets": judged}).text())
    return len(judged)


def main() -> None:
    """Copy them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path)
    parser.add_argument("into", type=Path)
    asked = parser.parse_args()
    print(f"{asked.into}: {keep(asked.run, asked.into)} sets with verdicts")


if __name__ == "__main__":
    main()
