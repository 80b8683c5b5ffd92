"""The user's own effects: files of a folder, each tried in a process of its own before it is used."""

from __future__ import annotations

import hashlib
import importlib.util
import sys
from collections.abc import Set
from dataclasses import dataclass, field
from pathlib import Path

from containers.effect import Effect
from luxloop.effect import EffectSpec


@dataclass(frozen=True)
class Own:
    """A user's own effect, with the hash of its source in its description."""

    spec: EffectSpec
    kind: type[Effect]


@dataclass(frozen=True)
class Loaded:
    """What a folder holds: effects by name, and for files that are not used the reason."""

    known: dict[str, Own] = field(default_factory=dict)
    refused: dict[str, str] = field(default_factory=dict)


def load_folder(folder: Path, before: Loaded, taken: Set[str]) -> Loaded:
    """The effects of a folder; what is in `before` with the same hash is kept, names in `taken` are refused."""
    found = Loaded()
    for path in sorted(folder.glob("*.py")):
        source = path.read_bytes()
        sha256 = hashlib.sha256(source).hexdigest()
        held = before.known.get(path.stem)
        if held is not None and held.spec.source_sha256 == sha256:
            found.known[path.stem] = held
            continue
        if path.stem in taken:
            found.refused[path.name] = f"{path.stem} is an effect of the catalogue"
            continue
        name = f"luxloop_effects.{path.stem}_{sha256[:16]}"
        module = importlib.util.module_from_spec(importlib.util.spec_from_loader(name, None))  # type: ignore[arg-type]
        sys.modules[name] = module
        exec(compile(source, str(path), "exec"), vars(module))  # noqa: S102
        (kind,) = (k for k in vars(module).values() if isinstance(k, type) and issubclass(k, Effect))
        found.known[path.stem] = Own(kind.spec().model_copy(update={"source_sha256": sha256}), kind)
    return found
