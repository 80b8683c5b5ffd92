"""The words of docs/effects.md: what the workers say of each effect, and what was measured of it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from luxloop.effect import EffectParameter, EffectSpec

Document = Mapping[str, Any]

MAPS = ("confusion.png", "confusion_of_films.png")
"""Pictures of the cosines, on images and on a film."""
NEAREST, TOLD = 3, 0.5
"""How many others are named as alike, and from which cosine on."""

STAGES = {
    "stack": "Stack: the layers of a chip's mirror, or of a film that was measured",
    "surface": "Surface: what reflects, scatters or records",
    "volume": "Volume: what light passes through",
    "emission": "Emission: what shines, where and how strongly",
    "geometry": "Geometry: where things lie",
    "module": "Module: what is of several parts at once",
    "detector": "Detector: the camera, or the instrument that measures a film",
}


def page(specs: tuple[EffectSpec, ...], facts: Mapping[str, Document], maps: Sequence[Document]) -> Iterator[str]:
    """docs/effects.md, block by block."""
    yield "# Effects"
    yield (
        f"The {len(specs)} effects of the catalogue, by stage: stages act in the order of this page, effects of one"
        " stage in that of the model file, but for a few that must come first or last in theirs (dispersion and"
        " a film's missing layer first; the thickness of the active layer, mixing of a film's layers, the sensor's"
        " nonlinearity and saturation last)."
        " Each is a file of [containers/effects](../containers/effects), acts on what its stage may change and on"
        " nothing else, and at its off value, where it has one, gives back the very same model. How well most"
        " are predicted stands in [figures](figures.md#effects); `luxloop effects new NAME --stage STAGE` writes one"
        " of your own."
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
        " can imitate. Where light takes other ways inside the chips with each value (side_wall_roughness,"
        " active_layer_thickness), or Monte Carlo alone represents an effect (edge_walls, receiver_tilt), it is what"
        " two runs agree about: some noise is left in it, and such an effect is alike with less than it is."
        " `luxloop effects confusion DATASET --page map.html` shows what your own data can tell."
    )
    for name, one in zip(MAPS, maps, strict=True):
        yield f"![Cosines of all pairs of effects on {one['ground']}, groups boxed](images/effects/{name})"
        rows = [f"| {_link(name)} | {one['sigma'][name]:.3g} | {_others(one, name)} |" for name in one["names"]]
        head = f"| effect on {one['ground']} | sigma at a third of its range | most alike (cosine) |"
        yield "\n".join((head, "|---|---|---|", *rows))
        if one["imitated"]:
            yield f"Wholly imitated by calibration: {', '.join(map(_link, one['imitated']))}."
    left = [spec for spec in specs if all(spec.name not in one["names"] + one["imitated"] for one in maps)]
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
    if facts.get("kind", "nothing") != "nothing":
        yield f"![{spec.name}: difference and cut](images/effects/{spec.name}.png)"
        yield f"*{_caption(spec, facts)}*"
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
    by = "transfer matrices" if spec.acts_on == ("films",) else by  # no light is traced through a measured film
    return by + ("; it has no slope at off, so refits test it" if spec.discrete else "")


def _link(name: str) -> str:
    return f"[{name}](#{name})"


def _caption(spec: EffectSpec, facts: Document) -> str:
    values = ", ".join(f"{one.name} {_short(facts['values'][one.name])}" for one in spec.parameters)
    values += f", {facts['on']}" if "on" in facts else ""
    return f"{values}: {size(facts)}" if facts["kind"] == "image" else values


def size(document: Document) -> str:
    """How large the difference is, of an image."""
    return f"{document['rms_percent']:.2g} % rms of the mean" if document["kind"] == "image" else "-"


def _short(value: Any) -> str:
    if isinstance(value, list | tuple):
        return f"{min(value):g} and {max(value):g} in turn"
    return f"{value:.3g}" if isinstance(value, float) else str(value)
