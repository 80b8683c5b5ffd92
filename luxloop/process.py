"""What a process of ours knows of itself."""

from __future__ import annotations

import os


def usable_cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def resident_mb() -> float:
    """Resident memory of this process in MB; 0 where the system does not say."""
    try:
        with open("/proc/self/statm") as file:
            return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6
    except OSError:
        return 0.0


def orphaned() -> bool:
    """Whether the process that started this one, and wanted it to end with it, has gone."""
    parent = os.environ.get("LUXLOOP_WITH_PARENT", "")
    return parent.isdigit() and os.getppid() != int(parent)
