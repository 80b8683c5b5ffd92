"""Records of a run that are kept: they count as the run does, and show no answer that could still be judged."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.blind_records import keep, main
from luxloop.errors import InputError
from tests.validation.blind_test.pretend import answer, bound_folder_of, chained, folder_of, hiding, record
from validation.blind_test.folders import ANSWERS, ASKED, VERDICTS, write_whole
from validation.blind_test.scoring import score


def test_what_has_a_verdict_is_kept_and_counts_the_same(tmp_path: Path) -> None:
    """One of two sets is judged; once both are, the copy is brought up to date. Another run's is refused."""
    first, second = answer("set-1", hiding("vignetting")), answer("set-2", hiding("camera_psf"))
    run = bound_folder_of(tmp_path / "run", (first, record("one_effect", "vignetting")), (second, None))
    write_whole(run / ANSWERS / ASKED, {"seed": 5, "sets": 2})
    kept = tmp_path / "kept"
    assert keep(run, kept) == 1
    assert not (kept / ANSWERS / "set-2.json").exists()
    assert not (kept / ANSWERS / ASKED).exists()  # its seed and the code are the answer of the other one
    assert score([kept])["table"] == score([run])["table"]
    assert score([kept])["without_verdict"] == 1
    seal = (run / "sets" / "set-2" / "seal.json").read_text().split('"')[-2]
    write_whole(
        run / VERDICTS / "set-2.json",
        record("one_effect", "camera_psf", seal=seal, dataset_sha256=second.dataset_sha256),
    )
    chained(run, ("set-1", "set-2"))
    assert keep(run, kept) == 2
    assert (kept / ANSWERS / ASKED).read_bytes() == (run / ANSWERS / ASKED).read_bytes()
    assert score([kept])["sets"] == 2
    other = folder_of(tmp_path / "other", (first, record("nothing_visible")))
    with pytest.raises(InputError, match="records of this run"):
        keep(other, kept)


def test_the_command_says_what_cannot_be(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Exit code 2 and the sentence of the error, no traceback."""
    with pytest.raises(SystemExit) as end:
        main([str(tmp_path / "nowhere"), str(tmp_path / "kept")])
    assert end.value.code == 2
    assert "luxloop blind make FOLDER makes one" in capsys.readouterr().err


def test_a_run_without_verdicts_keeps_nothing(tmp_path: Path) -> None:
    """Its answers stay where they are."""
    run = folder_of(tmp_path / "run", (answer("set-1", hiding("vignetting")), None))
    with pytest.raises(InputError, match="blind diagnose"):
        keep(run, tmp_path / "kept")
    assert not (tmp_path / "kept").exists()
