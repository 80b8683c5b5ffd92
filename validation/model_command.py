"""`luxloop model new|show|diff|undo`: make a model file, look at it, compare versions, go back."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table
from rich.text import Text

from luxloop.effect import Value
from luxloop.errors import InputError
from luxloop.model import Environment, Fit, Model, Surface
from luxloop.model_file import SCHEMA, SHIPPED, find_model, parse_toml, range_of
from luxloop.model_file import diff as differences
from luxloop.units import unit_of
from luxloop.words import parse
from validation.model_versions import Version, previous, save, version_text, versions
from validation.model_versions import undo as undo_version

SHOWN_CHIPS = 8
WIDTH_WITHOUT_TERMINAL = 160  # a pipe has no width of its own; cells would be folded at 80

FileArgument = Annotated[Path, typer.Argument(help="The model file.")]
JsonOption = Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")]


def new(
    file: FileArgument = Path("model.toml"),
    source: Annotated[str, typer.Option("--from", help="paper, clear_chip, or a model file.")] = "paper",
    force: Annotated[
        bool, typer.Option("--force", help="Replace a file that exists; it stays as a version.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Write a model file to start from; it names every parameter with unit, range and meaning."""
    _refuse_shipped(file, f"--from {file} to start from it")
    model = parse(Model, {**find_model(source).model_dump(), "name": file.stem})
    if file.exists() and not force:
        raise InputError("FILE", str(file), "a file that does not exist", "--force replaces it, undo brings it back")
    version = save(file, model, f"model new --from {source}")
    told = {"file": str(file), "from": source, "sha256": version.sha256, "version": version.number}
    _print(told, f"{file} written from {source}: version {version.number}, {version.sha256[:12]}", as_json)


def show(
    file: Annotated[str, typer.Argument(help="paper, clear_chip, or a model file.")] = "model.toml",
    as_json: JsonOption = False,
) -> None:
    """Show a model: every parameter with its unit, whether it is free, its prior; effects; hash; versions."""
    model = find_model(file)
    history = [] if file in SHIPPED else versions(Path(file))
    if as_json:
        _print(_as_object(file, model, history), "", True)
        return
    console = _console()
    console.print(Text(f"{model.name}   ({file}, {SCHEMA}, sha256 {model.sha256[:12]})", style="bold"))
    console.print(_parameters(model))
    console.print(_effects(model) if model.effects else Text("no effects"))
    if model.samples:
        console.print(_samples(model))
    if history:
        console.print(_versions(history))
    if model.notes:
        console.print(Text(model.notes.strip()))


def diff(
    before: Annotated[str, typer.Argument(help="A model; alone: compare it with its version before.")],
    after: Annotated[str | None, typer.Argument(help="The model to compare with.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Say what differs between two models, or between a model file and its version before."""
    if after is None:
        path = Path(before)
        _refuse_shipped(path, "name two models, or a file of your own")
        number = previous(path)
        labels = (f"{path.name} version {number}", path.name)
        models = (parse_toml(version_text(path, number), labels[0]), find_model(before))
    else:
        labels, models = (before, after), (find_model(before), find_model(after))
    changes = differences(*models)
    same = models[0].sha256 == models[1].sha256
    told = {
        "before": labels[0],
        "after": labels[1],
        "same_results": same,
        "changes": [change._asdict() for change in changes],
    }
    count = f"{len(changes)} difference" + "s" * (len(changes) != 1)
    lines = [f"{labels[0]} -> {labels[1]}: {count}" + ", none that changes results" * same]
    _print(told, "\n".join([*lines, *(f"  {change}" for change in changes)]), as_json)


def undo(
    file: FileArgument = Path("model.toml"),
    to: Annotated[int | None, typer.Option("--to", help="Number of the version; else the one before.")] = None,
    as_json: JsonOption = False,
) -> None:
    """Put the version before back. It becomes a new version, so undo can itself be undone.

    Version numbers are counted over all model files of a folder, so those of one file may have gaps.
    """
    _refuse_shipped(file, "a shipped model never changes")
    version = undo_version(file, "model undo" + (f" --to {to}" if to is not None else ""), to)
    number = version.number
    told = {"file": str(file), "version": number, "sha256": version.sha256, "fault": None}
    said = f"{file} is back, as version {number}, {version.sha256[:12]}; `luxloop model diff {file}`"
    try:
        find_model(file)
    except InputError as error:  # somebody's work, all the same
        told["fault"] = str(error)
        said = f"{file} is back, as version {number}, but it is no model: {error}; correct it, or undo again"
    _print(told, said, as_json)


def _refuse_shipped(file: Path, mend: str) -> None:
    """The names of the shipped models are no files: they cannot be written and have no versions."""
    if str(file) in SHIPPED:
        raise InputError("FILE", str(file), "a model file of your own", mend)


def _print(told: dict[str, Any], text: str, as_json: bool) -> None:
    typer.echo(json.dumps(told, ensure_ascii=False) if as_json else text)


def _console() -> Console:
    console = Console()
    told = console.is_terminal or os.environ.get("COLUMNS", "").isdigit()
    return console if told else Console(width=WIDTH_WITHOUT_TERMINAL)


def _as_object(file: str, model: Model, history: list[Version]) -> dict[str, Any]:
    plain = model.model_dump(mode="json")
    told = {"file": file, "schema": SCHEMA, "sha256": model.sha256, **plain}
    return told | {"versions": [version.model_dump(mode="json") for version in history]}


def _parameters(model: Model) -> Table:
    table = Table("parameter", "value", "range", "fit", "prior", "meaning", box=None, pad_edge=False)
    for prefix, words in {"": model.environment, **_surfaces(model)}.items():
        if prefix:
            meaning = Environment.model_fields[prefix.rstrip(".")].description or ""
            table.add_row(*map(Text, (prefix.rstrip("."), "", "", "", "", meaning)))
        for name, field in type(words).model_fields.items():
            value = getattr(words, name)
            if isinstance(value, Surface):
                continue
            fit = model.fit.get(f"environment.{prefix}{name}")
            row = (f"{prefix}{name}", _with_unit(value, name), range_of(type(words), name), *_fit(fit, name))
            table.add_row(*map(Text, (*row, field.description or "")))
    return table


def _surfaces(model: Model) -> dict[str, Surface]:
    return {"substrate.": model.environment.substrate, "receiver.": model.environment.receiver}


def _fit(fit: Fit | None, name: str) -> tuple[str, str]:
    """The two cells "free or fixed" and "prior" of a parameter."""
    if fit is None:
        return "fixed", ""
    limits = f"{'free' if fit.free else 'fixed'}, {fit.lower:g} to {fit.upper:g}"
    return limits, "" if fit.prior_mean is None else f"{fit.prior_mean:g} +- {_with_unit(fit.prior_sd, name)}"


def _effects(model: Model) -> Table:
    table = Table("effect", "parameter", "value", "fit", "prior", box=None, pad_edge=False)
    for effect in model.effects:
        for name, value in effect.parameters.items() or [("", "")]:
            fit = model.fit.get(f"effects.{effect.name}.{name}")
            table.add_row(*map(Text, (effect.name, name, _with_unit(value, name), *_fit(fit, name))))
    return table


def _samples(model: Model) -> Table:
    """What samples of the data have of their own; of chips the first few."""
    table = Table("sample", "effect", "parameter", "value", box=None, pad_edge=False)
    for sample, effects in model.samples.items():
        for effect, values in effects.items():
            for name, value in values.items():
                table.add_row(*map(Text, (sample, effect, name, _of_chips(value, name))))
    return table


def _of_chips(value: Value, name: str) -> str:
    if not isinstance(value, tuple):
        return _with_unit(value, name)
    more = f", ... of {len(value)} chips" * (len(value) > SHOWN_CHIPS)
    return ", ".join(f"{one:.3g}" for one in value[:SHOWN_CHIPS]) + more + f" {unit_of(name)}".rstrip()


def _versions(history: list[Version]) -> Table:
    table = Table("version", "time", "command", "sha256", "errors", box=None, pad_edge=False)
    for one in history:
        errors = ", ".join(f"{name} {value:g}" for name, value in one.errors.items())
        row = (str(one.number), one.time, one.command, one.sha256[:12] or "(no model)", errors)
        table.add_row(*map(Text, row))
    return table


def _with_unit(value: object, name: str) -> str:
    """A value for people, with the unit its name states."""
    if value is None:
        return "none"
    text = f"{value:.10g}" if isinstance(value, float) else str(value)
    unit = unit_of(name)
    return f"{text} {unit}" if unit else text
