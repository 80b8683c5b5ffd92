"""A luxloop command as a process of a lab: watched, and mutated where a test wants that.

python -m tests.nemesis.launch HISTORY MUTANT|- ARGUMENTS OF LUXLOOP...
"""

from __future__ import annotations

import sys
from pathlib import Path

from luxloop.cli import main
from tests.nemesis.history import History
from tests.nemesis.mutants import MUTANTS
from tests.nemesis.witness import watch_core, watch_designer

if __name__ == "__main__":
    _, path, mutant, *argv = sys.argv
    history = History(Path(path))
    if argv[:2] == ["serve", "controller"]:
        if mutant != "-":
            MUTANTS[mutant]()
        watch_core(history)
    elif argv[0] == "campaign":
        watch_designer(history)
    sys.argv = ["luxloop", *argv]
    main()
