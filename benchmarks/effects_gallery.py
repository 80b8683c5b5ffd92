"""The gallery of effects: a small picture of each one's signature, and docs/effects.md with all that is said of it.

    python -m benchmarks.effects_gallery [--only NAME] [--words] [--map]

The workers are asked for the catalogue and predict the example of `luxloop effects show` without and with each
effect, by the twin, or by Monte Carlo with the same random numbers where the twin cannot represent it. `--only` draws
one picture anew; `--words` writes the text about the pictures that are there; `--map` only compares all effects with
each other anew, on six images of the paper's kind and on the film (minutes).
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image

from luxloop.client import Client
from luxloop.effect import EffectParameter, EffectSpec
from luxloop.model import Model
from luxloop.model_file import find_model
from luxloop.settings import load_settings
from validation.dataset.manifest import FilmLayer, FilmSample, Sample
from validation.effects.confusing import confusion, curve_ground, image_ground
from validation.effects.example_set import FILM, MODULE, PEAK_SHARE
from validation.effects.known import Known, applied, with_effect
from validation.effects.showing import sensible, shown, values_of
from validation.effects.signatures import Sight
from validation.prediction import Curve, Predictor, View
from viewer.effects import draw_confusion
from viewer.look import BLUE, GREY, INK, ORANGE, TEXT

Real = NDArray[np.float64]
Document = Mapping[str, Any]
Arrays = dict[str, Real]

DOCS = Path(__file__).parents[1] / "docs"
PICTURES = DOCS / "images" / "effects"
FACTS = PICTURES / "facts.json"
"""Beside the pictures: values they were drawn with, and how large the difference is."""
LIKENESS, MAP = PICTURES / "confusion.json", PICTURES / "confusion.png"
"""Cosines between all effects, and their picture."""
NEAREST, TOLD = 3, 0.5
"""How many others are named as alike, and from which cosine on."""
DPI, COLOURS = 80, 92
PATIENCE_S = 600.0
WINDOW_NM = 20_000.0
GIVEN = {"dbr_layer_order": ["order=aln_first"]}
"""Values other than those of `luxloop effects show`."""
ALONE = {"electrode_shadow": ["dark_share=0.3"], "current_crowding": ["rise=0.3", "rim=0.3"]}
"""What moves light about within a chip: less than the noise of new light on the array, so one chip shows it."""
NOISY = {"receiver_tilt": ["tilt_x_per_mm=0.05"], "dbr_absorption": ["extinction=0.01"]}
"""What one prediction of the module does not show for noise."""
SEEDS, HISTORIES = range(1, 9), 2_000_000

STAGES = {
    "stack": "Stack: the layers of a chip's mirror, or of a film that was measured",
    "surface": "Surface: what reflects, scatters or records",
    "volume": "Volume: what light passes through",
    "emission": "Emission: what shines, where and how strongly",
    "geometry": "Geometry: where things lie",
    "module": "Module: what is of several parts at once",
    "detector": "Detector: the camera, or the instrument that measures a film",
}


def shown_there(predictor: Predictor, known: Known, model: Model, spec: EffectSpec) -> tuple[Document, Arrays]:
    """As `luxloop effects show`, but for two effects, which its example does not show, on one that does."""
    if spec.name == "saturation":
        return _saturated(predictor, model, spec)
    if spec.name == "film_substrate_fringes":
        return _fringes(predictor, model, spec)
    if spec.name in ALONE | NOISY:
        return _averaged(predictor, model, spec)
    return shown(predictor, known, model, spec, values_of(spec, GIVEN.get(spec.name, [])))


def _averaged(predictor: Predictor, model: Model, spec: EffectSpec) -> tuple[Document, Arrays]:
    """One chip or the example module with the largest values, the mean of several runs of Monte Carlo."""
    values = values_of(spec, (ALONE | NOISY)[spec.name])
    view = View(MODULE, rows=41, columns=41, pixel_um=60.0, centre_px=(20.0, 20.0))
    if spec.name in ALONE:
        sample = Sample(id="alone", layout="single", **MODULE.design.model_dump())
        view = View(sample, rows=25, columns=25, pixel_um=40.0, centre_px=(12.0, 12.0))
    models = (model, with_effect(model, applied(spec, values)))
    sights = [Sight(predictor, [view], histories=HISTORIES, seed=seed) for seed in SEEDS]
    base, after = (np.mean([sight.parts(one, traced=True)[0] for sight in sights], axis=0) for one in models)
    on = f"{'one chip, ' if spec.name in ALONE else ''}{len(SEEDS) * HISTORIES / 1e6:g} million histories"
    return _image_facts(values, base, after, on), {"base": base, "with": after} | _axes(view)


def _image_facts(values: Mapping[str, Any], base: Real, after: Real, on: str) -> Document:
    rms = 100.0 * float(np.sqrt(np.mean((after - base) ** 2)) / base.mean())
    return {"kind": "image", "values": values, "rms_percent": rms, "on": on}


def _axes(view: View) -> Arrays:
    sides = {"x_um": view.columns, "y_um": view.rows}
    return {name: np.asarray((np.arange(n) - n // 2) * view.pixel_um, np.float64) for name, n in sides.items()}


def _saturated(predictor: Predictor, model: Model, spec: EffectSpec) -> tuple[Document, Arrays]:
    """The example module, exposed up to full scale."""
    view = sensible(predictor, model)
    assert view.sensor is not None
    sensor = replace(view.sensor, gain_dn=view.sensor.gain_dn / PEAK_SHARE)
    values = values_of(spec, ["knee=0.8"])
    sight = Sight(predictor, [replace(view, sensor=sensor)])
    (base,), (after,) = (sight.parts(one) for one in (model, with_effect(model, applied(spec, values))))
    return _image_facts(values, base, after, "exposed up to full scale"), {"base": base, "with": after} | _axes(view)


def _fringes(predictor: Predictor, model: Model, spec: EffectSpec) -> tuple[Document, Arrays]:
    """The example film on a thin window instead of silicon."""
    window = FilmLayer(material="SiO2", thickness_nm=WINDOW_NM, coherent=False)
    film = FilmSample(id="window", exit="air", layers=(*FILM.layers, window))
    wavelength_nm = np.linspace(540.0, 580.0, 161)
    curves = [Curve(film, name, wavelength_nm, np.zeros(161), ["u"] * 161) for name in ("R", "T")]
    values = values_of(spec, ["coherent_share=0.3"])
    moved = with_effect(model, applied(spec, values))
    found = {which: predictor.spectra(one, curves) for which, one in (("base", model), ("with", moved))}
    arrays = {f"{name}/{which}": found[which][n].value for which in found for n, name in enumerate(("R", "T"))}
    on = f"on {WINDOW_NM / 1e3:g} um of SiO2"
    return {"kind": "curve", "values": values, "on": on}, arrays | {"wavelength_nm": wavelength_nm}


def draw(document: Document, arrays: Arrays, path: Path) -> None:
    """A signature as a small PNG of few colours: the difference and a cut, or a film's curves."""
    with rc_context(TEXT | {"font.size": 7.5}):
        figure = _image(arrays) if document["kind"] == "image" else _curves(arrays)
        file = BytesIO()
        figure.savefig(file, format="png", dpi=DPI, facecolor="white")
    Image.open(file).convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE).save(path, optimize=True)


def _image(arrays: Arrays) -> Figure:
    figure = Figure(figsize=(7.2, 2.3), layout="constrained")
    area, cut, beside = figure.subplots(1, 3, width_ratios=(1.15, 1.0, 1.0))
    x_mm, y_mm = arrays["x_um"] / 1e3, arrays["y_um"] / 1e3
    base, after = arrays["base"], arrays["with"]
    difference = 100.0 * (after - base) / base.mean()
    most = float(np.abs(difference).max())
    extent = (x_mm[0], x_mm[-1], y_mm[0], y_mm[-1])
    drawn = area.imshow(difference, origin="lower", extent=extent, cmap="RdBu_r", vmin=-most, vmax=most)
    figure.colorbar(drawn, ax=area)
    area.set_title("difference, % of the mean")
    middle = len(base) // 2
    cut.plot(x_mm, base[middle] / base.mean(), color=INK, linewidth=1.0, label="without")
    cut.plot(x_mm, after[middle] / base.mean(), color=ORANGE, linewidth=1.0, label="with")
    cut.set_ylim(0.0, None)
    cut.set_title("middle row, over the mean")
    cut.legend()
    beside.axhline(0.0, color=GREY, linewidth=0.8)
    beside.plot(x_mm, difference[middle], color=BLUE, linewidth=1.0)
    beside.set_title("middle row, difference in %")
    for axes in (area, cut, beside):
        axes.set_xlabel("x (mm)")
    return figure


def _curves(arrays: Arrays) -> Figure:
    figure = Figure(figsize=(7.2, 2.1), layout="constrained")
    labels = {"R": "R at 0°", "T": "T at 0°", "psi": "psi at 70° (deg)", "delta": "delta at 70° (deg)"}
    names = [name for name in labels if f"{name}/base" in arrays]
    for axes, name in zip(figure.subplots(1, len(names)), names, strict=True):
        axes.plot(arrays["wavelength_nm"], arrays[f"{name}/base"], color=INK, linewidth=1.0, label="without")
        axes.plot(arrays["wavelength_nm"], arrays[f"{name}/with"], color=ORANGE, linewidth=1.0, label="with")
        axes.set_xlabel("wavelength (nm)")
        axes.set_title(labels[name])
    figure.axes[0].legend()
    return figure


def compare(predictor: Predictor, known: Known, model: Model, specs: Sequence[EffectSpec]) -> None:
    """The cosines of all pairs, as numbers and as a picture."""
    grounds = image_ground(model, predictor, known), curve_ground(model, predictor)
    found = [confusion(one, model, specs, lambda said: print(said, flush=True)) for one in grounds]
    document = {"model": model.name, "maps": [one.document() for one in found]}
    LIKENESS.write_text(json.dumps(document) + "\n", encoding="utf-8")
    draw_confusion({"model": model.name, "maps": [found[0].document()]}, {}, MAP)


# The words


def page(specs: tuple[EffectSpec, ...], facts: Mapping[str, Document], maps: Sequence[Document]) -> Iterator[str]:
    """docs/effects.md, block by block."""
    yield "# Effects"
    yield (
        f"The {len(specs)} effects of the catalogue, by stage: stages act in the order of this page, effects of one"
        " stage in that of the model file, but for a few that must come first or last in theirs (dispersion and"
        " a film's missing layer first; mixing of a film's layers, the sensor's nonlinearity and saturation last)."
        " Each is a file of [containers/effects](../containers/effects), acts on what its stage may change and on"
        " nothing else, and at its off value, where it has one, gives back the very same model. How well each is"
        " predicted stands in [figures](figures.md#effects); `luxloop effects new NAME --stage STAGE` writes one of"
        " your own."
    )
    yield (
        "Pictures: what the effect does to a 5 x 5 array (D 180, W 40, S 500, T 20 um, 2.5 pairs, model `paper`) or"
        " to 300 nm of a polymer on silicon, at a third of its range, or as the line below a picture says;"
        " `luxloop effects show NAME` draws it larger, with values of your choice. The rms has what is left of noise"
        " in it. This page is written by `python -m benchmarks.effects_gallery`."
    )
    yield from _alike(specs, maps)
    for stage, title in STAGES.items():
        yield f"## {title}"
        for spec in specs:
            if spec.stage == stage:
                yield from _effect(spec, facts.get(spec.name, {}), maps)


def _alike(specs: Sequence[EffectSpec], maps: Sequence[Document]) -> Iterator[str]:
    if not maps:
        return
    yield "## Easily mistaken for each other"
    yield (
        "Cosines between what is left of two effects' signatures once gains, offsets, places and the free parameters"
        " of model `paper` have taken what they can; 1: no such data can tell them apart. Six images (a single chip"
        " and a 5 x 5 array, with 0, 2.5 and 5.5 pairs, one distance), and 300 nm of a polymer on silicon (R, T, psi,"
        " delta; its thickness and index free). Boxes are groups beyond 0.9; a diagnosis names the group, and"
        " `luxloop next` the measurement that would tell. An effect of every chip is alike with all that 25 numbers"
        " can imitate. The noise of the walks is in it: effects whose chips must be walked anew (dbr_absorption,"
        " side_wall_roughness, current_crowding, electrode_shadow) stand out by more, and are alike with less, than"
        " they are, and so do those that Monte Carlo alone represents (edge_walls, receiver_tilt). `luxloop effects"
        " confusion DATASET --page map.html` shows what your own data can tell."
    )
    yield "![Cosines of all pairs of effects on six images, groups boxed](images/effects/confusion.png)"
    for one in maps:
        rows = [f"| {_link(name)} | {one['sigma'][name]:.3g} | {_others(one, name)} |" for name in one["names"]]
        head = f"| effect on {one['ground']} | sigma at a third of its range | most alike (cosine) |"
        yield "\n".join((head, "|---|---|---|", *rows))
        if one["imitated"]:
            yield f"Wholly imitated by calibration: {', '.join(map(_link, one['imitated']))}."
    left = [spec for spec in specs if all(spec.name not in one["names"] for one in maps)]
    discrete, idle = (", ".join(_link(one.name) for one in left if one.discrete is kind) for kind in (True, False))
    yield (
        f"In neither table: {discrete}, which have no slope at off (refits test them); {idle}, which change nothing"
        " here, where no substrate is a thick layer and no pixel is near full scale."
    )


def _others(one: Document, name: str) -> str:
    """The nearest others with their cosines."""
    row = dict(zip(one["names"], one["cosines"][one["names"].index(name)], strict=True))
    near = sorted(((cosine, other) for other, cosine in row.items() if other != name), reverse=True)[:NEAREST]
    return ", ".join(f"{_link(other)} {cosine:.2f}" for cosine, other in near if cosine >= TOLD) or "-"


def _effect(spec: EffectSpec, facts: Document, maps: Sequence[Document]) -> Iterator[str]:
    yield f"### {spec.name}"
    yield f"{spec.description} `{spec.formula}`"
    rows = [f"| `{one.name}` | {one.description} | {_range(one)} | {_off(one)} |" for one in spec.parameters]
    yield "\n".join(("| parameter | what it is | range | off |", "|---|---|---|---|", *rows))
    lines = [f"source: {spec.reference}", f"one value holds {_scope(spec)}; predicted by {_by(spec)}"]
    lines.append(f"keeps {' and '.join(spec.conserves)}" if spec.conserves else "may change how much light there is")
    lines += [f"not beside {', '.join(map(_link, spec.excludes))}"] if spec.excludes else []
    near = [_others(one, spec.name) for one in maps if spec.name in one["names"]]
    lines += [f"most alike: {others}" for others in near if others != "-"]
    yield "\n".join(f"- {line}" for line in lines)
    if (PICTURES / f"{spec.name}.png").exists():
        yield f"![{spec.name}: difference and cut](images/effects/{spec.name}.png)"
        yield f"*{_caption(facts)}*"
    elif facts:
        yield "*No picture: it changes neither the example module nor the example film.*"


def _range(one: EffectParameter) -> str:
    text = one.allowed.replace("|", "/")
    grid = ", ".join(f"{value:g}" for value in one.shape_grid)
    return f"{text}; a shape, tried at {grid}" if grid else text


def _off(one: EffectParameter) -> str:
    off = "-" if one.off is None else one.off if isinstance(one.off, str) else f"{one.off:g}"
    return off + ("; counts by its square" if one.score_variable == "square" else "")


def _scope(spec: EffectSpec) -> str:
    return {"global": "for all data", "per_camera": "per camera", "per_sample": "per sample"}[spec.scope]


def _by(spec: EffectSpec) -> str:
    by = "the twin and by Monte Carlo" if spec.twin else "Monte Carlo alone: the twin cannot represent it"
    return by + ("; it has no slope at off, so refits test it" if spec.discrete else "")


def _link(name: str) -> str:
    return f"[{name}](#{name})"


def _caption(facts: Document) -> str:
    values = ", ".join(f"{name} {_short(value)}" for name, value in facts["values"].items())
    values += f", {facts['on']}" if "on" in facts else ""
    return f"{values}: {_size(facts)}" if facts["kind"] == "image" else values


def _size(document: Document) -> str:
    return f"{document['rms_percent']:.2g} % rms of the mean" if document["kind"] == "image" else "-"


def _short(value: Any) -> str:
    if isinstance(value, list | tuple):
        return f"{min(value):g} and {max(value):g} in turn"
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def main() -> None:
    """Ask, draw, write."""
    asked = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    asked.add_argument("--only", action="append", help="draw this one alone; can be given again")
    asked.add_argument("--words", action="store_true", help="draw none")
    asked.add_argument("--map", action="store_true", help="compare all with each other; draw nothing else")
    given = asked.parse_args()
    PICTURES.mkdir(parents=True, exist_ok=True)
    facts: dict[str, Any] = json.loads(FACTS.read_text(encoding="utf-8")) if FACTS.exists() else {}
    model = find_model("paper")
    with Client(load_settings(), patience_s=PATIENCE_S) as client:
        known, predictor = Known.ask(client), Predictor(client)
        specs = tuple(spec for spec in known.specs if spec.source_sha256 is None)
        if given.map:
            compare(predictor, known, model, specs)
        for spec in () if given.words or given.map else specs:
            if given.only and spec.name not in given.only:
                continue
            document, arrays = shown_there(predictor, known, model, spec)
            if arrays:
                draw(document, arrays, PICTURES / f"{spec.name}.png")
            kept = ("kind", "values", "rms_percent", "on")
            facts[spec.name] = {name: document[name] for name in kept if name in document}
            print(f"{spec.name:<26} {document['kind']:<8} {_size(document)}", flush=True)
    FACTS.write_text(json.dumps(facts, indent=1, sort_keys=True) + "\n", encoding="utf-8")
    maps = json.loads(LIKENESS.read_text(encoding="utf-8"))["maps"] if LIKENESS.exists() else []
    (DOCS / "effects.md").write_text("\n\n".join(page(specs, facts, maps)) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
