"""Where the fields of anchors come from: memory, a folder that is bounded in size, or Monte Carlo once more.

A field is a function of its key, by the code that ran: who asks again in another process, as every command does that
starts a set of its own, or after a crash, need not wait for it again. What other code, other packages or another kind
of processor made is not taken, nor is anything kept that stored exits were landed for: they may be of other code.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from llvmlite import binding
from numpy.typing import NDArray

import containers
from containers.ray_tracing.array_store import ArrayStore
from containers.ray_tracing.field import Axis, ModuleField
from containers.ray_tracing.kept import Kept
from luxloop.words import sha256_of

HELD_BYTES = 128 << 20
"""Of fields in memory (0.4 to 150 MB each), and of anchors; the latest is kept in any case."""
FOLDER_BYTES = 1 << 30
FEWEST_STORED = 1_000_000
"""Histories of a field that is worth a file: about a second of two cores. Columns take many of fewer."""


class FieldSource:
    """Fields of modules by key; what is not known is made, and kept."""

    def __init__(self, folder: Path | None = None, folder_bytes: int = FOLDER_BYTES) -> None:
        self._held = Kept[ModuleField](HELD_BYTES, lambda one: one.nbytes)
        self._store = None if folder is None else ArrayStore(folder, folder_bytes, what="fields")
        self._code = "" if folder is None else code_key()  # now, for the code that was loaded may be changed

    def __contains__(self, key: str) -> bool:
        """Whether no Monte Carlo has to be run for it."""
        return key in self._held or (self._store is not None and self._store.header(self._stored(key)) is not None)

    def of(self, key: str, histories: int, make: Callable[[], ModuleField], *, lasting: bool = True) -> ModuleField:
        """The field under a key (SHA-256 of all that it depends on but the code), or the one made now.

        Parameters
        ----------
        histories : of the run; what was dear stays longest in memory, and what was cheap is not stored.
        lasting : whether it may be; else it ends with the process.
        """

        def read_or_made() -> ModuleField:
            if self._store is None or not lasting or histories < FEWEST_STORED:
                return make()
            found = self._read(self._store, key)
            if found is None:
                found = make()
                self._write(self._store, key, found)
            return found

        return self._held.of(key, float(histories), read_or_made)

    def _read(self, store: ArrayStore, key: str) -> ModuleField | None:
        arrays, header = store.get(self._stored(key)), store.header(self._stored(key))
        return None if arrays is None or header is None else _field_of(arrays, header)

    def _write(self, store: ArrayStore, key: str, field: ModuleField) -> None:
        if field.tallied_variance is None:
            return
        arrays = {"coefficients": field.coefficients, "tallied_variance": field.tallied_variance}
        numbers = {name: getattr(field, name) for name in ("histories", "truncation", "per_m2")}
        store.put(self._stored(key), arrays, {**numbers, "x": vars(field.x), "y": vars(field.y)})

    def _stored(self, key: str) -> str:
        return sha256_of({"field": key, "by": self._code})


def _field_of(arrays: Mapping[str, NDArray[Any]], header: Mapping[str, Any]) -> ModuleField | None:
    """The field of a file, in memory of its own; None where the file holds something else."""
    try:
        x, y = (Axis(**header[name]) for name in "xy")
        coefficients, variance = (arrays[name].copy() for name in ("coefficients", "tallied_variance"))
        shape = (y.modes + 1, x.modes + 1)
        numbers = int(header["histories"]), float(header["truncation"]), float(header["per_m2"])
    except (KeyError, TypeError, ValueError):
        return None
    if coefficients.shape[1:] != shape or variance.shape != shape or not np.isfinite(coefficients).all():
        return None
    if {coefficients.dtype, variance.dtype} != {np.dtype(np.float64)}:
        return None
    return ModuleField(coefficients, x, y, *numbers, tallied_variance=variance)


def code_key() -> str:
    """SHA-256 of what decides a field's last bit beside its key: this room's files, packages, kind of processor."""
    digest, room = hashlib.sha256(), Path(containers.__file__).parent
    beside = [version(name) for name in ("numba", "llvmlite", "numpy")]
    digest.update(
        " ".join([*beside, binding.get_host_cpu_name(), binding.get_host_cpu_features().flatten()]).encode()
    )
    for path in sorted(room.rglob("*.py")):
        code = path.read_bytes()
        digest.update(f"\n{path.relative_to(room)} {len(code)}\n".encode() + code)
    return digest.hexdigest()
