"""The user's own effects: what is wrong with a file is said with the mend, and the worker goes on as it was."""

from __future__ import annotations

import os
import sys
import time
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from containers import catalogue as catalogue_module
from containers import effect_files
from containers.catalogue import Catalogue, told
from containers.effect_files import Loaded, load_folder
from containers.effect_trial import trial
from luxloop.computation import Stopped
from luxloop.effect import AppliedEffect
from luxloop.errors import InputError, RemoteError
from luxloop.messages import Describe

GOOD = '''
from dataclasses import replace
from containers.effect import SceneEffect, parameter
from containers.scene import Scene

class Lift(SceneEffect):
    """The receiver is lifted."""

    name = "my_lift"
    stage = "geometry"
    formula = "D -> D + d"
    reference = "a test"
    lift_um: float = parameter("d", unit="um", lower=0.0, upper=10.0, off=0.0, one_sided=True)

    def scene(self, scene: Scene) -> Scene:
        return replace(scene, distance_um=scene.distance_um + self.lift_um)
'''
DETECTOR = '''
import numpy as np
from containers.effect import DetectorEffect, parameter

class Mine(DetectorEffect):
    """An image is changed."""

    name = "mine"
    formula = "E"
    reference = "a test"
    share: float = parameter("s", unit="", lower=0.0, upper=0.5, off=0.0)

    def light(self, image, camera):
        {body}
'''


def detector(body: str) -> str:
    """A detector effect whose hook is this line."""
    return DETECTOR.replace("{body}", body)


@pytest.fixture(autouse=True)
def no_verdicts(monkeypatch: pytest.MonkeyPatch) -> None:
    """No verdict of an earlier test run is remembered."""
    monkeypatch.delenv("LUXLOOP_CACHE", raising=False)


def looked_through(source: str) -> str:
    """Why a file of that source is refused, by a trial in this process: a second less than in one of its own."""
    findings = tuple(
        {"check": check, "ok": ok, "said": said} for check, ok, said in trial(source.encode(), "mine.py")
    )
    return effect_files._why_refused(findings, "", "mine.py")


def refusal(folder: Path, source: str, name: str = "mine.py", limit_s: float = 20.0) -> str:
    """Why a file of that source is refused."""
    folder.mkdir(exist_ok=True)
    (folder / name).write_text(source)
    found = load_folder(folder, Loaded(), frozenset({"camera_psf"}), limit_s)
    assert not found.known
    return found.refused[name]


def test_a_good_file_is_known_by_its_hash(tmp_path: Path) -> None:
    """Its description has the SHA-256 of its bytes; the trial says a line for each thing it looked at."""
    (tmp_path / "my_lift.py").write_text(GOOD)
    found = load_folder(tmp_path, Loaded(), frozenset())
    assert found.refused == {}
    spec, trial = found.known["my_lift"].spec, found.trials["my_lift.py"]
    assert spec.source_sha256 == trial.sha256
    assert [one["check"] for one in trial.findings] == ["import", "spec", "off", "acts", "again", "end"]
    assert all(one["ok"] for one in trial.findings)


@pytest.mark.parametrize(
    ("source", "said"),
    [
        (detector("return image * (1.0 + self.share)"), ("acts: light of 16 x 16 pixels", "at most 1", "ambient_dn")),
        (detector("return image * (0.9 - self.share)"), ("off: mine at off", "the same to the last bit")),
        (detector("return image if not self.share else image * undefined"), ("acts: ", "line 14", "NameError")),
        (detector("return image if not self.share else image[:-1]"), ("acts: ", "shape (16, 16)")),
        (detector("return image if not self.share else image * np.nan"), ("acts: ", "not finite")),
        (detector("return image if not self.share else image**2 / image.max()"), ("acts: ", "not linear")),
        (detector("return image if not self.share else list(image)"), ("acts: ", "ndarray")),
        (detector("image *= 1.0 - self.share; return image"), ("again: ", "in place", "make a copy")),
        (
            detector("return image * np.random.default_rng().uniform(1 - self.share)").replace("light", "signal"),
            ("again: ", "random numbers"),
        ),
        (detector("import time; time.sleep(0.4 * (self.share > 0)); return image"), ("acts: ", "at most 1 s")),
        ("import not_there_at_all\n" + detector("return image"), ("import: ", "not_there_at_all", "install")),
        (detector("return image").replace('unit="", ', ""), ("import: ", "unit")),
        (detector("return image").replace('unit=""', 'unit="um"'), ("spec: Mine.share: unit", "ends with its unit")),
        (detector("return image").replace("lower=0.0", "lower=0.9"), ("spec: ", "lower", "below upper")),
        (
            detector("return image").replace("off=0.0", 'off=0.1, score="square"'),
            ("spec: Mine.share: off: got 0.1", "0, from which a square is counted", "score the value"),
        ),
        (
            detector("return image").replace("off=0.0", "off=0.1").replace('formula =', 'twin = False; formula ='),
            ("spec: Mine.share: off: got 0.1", "0, of an effect that the twin does not follow", "from there"),
        ),
        (
            detector("return image").replace('formula =', 'discrete = True; formula ='),
            ("spec: Mine.share: off: got 0.0", "none, of a number of a discrete effect", "shape_grid"),
        ),
        (detector("return image").replace('name = "mine"', 'name = "yours"'), ("import: ", "'mine'", "rename")),
        (detector("return image").replace("DetectorEffect)", "DetectorEffect"), ("import: ", "SyntaxError")),
        (detector("return image") + "raise SystemExit(0)\n", ("import: ", "SystemExit")),
        ("x = 1\n", ("import: ", "none", "luxloop effects new")),
    ],
    ids=[
        "creates energy", "off not identical", "exception", "wrong shape", "NaN", "not linear", "not an array",
        "in place", "random", "slow", "import missing", "no unit", "wrong unit", "range",
        "square from elsewhere", "line from elsewhere", "discrete number", "other name", "syntax",
        "exits", "no effect",
    ],
)  # fmt: skip
def test_a_broken_file_is_refused_with_reason_and_mend(source: str, said: tuple[str, ...]) -> None:
    """The sentence begins with the file and has the reason."""
    reason = looked_through(source)
    assert reason.startswith("mine.py: ")
    for part in said:
        assert part in reason


def test_names_and_words_that_are_no_utf_8_can_be_told(tmp_path: Path) -> None:
    """A file named in Latin-1, and one whose error has such a name in it: each is refused, the worker says so."""
    try:
        (tmp_path / os.fsdecode(b"m\xe4rz.py")).write_text("x = 1\n")
    except OSError:
        pytest.skip("this disk takes UTF-8 names only")
    (tmp_path / "mine.py").write_text(r"raise ValueError('m\udce4rz')")
    catalogue = told(Catalogue(tmp_path))
    describe = Describe(worker="w", kind="film", version="1", host="h", pid=1, catalogue=catalogue)
    refused = describe.catalogue["refused_effects"]
    assert "rename it" in refused["m?rz.py"]
    assert "ValueError in line 1: m?rz" in refused["mine.py"]


SCENE = '''
from dataclasses import replace
import numpy as np
from containers.bsdf import Lambertian, Mirror
from containers.effect import SceneEffect, parameter

class Mine(SceneEffect):
    """A surface is changed."""

    name = "mine"
    stage = "surface"
    formula = "f"
    reference = "a test"
    conserves = ("energy",)
    share: float = parameter("s", unit="", lower=0.0, upper=0.5, off=0.0)

    def scene(self, scene):
        {body}
'''


@pytest.mark.parametrize(
    ("body", "said"),
    [
        ("return scene if not self.share else replace(scene, distance_um=170.0)", ("acts: ", "distance_um")),
        ("return scene if not self.share else replace(scene, leak_share=0.5, leak_um=9.0)", ("acts: ", "leak_share")),
        ("return scene if not self.share else replace(scene, substrate=Lambertian(0.5))", ("conserves", "albedo")),
        ("return scene if not self.share else replace(scene, substrate=Lambertian(1.5))", ("acts: ", "reflectance")),
        ("return scene if not self.share else None", ("acts: ", "NoneType")),
    ],
    ids=["another stage", "the substrate leaks", "not conserved", "above 1", "nothing"],
)  # fmt: skip
def test_a_scene_effect_keeps_to_its_stage_and_to_the_laws(body: str, said: tuple[str, ...]) -> None:
    """It may not change what is not its stage's, nor create energy, nor lose what it says that it conserves."""
    reason = looked_through(SCENE.replace("{body}", body))
    for part in said:
        assert part in reason


def test_a_film_that_shines_is_refused() -> None:
    """k below 0 would make R + T larger than 1, and `model_copy` checks nothing."""
    source = '''
from containers.effect import StackEffect, parameter

class Mine(StackEffect):
    """A film shines."""

    name = "mine"
    formula = "k -> -g"
    reference = "a test"
    gain: float = parameter("g", unit="", lower=0.0, upper=0.5, off=0.0)

    def stack(self, stack):
        if not self.gain:
            return stack
        outside = stack.outside.model_copy(update={"k": -self.gain})
        return stack.model_copy(update={"outside": outside})
'''
    reason = looked_through(source)
    assert "acts: a DBR" in reason
    assert "k: got" in reason


def test_the_worker_lives_on_whatever_a_file_does(tmp_path: Path) -> None:
    """Files that create energy, end the process or are too large are refused by name; the good one is used."""
    (tmp_path / "my_lift.py").write_text(GOOD)
    (tmp_path / "bright.py").write_text(detector("return image * (1.0 + self.share)").replace("mine", "bright"))
    (tmp_path / "dies.py").write_text("import os; os._exit(0)\n")
    (tmp_path / "large.py").write_text("#" * (257 << 10))
    found = load_folder(tmp_path, Loaded(), frozenset())
    assert set(found.known) == {"my_lift"}
    assert "at most 1" in found.refused["bright.py"]
    assert "ended too early" in found.refused["dies.py"]
    assert "at most 262144 bytes" in found.refused["large.py"]


def test_an_endless_loop_at_import_ends_with_its_time(tmp_path: Path) -> None:
    """The trial is ended, with the processes that it began."""
    source = (
        "import subprocess, sys\nsubprocess.Popen([sys.executable, '-c', 'while True: pass'])\nwhile True: pass\n"
    )
    reason = refusal(tmp_path / "effects", source, limit_s=2.0)
    assert reason.startswith("mine.py: no end after 2 s while it was imported")


def test_names_of_the_catalogue_and_of_no_effect_are_refused(tmp_path: Path) -> None:
    """No trial is needed for that."""
    assert "catalogue" in refusal(tmp_path / "a", GOOD, "camera_psf.py")
    assert "small letters" in refusal(tmp_path / "b", GOOD, "My Lift.py")


def test_an_unchanged_file_is_not_tried_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nor by a second worker on this machine; a refused one is, once it is saved again."""
    monkeypatch.setenv("LUXLOOP_CACHE", str(tmp_path / "cache"))
    folder = tmp_path / "effects"
    folder.mkdir()
    (folder / "my_lift.py").write_text(GOOD)
    (folder / "mine.py").write_text("x = 1\n")
    first = load_folder(folder, Loaded(), frozenset())
    assert set(first.refused) == {"mine.py"}
    tries: list[str] = []
    real = effect_files._in_a_fresh_process
    counted = lambda source, file, *rest: tries.append(file) or real(source, file, *rest)  # noqa: E731
    monkeypatch.setattr(effect_files, "_in_a_fresh_process", counted)
    again = load_folder(folder, first, frozenset())
    assert tries == []
    assert again.known["my_lift"] is first.known["my_lift"]
    assert again.refused == first.refused
    assert "my_lift" in load_folder(folder, Loaded(), frozenset()).known
    assert tries == ["mine.py"]
    os.utime(folder / "mine.py", ns=(1, 1))
    load_folder(folder, first, frozenset())
    assert tries == ["mine.py", "mine.py"]


def test_a_catalogue_finds_a_file_that_changes_while_it_stands(tmp_path: Path) -> None:
    """By the new hash at once; another hash is answered with both of them; the effect twice is refused."""
    folder = tmp_path / "effects"
    catalogue = Catalogue(folder)
    assert told(catalogue)["refused_effects"] == {}
    folder.mkdir()
    (folder / "my_lift.py").write_text(GOOD)
    with pytest.raises(RemoteError) as caught:
        catalogue.effects([AppliedEffect(name="my_lift", parameters={"lift_um": 1.0}, source_sha256="0" * 64)], "ray")
    failure = caught.value.failure
    sha256 = told(catalogue)["effect_trials"]["my_lift.py"]["sha256"]
    assert failure.code == "unknown_effect"
    assert "0" * 64 in failure.message
    assert sha256 in failure.allowed
    (folder / "my_lift.py").write_text(GOOD + "# changed\n")
    changed = effect_files.hashlib.sha256((folder / "my_lift.py").read_bytes()).hexdigest()
    applied = AppliedEffect(name="my_lift", parameters={"lift_um": 1.0}, source_sha256=changed)
    (lift,) = catalogue.effects([applied], "ray").all
    assert lift.lift_um == 1.0  # type: ignore[attr-defined]
    with pytest.raises(InputError, match="each name once"):
        catalogue.effects([applied, applied], "ray")


def test_a_trial_ends_when_its_result_is_not_wanted_any_more(tmp_path: Path) -> None:
    """A worker whose task is cancelled while it looks through its folder stops, and knows what it knew."""
    (tmp_path / "mine.py").write_text("while True: pass\n")
    begin_s = time.monotonic()

    def report() -> None:
        if time.monotonic() > begin_s + 0.5:
            raise Stopped

    catalogue = Catalogue()
    catalogue._folder = tmp_path
    for rescan in (
        lambda: load_folder(tmp_path, Loaded(), frozenset(), report=report),
        lambda: catalogue.rescan(report),
        lambda: catalogue.effects([AppliedEffect(name="mine")], "ray", report),
    ):
        with pytest.raises(Stopped):
            rescan()
    assert time.monotonic() - begin_s < 5.0
    assert told(catalogue)["refused_effects"] == {}


def test_a_trial_is_not_told_of_the_worker_s_keys(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nor where its router is; it finds the compiled kernels."""
    monkeypatch.setenv("LUXLOOP_CERTS", "/certs")
    (tmp_path / "mine.py").write_text("import os\nraise SystemExit(sorted(os.environ))\n")
    refused = load_folder(tmp_path, Loaded(), frozenset()).refused["mine.py"]
    assert "PATH" in refused
    assert "LUXLOOP_CERTS" not in refused
    with monkeypatch.context() as patch:
        patch.setenv("LUXLOOP_KERNELS", "/kernels")
        told_of = effect_files._environment()
    assert {name for name in told_of if name.startswith("LUXLOOP_")} <= {"LUXLOOP_CACHE", "LUXLOOP_KERNELS"}
    assert told_of["LUXLOOP_KERNELS"] == "/kernels"


def offered(monkeypatch: pytest.MonkeyPatch, folder: Path, **sources: str) -> Catalogue:
    """A catalogue where a package offers the class `Lift` of modules of these sources."""
    points = [EntryPoint(name, f"{name}:Lift", "luxloop.effects") for name in sources]
    for name, source in sources.items():
        (folder / f"{name}.py").write_text(source)
        sys.modules.pop(name, None)
    monkeypatch.syspath_prepend(str(folder))
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    monkeypatch.setattr(catalogue_module, "entry_points", lambda **_: points)
    catalogue_module._installed.cache_clear()
    return Catalogue()


def test_an_effect_of_a_package_is_known_by_the_hash_of_its_module(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A worker with another release of it does not answer for this one."""
    hashes = []
    for source in (GOOD, GOOD + "# another release\n"):
        catalogue = offered(monkeypatch, tmp_path, packaged_lift=source)
        (spec,) = [one for one in catalogue.specs if one.name == "my_lift"]
        hashes.append(spec.source_sha256)
    applied = [AppliedEffect(name="my_lift", parameters={"lift_um": 1.0}, source_sha256=one) for one in hashes]
    assert len(catalogue.effects(applied[1:], "ray").all) == 1
    with pytest.raises(RemoteError) as caught:
        catalogue.effects(applied[:1], "ray")
    assert caught.value.failure.code == "unknown_effect"
    assert str(hashes[1]) in caught.value.failure.allowed
    assert "package" in caught.value.failure.mend
    catalogue_module._installed.cache_clear()


def test_a_package_whose_effect_cannot_be_used_ends_no_worker(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What raises at import, what is no effect, what has a name of the catalogue: told, and the rest is there."""
    sources = {
        "packaged_broken": "import not_there_at_all\n",
        "packaged_other": "Lift = 3\n",
        "packaged_taken": GOOD.replace("my_lift", "camera_psf"),
    }
    catalogue = offered(monkeypatch, tmp_path, packaged_lift=GOOD, **sources)
    refused = told(catalogue)["refused_effects"]
    assert set(refused) == set(sources)
    assert "not_there_at_all" in refused["packaged_broken"]
    assert "a class derived" in refused["packaged_other"]
    assert "no other effect" in refused["packaged_taken"]
    assert "my_lift" in {spec.name for spec in catalogue.specs}
    catalogue_module._installed.cache_clear()
