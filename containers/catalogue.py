"""Which effects a worker knows: those of the catalogue, of installed packages, and of the user's own folder.

    containers/effects/NAME.py         the catalogue
    entry points `luxloop.effects`     of installed packages; known by name and SHA-256 of module and release
    LUXLOOP_EFFECTS/*.py               the user's own; known by name and SHA-256 of the file

A request names effects; no code ever comes over the bus. Where a request has another hash than the worker, the folder
is looked through again, and only then the request is refused, with both hashes.
"""

from __future__ import annotations

import hashlib
import importlib
import pkgutil
import sys
from collections.abc import Sequence
from functools import lru_cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any

from containers import effects as shipped
from containers.acting import Effects
from containers.effect import Effect
from containers.effect_files import Loaded, Own, effects_in, load_folder
from containers.reporting import Report, nothing
from luxloop.effect import AppliedEffect, EffectSpec, check, did_you_mean, refuse_twice
from luxloop.errors import InputError, RemoteError
from luxloop.failure import Failure, printable
from luxloop.words import parse


class Catalogue:
    """The effects that a worker knows; `folder` has the user's own, None: none of those."""

    def __init__(self, folder: Path | None = None) -> None:
        self._folder = folder
        self._own = Loaded()
        self.rescan()

    def rescan(self, report: Report = nothing) -> None:
        """Look through the user's folder again; a file that is as it was is not loaded again."""
        if self._folder is not None:
            taken = frozenset({*_shipped(), *_installed().known})
            self._own = load_folder(self._folder, self._own, taken, report=report)

    @property
    def specs(self) -> list[EffectSpec]:
        """What there is, the catalogue first."""
        own = [*_installed().known.values(), *self._own.known.values()]
        return [kind.spec() for kind in _shipped().values()] + [one.spec for one in own]

    @property
    def refused(self) -> dict[str, str]:
        """Of the user's files, and of what packages offer, that are not used: why not."""
        return _installed().refused | self._own.refused

    @property
    def trials(self) -> dict[str, Any]:
        """What the trials of the user's files found, by file: its hash, and a line for each thing looked at."""
        return {
            file: {"sha256": trial.sha256, "findings": [dict(one) for one in trial.findings]}
            for file, trial in self._own.trials.items()
        }

    def effects(self, applied: Sequence[AppliedEffect], worker: str, report: Report = nothing) -> Effects:
        """The effects of a request, ready to act; the report is called while the folder is looked through.

        Raises
        ------
        RemoteError unknown_effect : an effect that is not known here, or of another source.
        InputError : a value out of range, an effect twice, two that exclude each other.
        """
        refuse_twice("effects", (one.name for one in applied))
        found = tuple(self._effect(one, worker, report) for one in applied)
        names = {one.name for one in found}
        for one in found:
            for other in one.excludes:
                if other in names:
                    raise InputError("effects", f"{one.name} and {other}", "one of the two", "they say the same")
        return Effects(found)

    def _effect(self, applied: AppliedEffect, worker: str, report: Report) -> Effect:
        spec, kind = self._known(applied, worker, report)
        check(applied, spec)
        return parse(kind, applied.parameters, f"effects.{applied.name}")

    def _known(
        self, applied: AppliedEffect, worker: str, report: Report = nothing
    ) -> tuple[EffectSpec, type[Effect]]:
        kind = _shipped().get(applied.name)
        if kind is not None:
            return kind.spec(), kind
        installed = _installed().known.get(applied.name)
        own = installed or self._own.known.get(applied.name)
        if installed is None and (own is None or own.spec.source_sha256 != applied.source_sha256):
            self.rescan(report)
            own = self._own.known.get(applied.name)
        if own is None or own.spec.source_sha256 != applied.source_sha256:
            raise RemoteError(self._unknown(applied, own.spec if own else None, worker))
        return own.spec, own.kind

    def _unknown(self, applied: AppliedEffect, own: EffectSpec | None, worker: str) -> Failure:
        names = [spec.name for spec in self.specs]
        file = f"{applied.name}.py"
        if own is not None:
            allowed = f"the source with SHA-256 {own.source_sha256}"
            mend = f"give all workers the same file and the model its hash: luxloop effects check {applied.name}"
            if applied.name in _installed().known:
                mend = "install the same package on all workers, and give the model this hash"
        elif why := self.refused.get(file, self.refused.get(applied.name, "")):
            allowed, mend = "a source that can be used", why
        else:
            allowed = f"one of {len(names)}, luxloop effects list shows them"
            mend = did_you_mean(applied.name, names) or f"put its file into the workers' folder {self._folder}"
        return Failure(
            code="unknown_effect",
            message=f"the {worker} worker does not know effect {applied.name}"
            + (f" with source {applied.source_sha256}" if applied.source_sha256 else "")
            + (f", only with source {own.source_sha256}" if own else ""),
            field=f"effects.{applied.name}",
            value=applied.source_sha256 or applied.name,
            allowed=allowed,
            mend=mend,
        )


def told(catalogue: Catalogue) -> dict[str, Any]:
    """What a worker says of the effects it knows."""
    specs = [spec.model_dump(mode="json", exclude_defaults=True) for spec in catalogue.specs]
    return {"effects": specs, "refused_effects": catalogue.refused, "effect_trials": catalogue.trials}


@lru_cache(maxsize=1)
def _shipped() -> dict[str, type[Effect]]:
    """The catalogue, by name. Raises InputError for one name twice."""
    modules = [
        importlib.import_module(f"{shipped.__name__}.{one.name}") for one in pkgutil.iter_modules(shipped.__path__)
    ]
    kinds = [kind for module in modules for kind in effects_in(module)]
    refuse_twice("effects", (kind.name for kind in kinds))
    return {kind.name: kind for kind in kinds}


@lru_cache(maxsize=1)
def _installed() -> Loaded:
    """The effects of installed packages, by name, and by entry point why one is not used."""
    found = Loaded()
    for point in sorted(entry_points(group="luxloop.effects"), key=lambda one: (one.name, one.value)):
        where = f"entry point {point.name} = {point.value} of {_release(point)}"
        try:
            own = _of_package(point)
            if own.spec.name in {*_shipped(), *found.known}:
                raise InputError("name", own.spec.name, "a name that no other effect has", "rename it in its package")
        except (Exception, SystemExit) as error:  # noqa: BLE001  # anybody's code; the worker starts without it
            said = str(error) if isinstance(error, InputError) else f"{type(error).__name__}: {error}"
            found.refused[point.name] = printable(f"{where}: {said}; mend or remove the package")[:2000]
        else:
            found.known[own.spec.name] = own
    return found


def _of_package(point: EntryPoint) -> Own:
    """An effect that a package offers, with the hash of its module and release. Raises whatever its import raises."""
    kind = point.load()
    if not (isinstance(kind, type) and issubclass(kind, Effect)):
        raise InputError("effect", type(kind).__name__, "a class derived from an effect of containers.effect")
    digest = hashlib.sha256(_release(point).encode())
    file = getattr(sys.modules[kind.__module__], "__file__", None)
    digest.update(Path(file).read_bytes() if file else b"")
    return Own(kind.spec().model_copy(update={"source_sha256": digest.hexdigest()}), kind)


def _release(point: EntryPoint) -> str:
    return f"{point.dist.name} {point.dist.version}" if point.dist is not None else "no package"
