"""This host: what is installed, room on its disks, what the system lets a process have."""

from __future__ import annotations

import os
import resource
import shutil
import sys
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from env_controller.health.finding import Finding
from luxloop import __version__
from luxloop.errors import InputError
from luxloop.process import usable_cores
from luxloop.settings import Settings, usable_cache

PACKAGES = ("eclipse-zenoh", "numpy", "pydantic", "cryptography")
OPTIONAL = {
    "numba": "workers", "torch": "designer", "gymnasium": "designer", "matplotlib": "viewer", "scipy": "validation",
    "tifffile": "validation",
}  # fmt: skip
DISK_GB = 1.0
SHARED_MB = 16.0
OPEN_FILES = 1024
"""A router has one open file for each session, a worker some dozens."""
MEMORY_MB = 512.0
"""An idle set of four processes has about 650 MB, the largest of them 260 MB."""
CGROUP_LIMITS = ("memory.max", "memory/memory.limit_in_bytes")  # of version 2, of version 1


def packages() -> Iterator[Finding]:
    """Which releases are installed here."""
    yield Finding("luxloop", "ok", f"{__version__} on Python {sys.version.split()[0]}, {usable_cores()} cores")
    for name in (*PACKAGES, *OPTIONAL):
        try:
            yield Finding(name, "ok", version(name))
        except PackageNotFoundError:
            extra = OPTIONAL.get(name)
            mend = f"pip install 'luxloop[{extra}]'" if extra else "pip install luxloop"
            yield Finding(name, "warn" if extra else "fail", "not installed", mend)


def disk(settings: Settings) -> Iterator[Finding]:
    """Whether the cache folder can be used and has room."""
    try:
        folder = usable_cache(settings)
    except InputError as error:
        yield Finding("cache folder", "fail", f"{error.value} is not {error.allowed}", error.mend)
        return
    free_gb = shutil.disk_usage(folder).free / 1e9
    few = free_gb < DISK_GB
    mend = "make room, or set LUXLOOP_CACHE to a larger disk" if few else ""
    yield Finding("cache folder", "fail" if few else "ok", f"{folder}, {free_gb:.1f} GB free", mend)


def limits() -> Iterator[Finding]:
    """Open files, shared memory, memory: where a container or a login may be too narrow."""
    files, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    unlimited = files == resource.RLIM_INFINITY
    few = not unlimited and files < OPEN_FILES
    mend = f"ulimit -n {4 * OPEN_FILES}; of a container: ulimits" if few else ""
    yield Finding("open files", "warn" if few else "ok", "no limit" if unlimited else f"at most {files}", mend)
    shared = Path("/dev") / "shm"
    if shared.is_dir():
        free_mb = shutil.disk_usage(shared).free / 1e6
        little = free_mb < SHARED_MB
        mend = "remove what lies there; of a container: shm_size" if little else ""
        yield Finding(str(shared), "warn" if little else "ok", f"{free_mb:.0f} MB free", mend)
    limit_mb = memory_limit_mb()
    little = limit_mb < MEMORY_MB
    mend = f"give it at least {MEMORY_MB:.0f} MB; of a container: mem_limit" if little else ""
    yield Finding("memory", "warn" if little else "ok", f"at most {limit_mb:.0f} MB", mend)


def memory_limit_mb(cgroup: Path = Path("/sys/fs/cgroup")) -> float:
    """What this process and its kin may have, in MB: the control group's limit, or all there is."""
    installed_mb = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e6
    for name in CGROUP_LIMITS:
        try:
            text = (cgroup / name).read_text().strip()
        except OSError:
            continue
        if text.isdecimal():  # else "max"
            return min(int(text) / 1e6, installed_mb)
    return installed_mb
