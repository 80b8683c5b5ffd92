"""One file of a user's effect, tried: `python -m containers.effect_trial FILE`, a JSON line for each finding.

    import, spec ──▶ what its stage asks (`effect_findings`): off, acts, again, conserves ... ──▶ end

A worker starts this as a process of its own, hands it the bytes on stdin and ends it when its time is over, so that
no mistake in the file (an endless loop, an exit, too much memory) harms the worker. It is no guard against malice:
who writes the folder is trusted as the worker is. A trial ends itself, too, should its worker die.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import signal
import sys
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from containers.effect import CurveEffect, DetectorEffect, Effect, SceneEffect, StackEffect
from containers.effect_files import LIMIT_S, effect_of, module_of
from containers.effect_findings import findings_of
from luxloop.effect import EffectSpec
from luxloop.errors import InputError
from luxloop.failure import printable

MEMORY_BYTES = 8 << 30
"""Of address space: most of it is what the libraries reserve and never touch."""
CLASS_OF = {
    "stack": (StackEffect,),
    "detector": (DetectorEffect, CurveEffect),
    **dict.fromkeys(("surface", "volume", "emission", "geometry", "module"), (SceneEffect,)),
}
"""What an effect of a stage derives from."""


def main() -> None:
    """Try the file that the arguments name; its own output is dropped, the findings go to stdout."""
    words = argparse.ArgumentParser(prog="python -m containers.effect_trial", description=__doc__)
    words.add_argument("file", help="a .py file; -: its bytes come on stdin")
    words.add_argument("--name", help="of the file, where its bytes come on stdin")
    words.add_argument("--limit", type=float, default=LIMIT_S, help="seconds, after which the process ends itself")
    given = words.parse_args()
    path = Path(given.name or given.file)
    source = sys.stdin.buffer.read() if given.file == "-" else path.read_bytes()
    signal.alarm(int(given.limit) + 2)
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    out = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    for check, ok, said in trial(source, path.name):
        out.write(json.dumps({"check": check, "ok": ok, "said": printable(said)[:2000]}) + "\n")
        out.flush()
    os._exit(0)  # threads that the file left running end with it


def trial(source: bytes, file: str) -> Iterator[tuple[str, bool, str]]:
    """(what was looked at, whether it is right, what is said of it), one after the other; the last one is `end`."""
    kind, said = _tried(lambda: effect_of(module_of(source, file), Path(file).stem), file)
    yield "import", kind is not None, said or "it can be imported"
    if kind is None:
        return
    spec, said = _tried(lambda: _spec(kind), file)
    yield "spec", spec is not None, said or f"stage {spec.stage}, {len(spec.parameters)} parameters with units"
    if spec is None:
        return
    for check, look in findings_of(kind, spec):
        found, wrong = _tried(look, file)
        yield check, not wrong, wrong or str(found)
    yield "end", True, "all of it was looked at"


def _tried(look: Callable[[], Any], file: str) -> tuple[Any, str]:
    """What a look finds, or None and what went wrong, with the line of the file where it did."""
    try:
        return look(), ""
    except InputError as error:
        return None, str(error)
    except SyntaxError as error:
        return None, f"SyntaxError in line {error.lineno}: {error.msg}; mend that line"
    except BaseException as error:  # noqa: BLE001  # anybody's code: SystemExit and KeyboardInterrupt are no way out of a trial
        lines = [place.lineno for place in traceback.extract_tb(error.__traceback__) if place.filename == file]
        where = f" in line {lines[-1]}" if lines else ""
        return None, f"{type(error).__name__}{where}: {error}; mend that line" + _missing(error)


def _missing(error: BaseException) -> str:
    """What to do where a module is not there."""
    return ", or install what it imports on every worker" if isinstance(error, ImportError) else ""


def _spec(kind: type[Effect]) -> EffectSpec:
    """The description. Raises InputError for one that cannot be, or that does not fit the class."""
    spec = kind.spec()
    allowed = CLASS_OF[spec.stage]
    if not issubclass(kind, allowed):
        names = " or ".join(one.__name__ for one in allowed)
        raise InputError("stage", spec.stage, f"a class derived from {names}", "change the stage or the base class")
    if not spec.parameters:
        raise InputError("parameters", 0, "at least one", "parameter('...', unit=..., lower=..., upper=..., off=...)")
    for one in spec.parameters:
        if one.off is None and not one.shape_grid and not one.choices:
            raise InputError(one.name, None, "off=..., or a shape_grid of 3 to 7 values", "where is it absent?")
    return spec


if __name__ == "__main__":
    main()
