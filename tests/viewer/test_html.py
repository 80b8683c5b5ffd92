"""A page on the disk: the new one or the one before, never half of one."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

import viewer
from viewer.html import write


def test_a_page_is_replaced_as_a_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the disk gets full amid it the page before stays, and nothing else."""
    path = tmp_path / "page.html"
    write(path, "µ before\n")

    def full(file: Path, text: str, **_: object) -> None:
        file.write_bytes(text.encode()[:3])
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(Path, "write_text", full)
        with pytest.raises(OSError, match="No space left"):
            write(path, "after\n")
    assert path.read_bytes() == "µ before\n".encode()
    write(path, "after\n")
    assert path.read_bytes() == b"after\n"
    assert list(tmp_path.iterdir()) == [path]


def test_a_link_stays_one_and_others_may_read_the_page(tmp_path: Path) -> None:
    """As if it had been written in its place."""
    (tmp_path / "link.html").symlink_to("page.html")
    umask = os.umask(0o022)
    try:
        write(tmp_path / "link.html", "page")
    finally:
        os.umask(umask)
    assert (tmp_path / "link.html").is_symlink()
    assert (tmp_path / "page.html").read_text() == "page"
    assert (tmp_path / "page.html").stat().st_mode & 0o777 == 0o644


def test_every_page_is_written_so() -> None:
    """No view writes text by itself."""
    modules = Path(str(viewer.__file__)).parent.glob("*.py")
    assert [module.name for module in modules if ".write_text(" in module.read_text()] == ["html.py"]
