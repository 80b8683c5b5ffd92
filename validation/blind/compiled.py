"""The one import of numba in the blind test's forward model: how kernels are compiled, where they are kept."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import numba

Function = TypeVar("Function", bound=Callable[..., Any])


def kernel(function: Function) -> Function:
    """`function`, compiled on its first call for the types it is called with, or loaded from the cache.

    numba compiles again when the file of a kernel changes, but not when that of a kernel it calls does; hence the
    folder is named by a digest of all files here. Kernels make no arrays, so references to them are not counted.
    """
    setattr(numba.config, "CACHE_DIR", _folder())  # noqa: B010 - made at run time, mypy does not know it
    compiler = cast(Any, numba.njit)
    return cast(Function, compiler(function, nogil=True, cache=True, error_model="numpy", fastmath=False, _nrt=False))


def _folder() -> str:
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(path.read_bytes())
    home = Path(os.environ.get("LUXLOOP_CACHE") or Path.home() / ".cache" / "luxloop")
    chosen = os.environ.get("NUMBA_CACHE_DIR") or os.environ.get("LUXLOOP_KERNELS")
    return str(Path(chosen or home / "kernels") / f"blind-{digest.hexdigest()[:12]}")
