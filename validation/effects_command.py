"""`luxloop effects list|show|new|check|confusion`: the physical effects there are, and the user's own."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from luxloop.errors import InputError, RemoteError
from luxloop.settings import load_settings, usable_cache
from validation.compare_command import waiting
from validation.writing import drawn, view_of, written

if TYPE_CHECKING:
    from luxloop.effect import EffectSpec
    from luxloop.model import Model
    from luxloop.settings import Settings
    from validation.effects.checking import Finding
    from validation.effects.confusing import Ground
    from validation.effects.known import Known
    from validation.prediction import Predictor

Stage = Literal["stack", "film", "surface", "volume", "emission", "geometry", "module", "detector", "curve"]
ModelName = Annotated[str, typer.Option("--model", help="paper, clear_chip, or a model file.")]
Folder = Annotated[Path | None, typer.Option(help="Of your effects (else LUXLOOP_EFFECTS, else ./effects).")]
NoLocal = Annotated[bool, typer.Option("--no-local", help="Use a running set only; start no processes.")]
Router = Annotated[str | None, typer.Option(help="Endpoint of the router (else LUXLOOP_ROUTER).")]
Json = Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")]
Quiet = Annotated[bool, typer.Option("--quiet", help="Say nothing on stderr but errors.")]
Values = Annotated[list[str] | None, typer.Option("--value", help="PARAM=VALUE; can be given again.")]


def list_(
    effects: Folder = None,
    no_local: NoLocal = False,
    router: Router = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """List the effects that the workers know, yours too, and the files that they refuse."""
    with _asked(effects, router, no_local, not (quiet or as_json), "asking the workers") as at:
        known = at.known
    if as_json:
        specs = [spec.model_dump(mode="json") for spec in known.specs]
        typer.echo(json.dumps({"effects": specs, "refused": dict(known.refused)}, ensure_ascii=False))
        return
    from validation.effects.told import listed

    typer.echo("\n".join(listed(known)))


def show(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Of an effect, as luxloop effects list has it.")],
    value: Values = None,
    page: Annotated[
        Path | None, typer.Option("--page", help="The picture: .png, .svg, .pdf; default NAME.png.")
    ] = None,
    model: ModelName = "paper",
    effects: Folder = None,
    no_local: NoLocal = False,
    router: Router = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Show an effect: formula, source, parameters, and a picture of what it does to the example module."""
    from luxloop.model_file import find_model
    from validation.effects.known import applied, stanza
    from validation.effects.showing import shown, values_of
    from validation.effects.told import card

    page = page or Path(f"{name}.png")
    draw = view_of("effect", page)
    with _asked(effects, router, no_local, not (quiet or as_json), f"predicting {name}") as at:
        spec = at.known.spec(name)
        document, arrays = shown(at.predictor, at.known, find_model(model), spec, values_of(spec, value or []))
    document["stanza"] = stanza(applied(spec, document["values"]))
    if arrays:
        document["picture"] = str(page)
    if as_json:
        typer.echo(json.dumps(spec.model_dump(mode="json") | document, ensure_ascii=False))
    else:
        typer.echo("\n".join(card(spec, document)))
    drawn(draw if arrays else None, document, lambda: arrays, page)


def new(
    name: Annotated[str, typer.Argument(metavar="NAME", help="Small letters, digits and _: my_haze.")],
    stage: Annotated[
        Stage, typer.Option(help="Where it acts; film, curve: on a measured film, on what is read of it.")
    ],
    effects: Folder = None,
    no_local: NoLocal = False,
    router: Router = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Write a working example of an effect of 20 lines, to be changed."""
    from luxloop.effect import EffectSpec
    from luxloop.words import parse
    from validation.effects.templates import source_of

    parse(EffectSpec, {"name": name, "stage": "detector", "description": ""}, "NAME")
    folder = _folder(effects)
    file = folder / f"{name}.py"
    if file.exists():
        raise InputError("NAME", name, f"a name without a file in {folder}", f"change {file}, or take another name")
    with _asked(effects, router, no_local, not (quiet or as_json), "asking the workers") as at:
        if any(spec.name == name for spec in at.known.specs):
            raise InputError("NAME", name, "a name that no effect has", "luxloop effects list shows those there are")
    with written("--effects", file, "name another folder by --effects or LUXLOOP_EFFECTS"):
        folder.mkdir(parents=True, exist_ok=True)
        with file.open("x", encoding="utf-8") as opened:
            opened.write(source_of(name, stage))
    told = {"file": str(file), "stage": stage, "next": f"luxloop effects check {name}"}
    typer.echo(json.dumps(told) if as_json else f"{file} written: change it, then {told['next']}")


def check(
    name: Annotated[str, typer.Argument(metavar="FILE|NAME", help="A file of your effects' folder, or an effect.")],
    quick: Annotated[bool, typer.Option("--quick", help="Leave out what asks for all other effects.")] = False,
    model: ModelName = "paper",
    effects: Folder = None,
    no_local: NoLocal = False,
    router: Router = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Check an effect: what it must keep, its derivative, what looks like it, whether a diagnosis finds it again."""
    from luxloop.model_file import find_model
    from validation.effects.told import report

    name, source = _file_of(name, _folder(effects))
    with _asked(effects, router, no_local, not (quiet or as_json), f"checking {name}") as at:
        document = _checked(at, find_model(model), name, source, quick)
    if as_json:
        typer.echo(json.dumps(document, ensure_ascii=False))
    else:
        typer.echo("\n".join(report(document)))
    if not document["ok"]:
        raise typer.Exit(1)


def confusion(
    dataset: Annotated[Path | None, typer.Argument(metavar="[DATASET]", help="Default: six example images.")] = None,
    page: Annotated[Path | None, typer.Option("--page", help="The map as a page or a picture: .html, .png.")] = None,
    only: Annotated[list[str] | None, typer.Option("--only", help="These effects alone, with commas.")] = None,
    model: ModelName = "paper",
    effects: Folder = None,
    no_local: NoLocal = False,
    router: Router = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Show which effects the data cannot tell apart: cosines of all pairs, in groups."""
    from luxloop.model_file import find_model
    from validation.dataset.folder import read_dataset
    from validation.diagnose_command import names_of
    from validation.effects.confusing import confusion as confused
    from validation.effects.confusing import grounds
    from validation.effects.told import confusing
    from validation.observed import Observed

    draw = view_of("confusion", page) if page is not None else None
    names = names_of("--only", None if only is None else ",".join(only))
    chosen = find_model(model)
    observed = None if dataset is None else Observed.of(read_dataset(dataset))
    with _asked(effects, router, no_local, not (quiet or as_json), "predicting") as at:
        specs = [at.known.spec(one) for one in names] if names else list(at.known.specs)
        seen = grounds(chosen, at.predictor, at.known, observed)
        found = [confused(ground, chosen, specs, at.say) for ground in seen]
    told = [one.document() for one in found if one.names or one.imitated or one.failed]
    document = {"model": chosen.name, "maps": told}
    typer.echo(json.dumps(document, ensure_ascii=False) if as_json else "\n".join(confusing(document, page)))
    drawn(draw, document, dict, page)


# What the commands share


@dataclass(frozen=True)
class _At:
    """Workers that answer, and what they know."""

    known: Known
    predictor: Predictor
    say: Any


@contextmanager
def _asked(folder: Path | None, router: str | None, no_local: bool, say: bool, what: str) -> Iterator[_At]:
    """A running set, else one of our own that looks into the folder."""
    from luxloop.client import Client
    from validation.effects.known import Known
    from validation.prediction import Predictor
    from validation.session import PATIENCE_S

    settings: Settings = load_settings(router=router, effects=_folder(folder))
    usable_cache(settings)
    with (
        waiting(say, what) as line,
        Client(settings, local=not no_local, patience_s=PATIENCE_S) as client,
    ):
        yield _At(Known.ask(client), Predictor(client), line)


def _folder(given: Path | None) -> Path:
    return Path(os.path.expanduser(given or load_settings().effects_dir)).absolute()


def _file_of(text: str, folder: Path) -> tuple[str, bytes | None]:
    """Name and bytes of an effect's file; no bytes for one that is no file. InputError for a file elsewhere."""
    path = Path(text) if text.endswith(".py") else folder / f"{text}.py"
    if text.endswith(".py") and not path.is_file():
        raise InputError("FILE", text, "a file that is there", "luxloop effects new writes one")
    if path.is_file() and path.resolve().parent != folder.resolve():
        mend = f"move it there, or --effects {path.parent}"
        raise InputError("FILE", text, f"a file in the folder of your effects, {folder}", mend)
    return path.stem, path.read_bytes() if path.is_file() else None


def _checked(at: _At, model: Model, name: str, source: bytes | None, quick: bool) -> dict[str, Any]:
    """Everything that was looked at, in order; what fails first ends it where the rest would mean nothing."""
    from validation.effects.checking import Finding, trial_of

    _refuse_other_file(at.known, name, source)
    findings = list(trial_of(at.known, name))
    document: dict[str, Any] = {"effect": name, "near": {}}
    if all(one.ok is not False for one in findings):
        spec = at.known.spec(name)
        document["stanza"] = _stanza(spec)
        try:
            for finding in _predicted(at, model, spec, quick, document):
                findings.append(finding)
                at.say(f"{name}: {finding.check}")
        except RemoteError as error:
            if error.failure.code != "bad_input":
                raise
            findings.append(Finding("prediction", False, f"{error}{_for_the_twin(spec)}"))
    return document | {
        "ok": all(one.ok is not False for one in findings),
        "findings": [asdict(one) for one in findings],
    }


def _for_the_twin(spec: EffectSpec) -> str:
    return "; if the twin cannot represent it, write twin = False: Monte Carlo does" if spec.twin else ""


def _predicted(at: _At, model: Model, spec: EffectSpec, quick: bool, document: dict[str, Any]) -> Iterator[Finding]:
    """What whole predictions tell of an effect, on images, or on a film's curves where it changes no image."""
    from validation.effects import checking
    from validation.effects.known import acting
    from validation.self_diagnosis import self_diagnosed

    if not acting(spec):
        yield checking.Finding("derivative", None, "no parameter has a slope at off: refits will tell")
        return
    for ground in _grounds(at, model, spec):
        columns = ground.columns(model, spec)
        if not columns:
            yield checking.Finding("derivative", None, f"it changes nothing of {ground.name}")
            continue
        yield from checking.derivative(ground, model, spec, columns)
        if ground.sight.views:
            yield checking.shared_numbers(ground, at.predictor, model, spec)
        if not quick:
            near = checking.likeness(ground, model, spec, columns, at.known.specs)
            document["near"][ground.name] = [[name, round(cosine, 3)] for name, cosine in near]
            yield checking.looks_like(near, ground.name)
            yield self_diagnosed(ground, at.predictor, at.known, model, spec, columns, lambda _, words: at.say(words))


def _grounds(at: _At, model: Model, spec: EffectSpec) -> Iterator[Ground]:
    """What an effect is looked at on: example images, the example film, or both."""
    from validation.effects.confusing import curve_ground, image_ground

    if "modules" in spec.acts_on:
        yield image_ground(model, at.predictor, at.known)
    if "films" in spec.acts_on:
        yield curve_ground(model, at.predictor)


def _refuse_other_file(known: Known, name: str, source: bytes | None) -> None:
    """InputError where the workers look into another folder, or have another file of that name."""
    if source is None:
        return
    trial, here = known.trials.get(f"{name}.py"), sha256(source).hexdigest()
    if trial is None and f"{name}.py" not in known.refused:
        mend = "start them with LUXLOOP_EFFECTS set to it, or stop the running set"
        raise InputError("FILE", f"{name}.py", "a file in the folder that the workers look into", mend)
    if trial is not None and trial["sha256"] != here:
        raise InputError("FILE", here, f"the workers' file, {trial['sha256']}", "give them the same file")


def _stanza(spec: EffectSpec) -> str:
    from validation.effects.known import applied, stanza, typical

    return stanza(applied(spec, typical(spec)))
