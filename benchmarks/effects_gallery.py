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
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.effects_page import MAPS, page, size
from benchmarks.effects_pictures import draw
from luxloop.client import Client
from luxloop.effect import EffectSpec
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

Real = NDArray[np.float64]
Document = Mapping[str, Any]
Arrays = dict[str, Real]

DOCS = Path(__file__).parents[1] / "docs"
PICTURES = DOCS / "images" / "effects"
FACTS = PICTURES / "facts.json"
"""Beside the pictures: values they were drawn with, and how large the difference is."""
LIKENESS = PICTURES / "confusion.json"
"""Cosines between all effects."""
PATIENCE_S = 600.0
WINDOW_NM = 20_000.0
GIVEN = {"dbr_layer_order": ["order=aln_first"]}
"""Values other than those of `luxloop effects show`."""
ALONE = {"electrode_shadow": ["dark_share=0.3"], "current_crowding": ["rise=0.3", "rim=0.3"]}
"""What moves light about within a chip: less than the noise of new light on the array, so one chip shows it, near."""
NEAR = {"distance_um": 40.0, "width_um": 100.0, "spacing_um": 300.0, "thickness_um": 20.0, "dbr_pairs": 2.5}
NOISY = {"receiver_tilt": ["tilt_x_per_mm=0.05"], "dbr_absorption": ["extinction=0.01"]}
"""What one prediction of the module does not show for noise."""
SEEDS, HISTORIES = range(1, 9), 2_000_000


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
        sample = Sample(id="alone", layout="single", module_half_um=200.0, **NEAR)
        view = View(sample, rows=31, columns=31, pixel_um=10.0, centre_px=(15.0, 15.0))
    models = (model, with_effect(model, applied(spec, values)))
    base, after = (
        np.mean([predictor.monte_carlo(one, [view], HISTORIES, seed)[0].irradiance_per_mm2 for seed in SEEDS], axis=0)
        for one in models
    )
    where = "one chip, W 100, D 40 um, " if spec.name in ALONE else ""
    on = f"{where}{len(SEEDS) * HISTORIES / 1e6:g} million histories"
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


def compare(predictor: Predictor, known: Known, model: Model, specs: Sequence[EffectSpec]) -> None:
    """The cosines of all pairs, as numbers and as pictures."""
    grounds = image_ground(model, predictor, known), curve_ground(model, predictor)
    found = [confusion(one, model, specs, lambda said: print(said, flush=True)) for one in grounds]
    document = {"model": model.name, "maps": [one.document() for one in found]}
    LIKENESS.write_text(json.dumps(document) + "\n", encoding="utf-8")
    for name, one in zip(MAPS, found, strict=True):
        draw_confusion({"model": model.name, "maps": [one.document()]}, {}, PICTURES / name)


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
            print(f"{spec.name:<26} {document['kind']:<8} {size(document)}", flush=True)
    FACTS.write_text(json.dumps(facts, indent=1, sort_keys=True) + "\n", encoding="utf-8")
    maps = json.loads(LIKENESS.read_text(encoding="utf-8"))["maps"] if LIKENESS.exists() else []
    (DOCS / "effects.md").write_text("\n\n".join(page(specs, facts, maps)) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
