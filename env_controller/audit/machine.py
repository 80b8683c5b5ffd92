"""Where the controller runs, for the journal's metadata: what decides the last bits of a result, and no name.

Of the host and its processor there are short digests: whether two runs come from the same one can be seen, which one
cannot be read (a name that is guessed can be tried, as with every digest of a short text).
"""

from __future__ import annotations

import os
import platform
import sys
from collections.abc import Mapping
from contextlib import suppress
from hashlib import sha256
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

PACKAGES = ("numpy", "numba", "llvmlite", "torch", "pydantic", "eclipse-zenoh", "mcap", "protobuf")
BITS = ("python", "system", "processor", "numpy", "numba", "llvmlite", "torch")
"""What may change the last bits of a result; where all are equal, equal bits may be demanded."""
DIGITS = 12


def machine() -> dict[str, str]:
    """Facts about this process's environment, by name."""
    facts = {
        "python": sys.version.split()[0],
        "system": f"{platform.system()} {' '.join(platform.libc_ver())}".strip(),
        "processor": f"{platform.machine()} {_digest(_abilities())}".strip(),
        "cores": str(os.cpu_count() or 0),
        "host": _digest(platform.node()),
        "pid": str(os.getpid()),
    }
    return facts | {name: _version(name) for name in PACKAGES}


def other_bits(logged: Mapping[str, str]) -> dict[str, tuple[str, str]]:
    """What may change last bits and differs from the record's facts: by name, logged and now."""
    now = machine()
    return {name: (logged.get(name, "unknown"), now[name]) for name in BITS if logged.get(name) != now[name]}


def _abilities() -> str:
    """What the processor can do, as the system says: numpy and torch choose their kernels by it."""
    with suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.lower().startswith(("flags", "features")):
                return " ".join(sorted(line.partition(":")[2].split()))
    return platform.processor()


def _digest(text: str) -> str:
    return sha256(text.encode()).hexdigest()[:DIGITS] if text else ""


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"
