"""Where the controller runs, for the journal's metadata: Python, packages, system."""

from __future__ import annotations

import os
import platform
import sys
from importlib.metadata import PackageNotFoundError, version

PACKAGES = ("numpy", "pydantic", "eclipse-zenoh", "mcap", "protobuf")


def machine() -> dict[str, str]:
    """Facts about this process's environment, by name."""
    facts = {
        "python": sys.version.split()[0],
        "system": platform.platform(),
        "processor": platform.machine(),
        "cores": str(os.cpu_count() or 0),
        "host": platform.node(),
        "pid": str(os.getpid()),
    }
    return facts | {name: _version(name) for name in PACKAGES}


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"
