"""A data set made from a model: what a declared camera would have recorded of its samples, noise included.

    model, samples --Monte Carlo or twin--> irradiance --exposure--> expected signal --EMVA 1288, seed--> raw images

The expected signals (`simulated_images`) are kept apart from the noise (`write_dataset`), so that a study of coverage
draws many data sets from one run of Monte Carlo.
"""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from luxloop import __version__
from luxloop.errors import InputError
from luxloop.files import whole
from luxloop.model_file import find_model, to_toml
from validation.dataset.folder import write_sums
from validation.dataset.images import write_tiff
from validation.dataset.manifest import ImageShot, Manifest, Shot
from validation.dataset.manifest_file import MANIFEST
from validation.dataset.manifest_file import to_toml as manifest_text
from validation.dataset.simulated_curves import (
    ExpectedCurve,
    Instruments,
    expected_far_fields,
    expected_spectra,
    numbers_of,
    quantities_of,
)
from validation.dataset.simulated_images import (
    HISTORIES,
    PEAK_SHARE,
    PIXELS,
    Expected,
    Solver,
    exposed,
    own_sigma,
    told_noise,
    views_of,
)
from validation.dataset.simulation_plan import Plan, paper_plan, read_plan, with_camera
from validation.noise import draw

if TYPE_CHECKING:
    from luxloop.model import Model

PATIENCE_S = 300.0
"""A worker that starts for the first time compiles its kernels."""
MODEL_ERROR = 0.3
"""Of a far field, in its sigma: a truth with a larger error is seen by whoever compares it with the same model."""
TRUTH, TRUTH_MODEL = "truth.toml", "truth-model.toml"
PART = ".being-made"
"""In the folder of a data set, while it is simulated."""


def write_dataset(
    folder: Path,
    plan: Plan,
    expected: Sequence[Expected],
    *,
    seed: int,
    frames: int = 1,
    pattern_seed: int | None = None,
    notes: str = "",
    curves: Sequence[ExpectedCurve] = (),
) -> Manifest:
    """A data set in an empty folder: shots with their noise, manifest, hashes. The same seed gives the same bytes.

    Raw numbers of a single frame are uint16, means of several float32. `pattern_seed` is that of the camera's fixed
    pattern, by default `seed`.
    """
    shots: list[Shot] = []
    for number, one in enumerate(expected):
        raw = draw(one.signal_dn, plan.camera, seed=seed, shot=number, frames=frames, pattern_seed=pattern_seed)
        file = f"images/{one.view.sample.id}.tif"
        write_tiff(folder / file, raw.astype(np.uint16 if frames == 1 else np.float32))
        shots.append(
            ImageShot(
                id=one.view.sample.id,
                kind="image",
                sample=one.view.sample.id,
                file=file,
                exposure_ms=one.exposure_ms,
                frames_averaged=frames,
            )
        )
    for number, curve in enumerate(curves):
        curve.write(folder, seed, number)
        shots.append(curve.shot)
    shown = {shot.film for shot in shots if shot.kind == "spectrum"}
    manifest = Manifest(
        name=plan.name,
        licence=plan.licence,
        notes=notes,
        camera=plan.camera if expected else None,
        samples=plan.samples if {shot.kind for shot in shots} - {"spectrum"} else (),
        films=tuple(film for film in plan.films if film.id in shown),
        shots=tuple(shots),
    )
    with whole(folder / MANIFEST) as fresh:
        fresh.write_text(manifest_text(manifest), encoding="utf-8")
    write_sums(folder)
    return manifest


def simulate(
    out: Annotated[Path, typer.Argument(help="Folder to write; it must be empty or not there yet.")],
    model: Annotated[str, typer.Option(help="paper, clear_chip, or a model file: the truth.")] = "paper",
    plan: Annotated[
        Path | None,
        typer.Option(help="TOML with the tables camera, samples, films; else the paper's six groups."),
    ] = None,
    solver: Annotated[Solver, typer.Option(help="Monte Carlo, or its deterministic twin.")] = "monte_carlo",
    histories: Annotated[int, typer.Option(min=1, help="Of Monte Carlo, for each sample.")] = HISTORIES,
    seed: Annotated[int, typer.Option(min=0, max=10**15, help="Of histories, noise, shifts, turns.")] = 1,
    pixels: Annotated[int, typer.Option(min=8, max=4096, help="Rows and columns of the images.")] = PIXELS,
    pixel_um: Annotated[float | None, typer.Option(help="Side of a pixel on the receiver.")] = None,
    frames: Annotated[int, typer.Option(min=1, max=10_000, help="Averaged into one image.")] = 1,
    prnu_percent: Annotated[float | None, typer.Option(help="Fixed pattern of the camera, rms.")] = None,
    peak_share: Annotated[
        float, typer.Option(help="Of full scale or full well, where the peak of every image is.")
    ] = PEAK_SHARE,
    shift_px: Annotated[float, typer.Option(min=0.0, help="Images shifted at random, sd in pixels.")] = 0.0,
    rotation_deg: Annotated[float, typer.Option(min=0.0, help="Images turned at random, sd in degrees.")] = 0.0,
    images: Annotated[bool, typer.Option("--images/--no-images", help="Whether there are images at all.")] = True,
    spectra: Annotated[str, typer.Option(help="R, T, psi, delta of the plan's films; with commas.")] = "",
    wavelengths: Annotated[str, typer.Option(help="Of spectra, nm: from:to:step, or with commas.")] = "400:700:1",
    angle: Annotated[str, typer.Option(help="Angles of incidence of spectra, deg: the same.")] = "0",
    sigma: Annotated[float, typer.Option(help="Standard deviation of R and T.")] = 0.002,
    sigma_deg: Annotated[float, typer.Option(help="Standard deviation of psi and delta, deg.")] = 0.05,
    far_field: Annotated[bool, typer.Option("--far-field", help="A goniometer curve of each sample.")] = False,
    far_sigma: Annotated[float, typer.Option(help="Its standard deviation, of its peak.")] = 0.02,
    keep_truth: Annotated[
        bool, typer.Option("--keep-truth", help="Write truth.toml and truth-model.toml beside the data.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", help="Say nothing on stderr but errors.")] = False,
) -> None:
    """Make a data set from a model: images with a camera's noise, spectra, far fields. A seed repeats it."""
    from luxloop.client import Client
    from luxloop.settings import load_settings, usable_cache

    wanted = Instruments(
        quantities_of(spectra), numbers_of("--wavelengths", wavelengths, 1.0, 1e6),
        numbers_of("--angle", angle, 0.0, 89.9), sigma, sigma_deg, far_field, far_sigma,
    )  # fmt: skip
    if not (images or wanted.quantities or far_field):
        raise InputError("--no-images", True, "--spectra or --far-field beside it", "something must be measured")
    _within("--shift-px", shift_px, pixels / 2.0, "half an image: more would show nothing of the sample")
    _within("--rotation-deg", rotation_deg, 180.0, "half a turn")
    truth = find_model(model)
    chosen = with_camera(
        paper_plan() if plan is None else read_plan(plan), pixel_um=pixel_um, prnu_percent=prnu_percent
    )
    views = views_of(chosen, seed, pixels, pixels, shift_px, rotation_deg) if images else []
    show = sys.stderr.isatty() and not quiet
    settings = load_settings()
    usable_cache(settings)
    how = f"Monte Carlo, {histories:,} histories a sample" if solver == "monte_carlo" else "the deterministic twin"
    by = f"Simulated by luxloop {__version__}" + (f": images by {how}." if images else ".")
    name = _name(chosen, truth if keep_truth else None, seed, images or far_field)
    with (
        _being_made(out) as folder,
        Client(settings, patience_s=PATIENCE_S) as client,
        _bar(len(views), show) as heard,
    ):
        how_made: dict[str, Any] = {"solver": solver, "histories": histories, "seed": seed, "heard": heard}
        expected = exposed(client, truth, views, chosen.camera, peak_share, **how_made) if images else []
        curves = expected_spectra(client, truth, chosen.films, wanted)
        curves += expected_far_fields(client, truth, chosen.samples, wanted, histories=histories, seed=seed)
        if keep_truth:
            traced = {"histories": histories} if solver == "monte_carlo" else {}
            _write_truth(folder, truth, expected, {"solver": solver, **traced, "seed": seed})
        chosen = chosen.model_copy(update={"name": name})
        made = write_dataset(folder, chosen, expected, seed=seed, frames=frames, notes=by, curves=curves)
    own = {one.view.sample.id: one.own_noise(chosen.camera, frames) for one in expected}
    own_in_all = own_sigma(expected, chosen.camera, frames)
    told = {
        "folder": str(out), "shots": [shot.id for shot in made.shots], "solver": solver,
        "histories": histories if solver == "monte_carlo" or far_field else None, "seed": seed,
        "truth_kept": keep_truth, "far_field_model_error": max((one.model_error for one in curves), default=0.0),
        "images_own_noise": own, "images_own_sigma": own_in_all,
    }  # fmt: skip
    words = [
        *_told(out, made, pixels, how, seed, curves),
        *told_noise(own, own_in_all, histories),
        f"next: luxloop compare {out}",
    ]
    typer.echo(json.dumps(told) if as_json else "\n".join(words))


def _name(plan: Plan, truth: Model | None, seed: int, modules: bool) -> str:
    """What pages call the data: what was looked at and with which seed; in which model where that may be known."""
    what = plan.name if modules else f"spectra of {', '.join(film.id for film in plan.films)}"
    return f"{what}; " + (f"model {truth.name}, " if truth else "") + f"seed {seed}"


def _told(
    folder: Path, made: Manifest, pixels: int, how: str, seed: int, curves: Sequence[ExpectedCurve]
) -> Iterator[str]:
    """What was made, in lines for people."""
    parts: dict[str, Sequence[Shot]] = {
        f"images of {pixels} x {pixels} pixels by {how}": made.images(),
        "spectra": made.spectra(),
        "far fields by Monte Carlo": made.far_fields(),
    }
    yield f"{folder}: {', '.join(f'{len(some)} {what}' for what, some in parts.items() if some)}, seed {seed}"
    worst = max((one.model_error for one in curves), default=0.0)
    if worst > MODEL_ERROR:
        mend = "more --histories, or a larger --far-sigma"
        yield f"the far fields' own Monte Carlo error is {worst:.2g} of their sigma: {mend}"


def _within(option: str, value: float, most: float, why: str) -> None:
    """InputError for a standard deviation that is no number, below 0, or above `most`."""
    if not 0.0 <= value <= most:
        raise InputError(option, value, f"0 to {most:g}, {why}", "0 for none")


@contextmanager
def _being_made(out: Path) -> Iterator[Path]:
    """Where to write what will be in the folder, which must be empty or not there yet; moved there when it is whole.

    A folder that was not there and stays empty is taken away again. Raises InputError where it has something in it,
    cannot be made, or another command is making it.
    """
    part = out / PART
    try:
        there = out.exists()
        out.mkdir(parents=True, exist_ok=True)
        part.mkdir()
    except OSError as error:
        mend = str(error.strerror)
        if part.is_dir():
            mend = f"another command is making it; if none does any more, remove {part}"
        raise InputError("OUT", str(out), "a folder that can be written, by one command at a time", mend) from None
    try:
        if any(path != part for path in out.iterdir()):
            raise InputError("OUT", str(out), "an empty folder, or one that is not there yet", "name another one")
        yield part
        for path in sorted(part.iterdir(), key=lambda path: path.name == MANIFEST):  # which makes it a data set
            path.rename(out / path.name)
    finally:
        shutil.rmtree(part, ignore_errors=True)
        if not there:
            with suppress(OSError):  # there is something in it
                out.rmdir()


def _write_truth(folder: Path, model: Model, expected: Sequence[Expected], how: dict[str, Any]) -> None:
    """The model, and what was drawn for each image."""
    lines = [f"{name} = {json.dumps(value)}" for name, value in how.items()]
    lines += [f'model = "{TRUTH_MODEL}"', f'model_sha256 = "{model.sha256}"']
    for one in expected:
        pose = one.view.pose
        lines += [
            "", "[[images]]", f'id = "{one.view.sample.id}"', f"gain_dn = {one.gain_dn!r}",
            f"shift_px = {list(pose.shift_px)}", f"rotation_deg = {pose.rotation_deg!r}",
        ]  # fmt: skip
    (folder / TRUTH).write_text("\n".join(lines) + "\n", encoding="utf-8")
    (folder / TRUTH_MODEL).write_text(to_toml(model), encoding="utf-8")


@contextmanager
def _bar(total: int, show: bool) -> Iterator[Callable[[int, int], None]]:
    """A bar on stderr, and what moves it."""
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True, disable=not show) as progress:
        bar = progress.add_task("images", total=total)
        yield lambda done, of: progress.update(bar, completed=done, total=of)
