"""The one import of numba in this room: how kernels are compiled, where they are kept, what they leave in memory.

Compiled code lies under `$LUXLOOP_KERNELS/<key>` (default `kernels` in `LUXLOOP_CACHE`), or under
`$NUMBA_CACHE_DIR/<key>` where that is set. numba compiles again when the file of a kernel changes, but not when the
file of a kernel that it calls does; therefore the key is a digest of all files of the same worker that hold kernels,
or what kernels are handed, and of this one, which says how they are compiled.
"""

from __future__ import annotations

import ctypes
import hashlib
import os
import re
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

import numba

Function = TypeVar("Function", bound=Callable[..., Any])
KERNELS = b"@kernel", b"_kernel\n", b"(NamedTuple)"
"""What a file holds that compiled code may depend on."""
MADV_PAGEOUT = 21  # Linux 5.4 and later; older kernels answer EINVAL, which is as good as doing nothing


def cache_folder() -> Path:
    """The folder of all that can be computed again: `LUXLOOP_CACHE`, default `~/.cache/luxloop`."""
    return Path(os.environ.get("LUXLOOP_CACHE") or Path.home() / ".cache" / "luxloop")


def kernel(function: Function) -> Function:
    """`function` compiled on its first call for the types it is called with, or loaded from the folder above.

    It runs without the interpreter lock, so that heartbeats go on; division by zero gives inf or nan as in numpy;
    no re-association of sums, so that results are the same on every machine.
    """
    return _compiled(function)


def borrowing_kernel(function: Function) -> Function:
    """`kernel` for functions that make no arrays: they do not count references to the ones they are given.

    Counting is atomic, and took a third of a ray tracer's time on one thread, more than half of it on two.
    """
    return _compiled(function, _nrt=False)


def inlined_kernel(function: Function) -> Function:
    """`borrowing_kernel` that becomes part of its callers: handing on the arrays would cost more than it does."""
    return _compiled(function, _nrt=False, forceinline=True)


def _compiled(function: Function, **options: bool) -> Function:
    # numba reads this when it decorates; set as text because its settings are made at run time
    setattr(numba.config, "CACHE_DIR", _kernel_folder(Path(function.__code__.co_filename).parent))  # noqa: B010
    compiler = cast(Any, numba.njit)  # `_nrt` is not in its types
    return cast(Function, compiler(function, nogil=True, cache=True, error_model="numpy", fastmath=False, **options))


@cache
def _kernel_folder(folder: Path) -> str:
    """Where the compiled kernels of one source folder lie."""
    package = folder.parent if (folder.parent.parent / "__init__.py").exists() else folder
    sources = [(path.name, path.read_bytes()) for path in sorted(package.rglob("*.py"))]
    kernels = [(name, text) for name, text in sources if any(mark in text for mark in KERNELS)]
    digest = hashlib.sha256(repr(kernels).encode())
    digest.update(Path(__file__).read_bytes())
    chosen = os.environ.get("NUMBA_CACHE_DIR") or os.environ.get("LUXLOOP_KERNELS")
    return str((Path(chosen) if chosen else cache_folder() / "kernels") / f"{package.name}-{digest.hexdigest()[:12]}")


def release_compiler_pages() -> int:
    """Bytes of memory handed back to the operating system, 0 where that cannot be done.

    Importing numba reads some 100 MB of LLVM library into memory, and running compiled kernels needs little of it.
    These pages are clean copies of a file: the system drops them now and reads again what is needed later.
    """
    if not sys.platform.startswith("linux"):
        return 0
    madvise = ctypes.CDLL(None).madvise
    madvise.argtypes = [ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int]
    before = _resident_bytes()
    for start, end in _library_pages("llvmlite"):
        madvise(start, end - start, MADV_PAGEOUT)
    return max(0, before - _resident_bytes())


def _resident_bytes() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGESIZE")


def _library_pages(name: str) -> list[tuple[int, int]]:
    """Address ranges (start, end) of the read-only pages mapped from shared libraries called `name`."""
    line = re.compile(r"([0-9a-f]+)-([0-9a-f]+) r-[-x]p \S+ \S+ \S+\s+(/.*\.so\S*)")
    found = (line.match(text) for text in Path("/proc/self/maps").read_text().splitlines())
    return [(int(m[1], 16), int(m[2], 16)) for m in found if m and name in m[3].rsplit("/", 1)[-1]]
