"""The user's own effects: files of a folder, each tried in a process of its own before it is used.

    file ──read once──▶ bytes ──▶ SHA-256 ──▶ tried in a fresh process ──▶ executed here, the same bytes
                                     └──▶ a verdict that is remembered, in this worker and under LUXLOOP_CACHE

What fails is refused with a sentence that names the file, the reason and the mend; the worker goes on. A file that
was refused is tried again once it is saved again; one that was accepted is accepted wherever its bytes are.

A trial is against mistakes, not malice: whoever writes to the folder is trusted as the worker itself is. Trial and
worker are of one user; a file may start what outlives its trial, and is executed in the worker once it is accepted.
"""

from __future__ import annotations

import hashlib
import importlib.util
import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Mapping, Set
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any

from containers.effect import Effect
from containers.reporting import Report, nothing
from luxloop import __version__
from luxloop.effect import EffectSpec
from luxloop.errors import InputError
from luxloop.failure import printable
from luxloop.words import sha256_of

MOST_BYTES = 256 << 10
MOST_FILES = 100
LIMIT_S = 20.0
"""Of one trial."""
LOOK_S = 0.25
"""How often is looked whether the trial's result is still wanted."""
OF_KERNELS = ("LUXLOOP_CACHE", "LUXLOOP_KERNELS")
"""Of the worker's own settings, what a trial is told: where compiled kernels lie."""
RULES = 1
"""Of the trial: a verdict that other rules gave is not remembered."""
NAME = re.compile(r"[a-z][a-z0-9_]{0,63}")
CHECK = "luxloop effects check"


@dataclass(frozen=True)
class Trial:
    """What came of trying a file: a line for each thing that was looked at, and why it is refused ("": it is not)."""

    sha256: str
    findings: tuple[Mapping[str, Any], ...] = ()
    refused: str = ""
    saved_ns: int = 0
    """When the file was saved: one that was refused is tried again when it is saved again."""


@dataclass(frozen=True)
class Own:
    """A user's own effect, with the hash of its source in its description."""

    spec: EffectSpec
    kind: type[Effect]


@dataclass(frozen=True)
class Loaded:
    """What a folder holds: effects by name; by file name what came of the trials, and why one is not used."""

    known: dict[str, Own] = field(default_factory=dict)
    trials: dict[str, Trial] = field(default_factory=dict)
    refused: dict[str, str] = field(default_factory=dict)


def load_folder(
    folder: Path, before: Loaded, taken: Set[str], limit_s: float = LIMIT_S, report: Report = nothing
) -> Loaded:
    """The effects of a folder; what is as it was in `before` is kept, names in `taken` are refused.

    Files whose names begin with _ or . are no effects. What cannot be used is refused; nothing is raised but what the
    report raises, which is called while trials run.
    """
    found = Loaded()
    paths = [path for path in sorted(folder.glob("*.py")) if path.name[0] not in "._"]
    for number, path in enumerate(paths):
        name = printable(path.name)
        if number >= MOST_FILES:
            found.refused[name] = f"{name}: more than {MOST_FILES} files; take some out of the folder"
            continue
        try:
            _load(path, before, taken, found, limit_s, report)
        except InputError as error:
            found.refused[name] = printable(f"{name}: {error}")
    return found


def _load(path: Path, before: Loaded, taken: Set[str], found: Loaded, limit_s: float, report: Report) -> None:
    """Put one file into what was found."""
    if not NAME.fullmatch(path.stem):
        raise InputError("file name", path.name, "small letters, digits and _, such as my_haze.py", "rename it")
    if path.stem in taken:
        raise InputError("name", path.stem, "a name that no effect of the catalogue has", "rename file and effect")
    source, saved_ns = _read(path)
    sha256 = hashlib.sha256(source).hexdigest()
    own, trial = before.known.get(path.stem), before.trials.get(path.name)
    if trial is None or trial.sha256 != sha256 or (trial.refused and trial.saved_ns != saved_ns):
        own, trial = None, tried(source, path.name, saved_ns, limit_s, report)
    found.trials[path.name] = trial
    if trial.refused:
        found.refused[path.name] = trial.refused
    else:
        found.known[path.stem] = own or _own(source, path.name, sha256)


def _read(path: Path) -> tuple[bytes, int]:
    """The bytes of a file and when it was saved. Raises InputError where it is no file, or too large a one."""
    try:
        with path.open("rb") as file:
            saved_ns = os.fstat(file.fileno()).st_mtime_ns
            source = file.read(MOST_BYTES + 1)
    except OSError as error:
        raise InputError("file", error.strerror or str(error), "a file that can be read", "mend that") from error
    if len(source) > MOST_BYTES:
        raise InputError("size", f"over {MOST_BYTES} bytes", f"at most {MOST_BYTES} bytes", "an effect is 20 lines")
    return source, saved_ns


def _own(source: bytes, file: str, sha256: str) -> Own:
    """The effect of a file that passed its trial. Raises InputError where it now fails after all."""
    try:
        kind = effect_of(module_of(source, file), Path(file).stem)
        return Own(kind.spec().model_copy(update={"source_sha256": sha256}), kind)
    except InputError:
        raise
    except (Exception, SystemExit) as error:  # anybody's code; what worked in the trial may fail where it is used
        mend = f"it worked in its trial: {CHECK} {Path(file).stem}"
        raise InputError("import", f"{type(error).__name__}: {error}"[:300], "no exception", mend) from error


def module_of(source: bytes, file: str) -> ModuleType:
    """The module that these bytes are, executed. Raises what they raise."""
    name = f"luxloop_effects.{Path(file).stem}_{hashlib.sha256(source).hexdigest()[:16]}"
    module = ModuleType(name)
    module.__spec__ = importlib.util.spec_from_loader(name, None)
    module.__file__ = file
    sys.modules[name] = module  # where pydantic looks annotations up
    try:
        exec(compile(source, file, "exec"), vars(module))  # noqa: S102  # the user's own file, tried before
    except BaseException:
        del sys.modules[name]
        raise
    return module


def effects_in(module: ModuleType) -> list[type[Effect]]:
    """The effects that a module defines, in the order of their lines."""
    return [
        one
        for one in vars(module).values()
        if isinstance(one, type) and issubclass(one, Effect) and one.__module__ == module.__name__
    ]


def effect_of(module: ModuleType, name: str) -> type[Effect]:
    """The one effect of a module. Raises InputError where there is not one, or its name is not the file's."""
    kinds = list(dict.fromkeys(effects_in(module)))
    if len(kinds) != 1:
        names = ", ".join(kind.__name__ for kind in kinds) or "none"
        raise InputError(
            "effects in it",
            names,
            "one class, derived from an effect of containers.effect",
            "see luxloop effects new",
        )
    if getattr(kinds[0], "name", None) != name:
        mend = f'write name = "{name}", or rename the file'
        raise InputError(f"{kinds[0].__name__}.name", getattr(kinds[0], "name", None), f"the file's, {name!r}", mend)
    return kinds[0]


# Trials, and verdicts that are remembered


def tried(source: bytes, file: str, saved_ns: int = 0, limit_s: float = LIMIT_S, report: Report = nothing) -> Trial:
    """What comes of trying these bytes in a fresh process; an accepted file's verdict is remembered on disk.

    Refusals are not: what was missing may be installed, and what was slow may have had a busy machine. What the
    report raises ends the trial.
    """
    sha256 = hashlib.sha256(source).hexdigest()
    verdict = _verdict_file(sha256, file)
    if verdict is not None and (findings := _remembered(verdict)) is not None:
        return Trial(sha256, findings, "", saved_ns)
    findings, ended = _in_a_fresh_process(source, file, limit_s, report)
    trial = Trial(sha256, findings, _why_refused(findings, ended, file), saved_ns)
    if verdict is not None and not trial.refused:
        _remember(verdict, findings)
    return trial


def _in_a_fresh_process(
    source: bytes, file: str, limit_s: float, report: Report
) -> tuple[tuple[Mapping[str, Any], ...], str]:
    """The findings that the trial printed, and how it ended ("": as it should)."""
    command = [sys.executable, "-m", "containers.effect_trial", "-", "--name", file, "--limit", str(limit_s)]
    with subprocess.Popen(
        command,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=_environment(),
        process_group=0,  # ended with what it started in this group
    ) as process:
        try:
            printed, ended = _printed(process, source, limit_s, report)
        finally:
            _end(process)
    if not ended and process.returncode:
        ended = f"the process ended with code {process.returncode}"
    return tuple(_lines(printed)), ended


def _printed(process: subprocess.Popen[bytes], source: bytes, limit_s: float, report: Report) -> tuple[bytes, str]:
    """What a trial printed of these bytes, and why it was ended ("": it was not)."""
    until_s, given = time.monotonic() + limit_s, {"input": source}
    ended = ""
    while True:
        report()
        left_s = until_s - time.monotonic()
        if left_s <= 0.0:
            ended = f"no end after {limit_s:g} s"
            _end(process)
        try:
            return process.communicate(**given, timeout=LOOK_S if ended else min(left_s, LOOK_S))[0], ended
        except subprocess.TimeoutExpired:
            given = {}  # it has the rest of them


def _environment() -> dict[str, str]:
    """What a trial is told of this process's environment: of the worker's own settings no more than it needs."""
    kept = {
        name: value for name, value in os.environ.items() if not name.startswith("LUXLOOP_") or name in OF_KERNELS
    }
    return kept | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


def _end(process: subprocess.Popen[bytes]) -> None:
    """End a trial and what it started in its process group, where anything of it is left."""
    try:
        os.killpg(process.pid, signal.SIGKILL)
    except (ProcessLookupError, PermissionError):
        return


def _lines(printed: bytes) -> list[Mapping[str, Any]]:
    """Findings, one JSON object in a line; a line that was cut off is left out."""
    found: list[Mapping[str, Any]] = []
    for line in printed.splitlines():
        try:
            finding = json.loads(line)
        except ValueError:
            continue
        if isinstance(finding, dict) and {"check", "ok", "said"} <= finding.keys():
            found.append(finding)
    return found


def _why_refused(findings: tuple[Mapping[str, Any], ...], ended: str, file: str) -> str:
    """A sentence with the file, the reason and the mend; "" where nothing is wrong."""
    bad = next((one for one in findings if not one["ok"]), None)
    if bad is not None:
        return printable(f"{file}: {bad['check']}: {bad['said']}")[:2000]
    if ended or not findings or findings[-1]["check"] != "end":
        after = f" after {findings[-1]['check']!r}" if findings else " while it was imported"
        return f"{file}: {ended or 'the trial ended too early'}{after}; mend the loop or the exit there, then save it"
    return ""


def _verdict_file(sha256: str, file: str) -> Path | None:
    """Where an accepted file's findings are kept, by its bytes, its name and the release; None without a cache."""
    cache = os.environ.get("LUXLOOP_CACHE")
    key = sha256_of({"source": sha256, "file": file, "release": __version__, "rules": RULES})
    return Path(cache) / "effects" / f"{key}.json" if cache else None


def _remembered(verdict: Path) -> tuple[Mapping[str, Any], ...] | None:
    try:
        findings = tuple(_lines(verdict.read_bytes()))
    except OSError:
        return None
    return None if _why_refused(findings, "", verdict.name) else findings


def _remember(verdict: Path, findings: tuple[Mapping[str, Any], ...]) -> None:
    """Keep what was found; a cache that cannot be written costs a second trial, no more."""
    part = verdict.with_suffix(f".{os.getpid()}")
    try:
        verdict.parent.mkdir(parents=True, exist_ok=True)
        part.write_text("".join(json.dumps(one) + "\n" for one in findings), encoding="utf-8")
        part.replace(verdict)
    except OSError:
        return
