"""The commands: what they refuse at once, sets that are made in two goes, and all of it at work."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from luxloop.errors import InputError
from luxloop.model_file import find_model
from luxloop.settings import Settings
from tests.running_set import local_set
from tests.validation.blind_test.pretend import answer, change, folder_of, hiding, record
from tests.validation.test_loop import luxloop
from validation import blind_command
from validation.blind_test.folders import ANSWERS, SETS, model_of, read_index, write_whole
from validation.blind_test.judging import chosen_model
from validation.blind_test.making import HISTORIES as MANY
from validation.blind_test.making import Asked, begin, make
from validation.blind_test.truths import Counts
from validation.dataset.folder import read_dataset, read_sums
from validation.dataset.images import read_tiff
from validation.dataset.simulation_plan import read_plan

PLAN = """
name = "one chip, two mirrors"
camera = { pixel_um = 16.0, bit_depth = 12, gain_dn_per_e = 0.38, read_noise_e = 6.0, full_well_e = 1e4, black_level_dn = 64.0 }
[[samples]]
id = "bare"
layout = "single"
distance_um = 100.0
width_um = 40.0
spacing_um = 400.0
thickness_um = 20.0
dbr_pairs = 0.0
module_half_um = 400.0
[[samples]]
id = "mirror"
layout = "single"
distance_um = 100.0
width_um = 40.0
spacing_um = 400.0
thickness_um = 20.0
dbr_pairs = 2.5
module_half_um = 400.0
"""  # noqa: E501  # TOML's inline tables have no line breaks
PIXELS, HISTORIES = 32, 20_000


@pytest.fixture
def plan(tmp_path: Path) -> Path:
    """A plan of two small images."""
    path = tmp_path / "plan.toml"
    path.write_text(PLAN)
    return path


@pytest.mark.parametrize(
    ("argv", "words"),
    [
        (("make", "out", "--sigma", "2"), "2 sigma are less than this camera can show"),
        (("make", "out", "--kinds", "dusk"), "did you mean dust?"),
        (("make", "out", "--sigma", "inf"), "a number, at least 5"),
        (("make", "out", "--sigma", "nan", "--nothing", "8"), "a number, at least 5"),
        (("make", "out", "--kinds", "dust", "--sets", "1"), "dust lie outside of the catalogue: --outside 1"),
        (("make", "out", "--kinds", "binning", "--sets", "1", "--outside", "1"), "leave --outside out"),
        (("make", "out", "--kinds", "clipped_pupil,binning", "--sets", "2", "--two", "1"), "kinds of two groups"),
        (("make", "out", "--sets", "3", "--nothing", "4"), "--outside + --two + --nothing"),
        (("make", "full"), "an empty folder"),
        (("make", "full/notes.txt"), "an empty folder"),
        (("make", "out", "--plan", "no-plan.toml"), "--plan"),
        (("diagnose", "nowhere"), "luxloop blind make FOLDER makes one"),
        (("diagnose", "sealed", "--model", "clear_chip"), "the model of the sets, paper"),
        (("measure", "sealed", "out"), "only verdicts that cannot tell effects apart"),
        (("score", "nowhere"), "luxloop blind make FOLDER makes one"),
        (("score", "full"), "luxloop blind make FOLDER makes one"),
        (("score", "full/*/"), "`python -m benchmarks.blind_records` adds some"),
        (("score", "sealed"), "luxloop blind diagnose sealed comes first"),
        (("score", "sealed", "--page", "page.txt"), ".html"),
    ],
)
def test_what_cannot_be_is_said_at_once(
    settings: Settings, tmp_path: Path, argv: tuple[str, ...], words: str
) -> None:
    """Exit code 2, the field and what mends it; no process is started and no folder is left."""
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "notes.txt").write_text("mine")
    folder_of(tmp_path / "sealed", (answer("set-1", hiding("vignetting")), None))
    done = luxloop(settings, tmp_path, "blind", *argv)
    assert done.returncode == 2, done.stderr
    assert words in done.stderr
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "out").exists()


def test_without_numba_truths_are_refused_before_anything_is_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As in the designer's image: the mend, where it had been a traceback from workers' answers on."""
    monkeypatch.setattr(blind_command, "find_spec", lambda _: None)
    for command in (blind_command.make, lambda out: blind_command.measure(tmp_path, out)):
        with pytest.raises(InputError, match=r"an installation with numba; pip install 'luxloop\[workers\]'"):
            command(tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_the_command_asks_for_as_many_histories_as_make_does() -> None:
    """Whose number stands twice, for the command's help must not import it."""
    assert blind_command.OF_LIGHT == MANY


def test_scores_of_two_folders_add_up(settings: Settings, tmp_path: Path) -> None:
    """The table, the misses and a page, without any process; a changed answer ends it with the set's name."""
    right = answer("set-1", hiding("vignetting"))
    folder_of(tmp_path / "a", (right, record("one_effect", "vignetting")))
    folder_of(tmp_path / "b", (answer("set-1", hiding(kind="coma")), record("one_effect", "camera_psf")))
    done = luxloop(settings, tmp_path, "blind", "score", "a", "b", "--page", "score.html")
    assert done.returncode == 0, done.stderr
    assert "2 sets" in done.stdout
    assert "outside: coma" in done.stdout
    assert "outside: coma" in (tmp_path / "score.html").read_text(encoding="utf-8")
    change(tmp_path / "b" / ANSWERS / "set-1.json", salt="00" * 32)
    done = luxloop(settings, tmp_path, "blind", "score", "a", "b", "--json")
    assert done.returncode == 2
    assert json.loads(done.stdout)["error"]["field"] == "set-1: answer"


def test_making_goes_on_where_it_was_killed(plan: Path, tmp_path: Path) -> None:
    """What is there stays; the rest comes out as if nothing had happened; no half of a set is left."""

    def asked(name: str, **changes: Any) -> Asked:
        values: dict[str, Any] = {
            "counts": Counts(3, nothing=3, draws=2), "seed": 4, "sigma": 20.0, "plan": read_plan(plan),
            "model": find_model("paper"), "pixels": PIXELS, "histories": HISTORIES,
        }  # fmt: skip
        return Asked(tmp_path / name, **(values | changes))

    def killed(done: int, *_: Any) -> None:
        if done == 1:
            raise KeyboardInterrupt

    nobody: Any = None  # with nothing hidden no worker is asked
    with pytest.raises(KeyboardInterrupt):
        make(begin(asked("cut")), nobody, nobody, killed)
    (first,) = (tmp_path / "cut" / SETS).iterdir()
    kept = (first / "seal.json").read_bytes()
    (tmp_path / "cut" / SETS / ".set-9").mkdir()
    make(begin(asked("cut")), nobody, nobody)
    make(begin(asked("whole")), nobody, nobody)
    assert (first / "seal.json").read_bytes() == kept
    sets = {name: {one.name: read_dataset(one) for one in (tmp_path / name / SETS).glob("set-*")}
            for name in ("cut", "whole")}  # fmt: skip
    assert {name: one.sha256 for name, one in sets["cut"].items()} == {
        name: one.sha256 for name, one in sets["whole"].items()
    }
    assert len({one.sha256 for one in sets["whole"].values()}) == 3
    assert set(read_sums(first)) == {"dataset.toml", "images/bare.tif", "images/mirror.tif", "seal.json"}
    image = read_tiff(first / "images" / "bare.tif", "bare").values
    assert (image.dtype, image.shape) == (np.uint16, (PIXELS, PIXELS))
    assert 0.75 < (int(image.max()) - 64) / 3800.0 < 0.95  # exposed to 0.85 of the full well
    with pytest.raises(ValueError, match="the same command"):
        begin(asked("cut", seed=5))


@pytest.mark.parametrize("name", ["paper", "clear_chip", "mine"])
def test_sets_know_their_model(plan: Path, tmp_path: Path, name: str) -> None:
    """One that luxloop ships by its name, another one by a copy; it is the one that diagnose begins with."""
    model = find_model("paper" if name == "mine" else name)
    if name == "mine":
        model = model.with_value("environment.receiver.reflectance", 0.21)
    folder = tmp_path / "out"
    begin(Asked(folder, Counts(1, nothing=1), 4, 20.0, read_plan(plan), model, (), PIXELS, HISTORIES))
    index = read_index(folder)
    assert index.model == ("model.toml" if name == "mine" else name)
    assert chosen_model(folder, index, None) == model_of(folder, index) == model
    with pytest.raises(InputError, match="leave --model out"):
        chosen_model(folder, index, "paper" if name != "paper" else "clear_chip")
    with pytest.raises(InputError, match="put the file back"):
        model_of(folder, index.model_copy(update={"model_sha256": "0" * 64}))


def test_a_file_is_written_whole_or_not_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A kill before the last step leaves what was there before."""
    write_whole(tmp_path / "a.json", {"verdict": 1})

    def killed(*_: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(Path, "replace", killed)
    with pytest.raises(KeyboardInterrupt):
        write_whole(tmp_path / "a.json", {"verdict": 2})
    assert json.loads((tmp_path / "a.json").read_text()) == {"verdict": 1}


@pytest.mark.parametrize("silent", [False, True])
def test_what_was_done_is_a_line_where_stderr_is_no_terminal(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, silent: bool
) -> None:
    """With its seconds, once it is done; nothing with --quiet or --json."""
    clock = iter((0.0, 200.0, 451.6))
    monkeypatch.setattr(blind_command, "monotonic", lambda: next(clock))
    with blind_command.bar(silent) as heard:
        heard(0, 1, "the light of truth 1")
        heard(0, 1, "set-1")
        heard(1, 1, "done")
    lines = ["luxloop: the light of truth 1: 200 s; 0 of 1 done", "luxloop: set-1: 252 s; 1 of 1 done"]
    assert capsys.readouterr().err.splitlines() == ([] if silent else lines)


@pytest.mark.slow
def test_a_blind_test_over_real_processes(settings: Settings, plan: Path, tmp_path: Path) -> None:
    """Two sets are made, diagnosed by the twin, scored; a verdict that was lost is not made again."""
    small = ("--plan", str(plan), "--pixels", str(PIXELS), "--histories", str(HISTORIES))
    made = luxloop(
        settings, tmp_path, "blind", "make", "out", "--sets", "2", "--outside", "1", "--seed", "3", "--sigma", "12",
        "--kinds", "stray_daylight,smear", "--no-rivals", *small, "--json",
    )  # fmt: skip
    assert made.returncode == 0, made.stderr
    document = json.loads(made.stdout)
    root = json.loads((tmp_path / "out" / "blind.json").read_text())["root"]
    assert document == {"folder": "out", "sets": 2, "root": root, "too_weak": {}, "no_amount": []}
    for path in (tmp_path / "out" / ANSWERS).glob("set-*.json"):
        (hidden,) = json.loads(path.read_text())["answer"]["hidden"]
        assert hidden["sigma"] == pytest.approx(12.0, rel=0.1)
    few = ("--twin", "--among", "ambient_gradient")
    with local_set(settings):
        judged = luxloop(settings, tmp_path, "blind", "diagnose", "out", *few, "--json")
        assert judged.returncode == 0, judged.stderr
        assert json.loads(judged.stdout)["judged"] == 2
        path = tmp_path / "out" / "verdicts" / "set-2.json"
        kept = path.read_bytes()
        path.unlink()
        lost = luxloop(settings, tmp_path, "blind", "diagnose", "out", *few)
        assert (lost.returncode, "a verdict was taken away" in lost.stderr) == (2, True)
        path.write_bytes(kept)
        again = luxloop(settings, tmp_path, "blind", "diagnose", "out", *few)
        assert "0 verdicts put on record, 2 were there" in again.stdout
        assert path.read_bytes() == kept
    scored = luxloop(settings, tmp_path, "blind", "score", "out", "--json", "--page", "score.html")
    assert scored.returncode == 0, scored.stderr
    document = json.loads(scored.stdout)
    assert document["sets"] == 2
    assert sorted(one["truth"] for one in document["marks"]) == ["ambient_gradient", "outside: smear"]
    assert len(document["table"]) == 20
    page = (tmp_path / "score.html").read_text(encoding="utf-8")
    assert document["sentence"] in page
    assert all(one["id"] in page for one in document["marks"])
