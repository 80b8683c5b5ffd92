"""A data set made from a model: what a declared camera would have recorded of its samples, noise included.

    model, samples --Monte Carlo or twin--> irradiance --exposure--> expected signal --EMVA 1288, seed--> raw images

The expected signals are kept apart from the noise (`expected_images`, `write_dataset`), so that a study of coverage
draws many data sets from one run of Monte Carlo.
"""

from __future__ import annotations

import json
import sys
import tomllib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
import typer
from pydantic import Field, field_validator

from luxloop import __version__
from luxloop.effect import refuse_twice
from luxloop.errors import InputError
from luxloop.model_file import find_model, to_toml
from luxloop.words import Words, parse
from validation.dataset.folder import write_sums
from validation.dataset.images import Real, write_tiff
from validation.dataset.manifest import CameraFacts, ImageShot, Manifest, Sample
from validation.dataset.manifest_file import MANIFEST
from validation.dataset.manifest_file import to_toml as manifest_text
from validation.noise import draw

if TYPE_CHECKING:
    from luxloop.model import Model
    from validation.prediction import View
    from validation.prediction.words import Asks

Solver = Literal["monte_carlo", "twin"]

DECLARED = CameraFacts(
    pixel_um=8.0, bit_depth=12, gain_dn_per_e=0.38, read_noise_e=6.0, full_well_e=10_000.0, black_level_dn=64.0
)
"""The camera at which all targets of the project are stated; one frame of 128 x 128 pixels."""
PIXELS, PEAK_SHARE, HISTORIES = 128, 0.85, 16_000_000
LONGEST_EXPOSURE_MS = 8.0
"""Of the brightest image; the others are exposed so that their peak is as high."""
PATIENCE_S = 300.0
"""A worker that starts for the first time compiles its kernels."""
POSES = 2
"""What a seed is drawn for, beside those of `validation.noise`."""
TRUTH, TRUTH_MODEL = "truth.toml", "truth-model.toml"


class Plan(Words):
    """A plan file: which samples are put before which camera; one image of each."""

    name: str = "simulated"
    licence: str = ""
    camera: CameraFacts = DECLARED
    samples: tuple[Sample, ...] = Field(min_length=1, max_length=64)

    @field_validator("samples")
    @classmethod
    def _ids_differ(cls, samples: tuple[Sample, ...]) -> tuple[Sample, ...]:
        refuse_twice("samples", (sample.id for sample in samples))
        return samples


@dataclass(frozen=True, eq=False)
class Expected:
    """An image before its noise."""

    view: View
    irradiance_per_mm2: Real
    """(row, column), per flux of a chip."""
    signal_dn: Real
    """(row, column), above black."""
    exposure_ms: float


def paper_plan() -> Plan:
    """The paper's six groups: a single chip and 5 x 5 of them, with 0, 2.5 and 5.5 pairs (its Fig. 5)."""
    common = {"distance_um": 180.0, "width_um": 40.0, "spacing_um": 400.0, "thickness_um": 20.0}
    layouts = {"single": {}, "array": {"rows": 5, "columns": 5}}
    samples = [
        parse(Sample, {"id": f"{layout}-{pairs:g}", "layout": layout, "dbr_pairs": pairs, **chips, **common})
        for layout, chips in layouts.items()
        for pairs in (0.0, 2.5, 5.5)
    ]
    return Plan(name="paper-like set, single chips and 5 x 5 arrays", licence="CC0-1.0", samples=tuple(samples))


def read_plan(path: Path) -> Plan:
    """The plan in a TOML file: name, licence, [camera], [[samples]] as in a data set; InputError for other things."""
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError("--plan", str(path), "a TOML file with [[samples]]", str(error)) from None
    return parse(Plan, data, path.name)


def views_of(
    plan: Plan, seed: int, rows: int = PIXELS, columns: int = PIXELS, shift_px: float = 0.0, rotation_deg: float = 0.0
) -> list[View]:
    """The camera before each sample, its centre chip in the middle but for a shift and a turn with these sds."""
    from validation.prediction import Pose, View

    drawn = np.random.default_rng((seed, POSES)).standard_normal((len(plan.samples), 3))
    centre = ((rows - 1) / 2, (columns - 1) / 2)
    return [
        View(
            sample, rows, columns, plan.camera.pixel_um, centre,
            Pose((shift_px * float(row) + 0.0, shift_px * float(column) + 0.0), rotation_deg * float(turn) + 0.0),
        )
        for sample, (row, column, turn) in zip(plan.samples, drawn, strict=True)
    ]  # fmt: skip


def irradiances(
    client: Asks,
    model: Model,
    views: Sequence[View],
    *,
    solver: Solver = "monte_carlo",
    histories: int = HISTORIES,
    seed: int = 1,
    heard: Callable[[int, int], None] | None = None,
) -> list[Real]:
    """What each view sees, (row, column) in 1/mm^2 per flux of a chip; RemoteError with the first failure.

    Parameters
    ----------
    histories : of Monte Carlo, for each view; each has random numbers of its own.
    heard : told how many of how many are done.
    """
    from validation.prediction import Predictor

    predictor = Predictor(client)
    if solver == "twin":
        return [one.irradiance_per_mm2 for one in predictor.images(model, views)]
    return [one.irradiance_per_mm2 for one in predictor.monte_carlo(model, views, histories, seed, heard)]


def expected_images(
    views: Sequence[View], irradiance_per_mm2: Sequence[Real], camera: CameraFacts, peak_share: float = PEAK_SHARE
) -> list[Expected]:
    """The signals of a camera that is exposed so that the peak of each image is at a share of its full scale.

    The gain per exposure is one for all images, so it is evidence too. InputError for a share outside 0 to 1, and for
    an image without light.
    """
    if not 0.0 < peak_share <= 1.0:
        raise InputError("peak_share", peak_share, "above 0 to 1", "0.85 leaves room for the noise")
    full_dn = min(camera.full_scale_dn - camera.black_level_dn, camera.gain_dn_per_e * camera.full_well_e)
    peaks = [float(one.max()) for one in irradiance_per_mm2]
    if min(peaks) <= 0.0:
        sample = views[peaks.index(min(peaks))].sample.id
        raise InputError("irradiance", min(peaks), "light on the camera", f"sample {sample} is dark")
    gain_dn_per_ms = peak_share * full_dn / (LONGEST_EXPOSURE_MS * max(peaks))
    exposures = [round(LONGEST_EXPOSURE_MS * max(peaks) / peak, 3) for peak in peaks]
    return [
        Expected(view, one, gain_dn_per_ms * exposure * np.maximum(one, 0.0), exposure)
        for view, one, exposure in zip(views, irradiance_per_mm2, exposures, strict=True)
    ]


def write_dataset(
    folder: Path,
    plan: Plan,
    expected: Sequence[Expected],
    *,
    seed: int,
    frames: int = 1,
    pattern_seed: int | None = None,
    notes: str = "",
) -> Manifest:
    """A data set in an empty folder: images with their noise, manifest, hashes. The same seed gives the same bytes.

    Raw numbers of a single frame are uint16, means of several float32. `pattern_seed` is that of the camera's fixed
    pattern, by default `seed`.
    """
    shots = []
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
    manifest = Manifest(
        name=plan.name,
        licence=plan.licence,
        notes=notes,
        camera=plan.camera,
        samples=plan.samples,
        shots=tuple(shots),
    )
    (folder / MANIFEST).write_text(manifest_text(manifest), encoding="utf-8")
    write_sums(folder)
    return manifest


def simulate(
    out: Annotated[Path, typer.Argument(help="Folder to write; it must be empty or not there yet.")],
    model: Annotated[str, typer.Option(help="paper, clear_chip, or a model file: the truth.")] = "paper",
    plan: Annotated[
        Path | None, typer.Option(help="TOML with [camera] and [[samples]]; default: the paper's six groups.")
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
    keep_truth: Annotated[
        bool, typer.Option("--keep-truth", help="Write truth.toml and truth-model.toml beside the data.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", help="Say nothing on stderr but errors.")] = False,
) -> None:
    """Make a data set from a model: images of samples with a camera's noise, exposed alike. A seed repeats it."""
    from luxloop.client import Client
    from luxloop.settings import load_settings, usable_cache

    truth, folder = find_model(model), _empty(out)
    chosen = _with_camera(
        paper_plan() if plan is None else read_plan(plan), pixel_um=pixel_um, prnu_percent=prnu_percent
    )
    views = views_of(chosen, seed, pixels, pixels, shift_px, rotation_deg)
    show = sys.stderr.isatty() and not quiet
    settings = load_settings()
    usable_cache(settings)
    with Client(settings, patience_s=PATIENCE_S) as client, _bar(len(views), show) as heard:
        light = irradiances(client, truth, views, solver=solver, histories=histories, seed=seed, heard=heard)
    expected = expected_images(views, light, chosen.camera, peak_share)
    how = f"Monte Carlo, {histories:,} histories a sample" if solver == "monte_carlo" else "the deterministic twin"
    if keep_truth:
        _write_truth(folder, truth, expected, {"solver": solver, "histories": histories, "seed": seed})
    made = write_dataset(
        folder, chosen, expected, seed=seed, frames=frames, notes=f"Simulated by luxloop {__version__}: {how}."
    )
    told = {
        "folder": str(folder), "shots": [shot.id for shot in made.shots], "solver": solver,
        "histories": histories if solver == "monte_carlo" else None, "seed": seed, "truth_kept": keep_truth,
    }  # fmt: skip
    words = f"{folder}: {len(made.shots)} images of {pixels} x {pixels} pixels by {how}, seed {seed}"
    typer.echo(json.dumps(told) if as_json else f"{words}\nnext: luxloop compare {folder}")


def _empty(out: Path) -> Path:
    """The folder, made where it is not there; InputError where it has something in it or cannot be made."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        if any(out.iterdir()):
            raise InputError("OUT", str(out), "an empty folder, or one that is not there yet", "name another one")
    except OSError as error:
        raise InputError("OUT", str(out), "a folder that can be written", str(error.strerror)) from None
    return out


def _with_camera(plan: Plan, **changes: float | None) -> Plan:
    """The plan with what options change of its camera."""
    given = {name: value for name, value in changes.items() if value is not None}
    return plan.model_copy(update={"camera": parse(CameraFacts, plan.camera.model_dump() | given, "camera")})


def _write_truth(folder: Path, model: Model, expected: Sequence[Expected], how: dict[str, Any]) -> None:
    """The model, and what was drawn for each image."""
    lines = [f"{name} = {json.dumps(value)}" for name, value in how.items()]
    lines += [f'model = "{TRUTH_MODEL}"', f'model_sha256 = "{model.sha256}"']
    for one in expected:
        pose = one.view.pose
        gain_dn = float(one.signal_dn.max() / one.irradiance_per_mm2.max())
        lines += [
            "", "[[images]]", f'id = "{one.view.sample.id}"', f"gain_dn = {gain_dn!r}",
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
