"""Images of the blind truth: agreement with the project's Monte Carlo, random numbers, hidden kinds, bad input."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import containers.effects
from luxloop.effect import AppliedEffect
from luxloop.model_file import find_model
from tests.validation.blind.truths import ARRAY, CAMERA, PAPER, SINGLE, STRAIGHT
from tests.validation.workers import Workers
from validation.blind import KINDS, Hidden, Pose, Real, compiled, light
from validation.dataset.manifest import Sample as PlanSample
from validation.prediction import Pose as ViewPose
from validation.prediction import Predictor, View

HISTORIES = 4_000


@cache
def seen(*hidden: Hidden, seed: int = 1, histories: int = HISTORIES) -> list[Real]:
    """The images of a single chip and of an array."""
    return light(PAPER, [SINGLE, ARRAY], CAMERA, STRAIGHT, hidden, seed=seed, histories=histories)


def test_what_is_off_is_not_there() -> None:
    """All kinds at their off value: the plain images, bit for bit."""
    off = light(
        PAPER, [SINGLE, ARRAY], CAMERA, STRAIGHT, [Hidden(name, kind.off, 7) for name, kind in KINDS.items()],
        seed=1, histories=HISTORIES,
    )  # fmt: skip
    for one, plain in zip(off, seen(), strict=True):
        np.testing.assert_array_equal(one, plain)


@pytest.mark.parametrize("name", [name for name, kind in KINDS.items() if kind.place != "camera"])
def test_what_is_hidden_changes_the_image(name: str) -> None:
    """At the most each kind changes an image by more than 0.1 % of its peak beyond a gain, and keeps light finite."""
    found, changes = seen(Hidden(name, KINDS[name].most, 3)), []
    for image, plain in zip(found, seen(), strict=True):
        assert np.isfinite(image).all()
        assert image.min() >= -0.1 * plain.max()
        gain = (image * plain).sum() / (plain * plain).sum()
        changes.append(float(np.abs(image - gain * plain).max() / plain.max()))
    assert max(changes) > 1e-3


def test_kinds_of_several_chips_leave_a_single_one() -> None:
    """Powers, places and sizes of several chips: a single chip has none of them, bit for bit."""
    for name in ("binning", "weak_chip", "shaken_chips", "chip_sizes"):
        np.testing.assert_array_equal(seen(Hidden(name, KINDS[name].most, 3))[0], seen()[0])


@pytest.mark.parametrize("name", ["graded_loss", "tilted_chips", "bowed_receiver", "binning", "dark_joints"])
def test_hidden_truths_share_their_random_numbers(name: str) -> None:
    """A hundredth of a kind changes less than another seed does: noise goes with the change."""
    kind = KINDS[name]
    little = seen(Hidden(name, kind.off + 0.01 * (kind.most - kind.off), 3))[1]
    assert np.abs(little - seen()[1]).std() < 0.5 * np.abs(seen(seed=2)[1] - seen()[1]).std()


def test_the_same_seed_repeats_an_image() -> None:
    """Bit for bit, alone or beside another sample."""
    again = light(PAPER, [ARRAY, SINGLE], CAMERA, STRAIGHT, seed=1, histories=HISTORIES)
    np.testing.assert_array_equal(again[0], seen()[1])


THICK = AppliedEffect(name="active_layer_thickness", parameters={"reach": 0.4 / 0.99})


@pytest.mark.parametrize(
    ("sample", "hidden", "effects"),
    [(SINGLE, (), ()), (ARRAY, (), ()), (SINGLE, (Hidden("thick_active_layer", 0.2),), (THICK,))],
    ids=["single", "array", "single, thick layer"],
)
def test_light_is_the_projects_monte_carlo(
    sample: Any, hidden: tuple[Hidden, ...], effects: tuple[AppliedEffect, ...], tmp_path: Path
) -> None:
    """Two programs without common code agree within both noises, in a turned and shifted camera: with nothing hidden,
    and with a layer at 0.99 T that is 0.4 T thick, which is not the light of a thin one."""
    count = 400_000
    pose = Pose(1.5, -2.25, 3.0)
    single = sample.chips == 1
    plan = PlanSample(
        id=sample.id, layout="single" if single else "array", rows=sample.rows, columns=sample.columns,
        distance_um=sample.distance_um, width_um=sample.width_um, spacing_um=sample.spacing_um,
        thickness_um=sample.thickness_um, dbr_pairs=sample.dbr_pairs, module_half_um=sample.module_half_um,
    )  # fmt: skip
    view = View(
        plan, CAMERA.rows, CAMERA.columns, CAMERA.pixel_um, ((CAMERA.rows - 1) / 2, (CAMERA.columns - 1) / 2),
        ViewPose((pose.shift_row_px, pose.shift_column_px), pose.rotation_deg),
    )  # fmt: skip
    plain, predictor = find_model("paper"), Predictor(Workers(tmp_path))
    model = plain.model_copy(update={"effects": effects})
    theirs = np.array([predictor.monte_carlo(model, [view], count, seed)[0].irradiance_per_mm2 for seed in range(4)])
    ours = np.array(
        [light(PAPER, [sample], CAMERA, [pose], hidden, seed=seed, histories=count)[0] for seed in range(2)]
    )
    mean, other = theirs.mean(axis=0), ours.mean(axis=0)
    assert np.isclose(mean.mean(), other.mean(), rtol=2e-3)
    variance = theirs.var(axis=0, ddof=1).mean() / 4.0 + ours.var(axis=0, ddof=1).mean() / 2.0
    assert np.sqrt(np.mean((mean - other) ** 2) / variance) < 1.6
    if hidden:
        (thin,) = predictor.monte_carlo(plain, [view], count, 9)
        assert np.sqrt(np.mean((thin.irradiance_per_mm2 - other) ** 2) / variance) > 4.0


def test_every_image_effect_of_the_catalogue_is_hidden() -> None:
    """Once, but for blur off the axis: a curved field and an astigmatism; and twenty kinds that it lacks, or more."""
    files = (Path(containers.effects.__file__).parent).glob("[a-z]*.py")
    images = {path.stem for path in files if not path.stem.startswith("film_")}
    right = [effect for kind in KINDS.values() for effect in kind.right]
    assert sorted(right) == sorted([*images, "off_axis_blur"])
    outside = [kind.place for kind in KINDS.values() if not kind.right]
    assert len(outside) >= 20
    assert set(outside) == {"optics", "module", "camera"}


def test_it_imports_nothing_of_the_project() -> None:
    """Computing light loads no other module of this project, and its words load neither numba nor scipy."""
    code = (
        "import sys, validation.blind as b\n"
        "assert not {'numba', 'scipy', 'pydantic'} & set(sys.modules)\n"
        "import validation.blind.module, validation.blind.sensor\n"
        "ours = ('luxloop', 'containers', 'agent', 'env_controller', 'viewer', 'validation')\n"
        "found = {n for n in sys.modules if n.split('.')[0] in ours and not n.startswith('validation.blind')}\n"
        "assert found == {'validation'}, found\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize(
    ("hidden", "told"),
    [([Hidden("gremlins", 1.0)], "gremlins"), ([Hidden("dust", 0.5)], "0 to 0.3"),
     ([Hidden("dust", -0.1)], "0 to 0.3"),
     ([Hidden("swapped_layers", 0.5)], "0 or 1"), ([Hidden("dust", 0.1), Hidden("dust", 0.2)], "once"),
     ([Hidden("dust", float("nan"))], "nan"), ([Hidden("dust", 0.1, -1)], "seed")],
)  # fmt: skip
def test_what_cannot_be_hidden_is_refused(hidden: Sequence[Hidden], told: str) -> None:
    """Unknown, out of range, half a discrete one, twice, no number, no seed: ValueError says which."""
    with pytest.raises(ValueError, match=told):
        light(PAPER, [SINGLE], CAMERA, [Pose()], hidden, seed=1, histories=10)


def test_what_cannot_be_built_or_seen_is_refused() -> None:
    """Samples, surroundings, cameras, poses and counts out of range: ValueError names the field."""
    for field, value in (("distance_um", 24.0), ("dbr_pairs", 2.3), ("rows", 0), ("module_half_um", 20.0)):
        with pytest.raises(ValueError, match=field):
            replace(SINGLE, **{field: value})
    with pytest.raises(ValueError, match="width_um"):
        replace(ARRAY, width_um=390.0)
    for field, value in (("chip_bottom", "glue"), ("n_gan", 1.0), ("receiver_reflectance", 1.0)):
        with pytest.raises(ValueError, match=field):
            replace(PAPER, **{field: value})
    with pytest.raises(ValueError, match="black_level_dn"):
        replace(CAMERA, black_level_dn=5000.0)
    with pytest.raises(ValueError, match="poses"):
        light(PAPER, [SINGLE], CAMERA, [], seed=1, histories=10)
    with pytest.raises(ValueError, match="histories"):
        light(PAPER, [SINGLE], CAMERA, [Pose()], seed=1, histories=0)
    with pytest.raises(ValueError, match="pixel_um"):
        light(PAPER, [SINGLE], replace(CAMERA, pixel_um=400.0), [Pose()], seed=1, histories=10)


def test_compiled_kernels_lie_where_the_workers_do(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """In LUXLOOP_KERNELS, else in the cache: a cache of one's own had them compiled anew, half a minute each time."""
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setenv("LUXLOOP_CACHE", str(tmp_path / "cache"))
    for chosen, home in (("", tmp_path / "cache" / "kernels"), (str(tmp_path / "kernels"), tmp_path / "kernels")):
        monkeypatch.setenv("LUXLOOP_KERNELS", chosen)
        assert Path(compiled._folder()).parent == home
        assert Path(compiled._folder()).name.startswith("blind-")
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "numba"))  # also there by the digest of the sources
    assert Path(compiled._folder()).parent == tmp_path / "numba"
