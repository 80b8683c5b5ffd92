"""From images that do not match to an effect in the model, as a person walks it: real processes, real files."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from luxloop.effect import AppliedEffect
from luxloop.errors import InputError
from luxloop.journal.reader import RunJournal
from luxloop.model_file import find_model, read_model, to_toml
from luxloop.settings import Settings
from tests.running_set import local_set
from tests.validation.test_loop import luxloop
from validation import diagnose_command
from validation.diagnose_command import keep, last_file, rivals_of

PLAN = """
name = "two samples"
[camera]
pixel_um = 24.0
bit_depth = 12
gain_dn_per_e = 0.38
read_noise_e = 6.0
full_well_e = 10000.0
black_level_dn = 64.0
[[samples]]
id = "single"
layout = "single"
distance_um = 180.0
width_um = 40.0
spacing_um = 400.0
thickness_um = 20.0
dbr_pairs = 0.0
[[samples]]
id = "four"
layout = "array"
rows = 2
columns = 2
distance_um = 180.0
width_um = 40.0
spacing_um = 300.0
thickness_um = 20.0
dbr_pairs = 2.5
"""


def told(settings: Settings, folder: Path, *argv: str) -> dict[str, Any]:
    """The document of a command that succeeds."""
    done = luxloop(settings, folder, *argv, "--json")
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def replayed(settings: Settings, folder: Path, run: str, *levels: str) -> None:
    """Chi2 from the maps, verdict and ladder from their numbers, the whole on answers asked once more."""
    for level in levels:
        again = luxloop(settings, folder, "audit", "replay", run, "--level", level)
        assert again.returncode == 0, again.stdout + again.stderr
        assert ("within tolerance" if level == "2" else "identical") in again.stdout.split("verdict")[-1]


@pytest.mark.slow
def test_powers_of_chips_are_added_sample_by_sample(settings: Settings, tmp_path: Path) -> None:
    """Four chips of two powers: add fits each with their spread, the error falls to the noise, designs have none."""
    hidden = AppliedEffect(name="chip_power_spread", parameters={"gain": (0.1, -0.1, 0.05, -0.05)})
    truth = find_model("paper").model_copy(update={"effects": (hidden,)})
    (tmp_path / "truth.toml").write_text(to_toml(truth), encoding="utf-8")
    (tmp_path / "plan.toml").write_text(PLAN, encoding="utf-8")
    made = ("dataset", "simulate", "data", "--model", "truth.toml", "--plan", "plan.toml", "--pixels", "42")
    with local_set(settings):
        told(settings, tmp_path, *made, "--solver", "twin")
        told(settings, tmp_path, "compare", "data", "--twin")
        free = ("--free", "environment.substrate.reflectance")
        added = told(settings, tmp_path, "add", "chip_power_spread", "--twin", *free)
    assert added["after"]["fitted_percent"] < 1.05 * added["after"]["noise_percent"]
    assert added["after"]["blocks_percent"] < added["before"]["blocks_percent"]
    model = read_model(tmp_path / "model.toml")
    assert [effect.parameters for effect in model.effects] == [{"gain": ()}]
    found = model.samples["four"]["chip_power_spread"]["gain"]
    errors = {row["path"]: row["error"] for row in added["fitted"]}
    for chip, gain in enumerate((0.1, -0.1, 0.05, -0.05)):
        assert abs(found[chip] - gain) < 3.0 * errors[f"samples.four.chip_power_spread.gain.{chip}"]  # type: ignore[index,operator]  # a list of numbers


@pytest.mark.slow
def test_a_hidden_effect_is_named_added_and_taken_out_again(settings: Settings, tmp_path: Path) -> None:
    """Vignetting in two images: the verdict names it, add brings the error to the noise, the ladder shows it."""
    hidden = AppliedEffect(name="vignetting", parameters={"corner_loss": 0.15, "law": "quadratic"})
    truth = find_model("paper").model_copy(update={"effects": (hidden,)})
    (tmp_path / "truth.toml").write_text(to_toml(truth), encoding="utf-8")
    (tmp_path / "plan.toml").write_text(PLAN, encoding="utf-8")
    with local_set(settings):  # for the steps; replays start processes of their own, which remember nothing
        made = ("dataset", "simulate", "data", "--model", "truth.toml", "--plan", "plan.toml", "--pixels", "42")
        told(settings, tmp_path, *made, "--solver", "twin")
        told(settings, tmp_path, "compare", "data", "--twin")
        free = ("--free", "environment.substrate.reflectance")
        seen = "vignetting,magnification,camera_psf,veiling_glare,edge_walls,dbr_index_error,receiver_btdf,dead_chip"
        among = f"{seen},film_interlayer"
        found = told(settings, tmp_path, "diagnose", "--twin", *free, "--among", among)
        assert found["not_tested"] == ["film_interlayer: there are no spectra of films"]
        assert (found["verdict"], found["set"][0]) in (
            ("one_effect", "vignetting"),
            ("cannot_tell_apart", "vignetting"),
        )
        best = next(one for one in found["effects"] if one["name"] == "vignetting")
        size = best["size"]["corner_loss"]
        assert abs(size["value"] - 0.15) < 3.0 * size["error"]
        assert best["held_out_after"] < best["held_out_before"]
        journal = RunJournal(Path(found["folder"]))
        (step,) = (one.value for one in journal.records("/validation") if one.value.command == "diagnose")
        assert step.document["sentence"] == found["sentence"]

        named = told(settings, tmp_path, "next", "vignetting", "magnification", "--twin", *free)
        assert named["rivals"] == ["vignetting", "magnification"]  # whatever the verdict was
        assert named["candidates"][0]["expected_sigma"] > named["candidates"][0]["now_sigma"]

        added = told(settings, tmp_path, "add", "vignetting", "--twin", *free)
        assert added["after"]["fitted_percent"] < 1.1 * added["after"]["noise_percent"]
        assert added["after"]["fitted_percent"] < added["before"]["fitted_percent"]
        assert any(line.startswith("effects.vignetting.corner_loss") for line in added["diff"])
        model = read_model(tmp_path / "model.toml")
        assert [effect.name for effect in model.effects] == ["vignetting"]
        again = luxloop(settings, tmp_path, "add", "vignetting", "--twin")
        assert again.returncode == 2
        assert "luxloop remove" in again.stderr

        rungs = told(settings, tmp_path, "ladder")["rungs"]
        assert [rung["effects"] for rung in rungs] == [[], ["vignetting"]]
        assert rungs[1]["held_out_percent"] < rungs[0]["held_out_percent"]
        taken = told(settings, tmp_path, "remove", "vignetting", "--twin", *free)
        assert taken["after"]["p"] < 0.001
        assert read_model(tmp_path / "model.toml").effects == ()
        told(settings, tmp_path, "model", "undo")
        assert [effect.name for effect in read_model(tmp_path / "model.toml").effects] == ["vignetting"]
    replayed(settings, tmp_path, found["folder"], "2", "3")
    replayed(settings, tmp_path, added["folder"], "2", "3", "4")


@pytest.mark.parametrize("text", ["{", "[]", "{}", "[" * 100_000, f'{{"set": {"7" * 5000}}}', "\xb5"])
def test_a_spoilt_record_of_the_last_diagnosis_is_told(tmp_path: Path, text: str) -> None:
    """With what writes it anew."""
    file = last_file(str(tmp_path / "model.toml"))
    assert file is not None
    file.parent.mkdir()
    file.write_bytes(text.encode("latin-1"))
    with pytest.raises(InputError, match=r"run luxloop diagnose again|save it as UTF-8"):
        rivals_of(str(tmp_path / "model.toml"))


def test_a_verdict_that_cannot_be_kept_is_told_all_the_same(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A model in somebody else's folder: `next` will ask for names."""
    (tmp_path / ".luxloop").write_text("in the way")
    (tmp_path / "model.toml").write_text("")
    names = ("verdict", "sentence", "set", "rivals", "model_sha256", "dataset_sha256")
    keep(SimpleNamespace(file=str(tmp_path / "model.toml")), dict.fromkeys(names, ""))  # type: ignore[arg-type]  # duck: its file
    assert "the verdict is not kept for `luxloop next`" in capsys.readouterr().err


def test_what_a_diagnosis_told_apart_is_no_rival(tmp_path: Path) -> None:
    """`next` without names takes what could not be told apart; one effect may have others that explain as much."""
    file = tmp_path / "model.toml"
    file.write_text(to_toml(find_model("paper")), encoding="utf-8")
    kept = {
        "sentence": "", "set": ["vignetting", "distortion", "camera_psf"], "rivals": ["camera_psf"],
        "dataset_sha256": "0" * 64,
    }  # fmt: skip
    subject: Any = SimpleNamespace(file=str(file))
    for verdict in ("cannot_tell_apart", "one_effect"):
        keep(subject, kept | {"verdict": verdict, "model_sha256": find_model(str(file)).sha256})
        if verdict == "cannot_tell_apart":
            assert rivals_of(str(file)) == ["vignetting", "camera_psf"]
            continue
        with pytest.raises(InputError, match="it said one_effect"):
            rivals_of(str(file))


@pytest.mark.parametrize(
    ("images", "field"), [((), "[data]"), ((1,), "EFFECT")], ids=["films alone", "films beside images"]
)
def test_no_image_is_looked_for_that_would_tell_films_apart(
    monkeypatch: pytest.MonkeyPatch, images: tuple[int, ...], field: str
) -> None:
    """Before anything is fitted, with what would tell them apart."""

    @contextmanager
    def pretended(*_: Any, **__: Any) -> Iterator[Any]:
        yield SimpleNamespace(observed=SimpleNamespace(images=images), spec=acting_on), None, None

    def acting_on(name: str) -> Any:
        return SimpleNamespace(name=name, acts_on=("films",) if name.startswith("film") else ("modules",))

    monkeypatch.setattr(diagnose_command, "diagnosing", pretended)
    with pytest.raises(InputError, match="measure the films' thickness or index") as refused:
        diagnose_command.next_(["vignetting", "film_interlayer", "film_missing_layer"])
    assert refused.value.field == field
    assert refused.value.value == {"[data]": "no images", "EFFECT": "film_interlayer, film_missing_layer"}[field]


@pytest.mark.parametrize(
    ("argv", "words"),
    [
        (("diagnose",), "model.toml"),
        (("diagnose", "--model", "paper"), "luxloop compare DATASET comes first"),
        (("next",), "luxloop diagnose comes first"),
        (("next", "vignetting", "vignetting"), "got 'vignetting', allowed: two effects or more, to be told apart"),
        (("remove", "vignetting", "--model", "paper"), "it has none"),
        (("ladder", "--model", "paper"), "a version that was fitted"),
        (("ladder", "--model", "nowhere.toml"), "got 'nowhere.toml', allowed: a model file"),
        (("ladder", "--model", "paper", "--page", "ladder.txt"), ".html"),
    ],
)
def test_what_is_missing_is_said(settings: Settings, tmp_path: Path, argv: tuple[str, ...], words: str) -> None:
    """Before anything is started, with the mend and exit code 2."""
    done = luxloop(settings, tmp_path, *argv)
    assert done.returncode == 2, done.stderr
    assert words in done.stderr
    assert "Traceback" not in done.stderr
