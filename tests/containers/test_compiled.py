"""How kernels are compiled and kept, and that compiler pages can be handed back without harm."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import llvmlite
import pytest

from containers import compiled
from containers.thin_film.lossless import family_reflectance

DOUBLE = """
from containers.compiled import kernel
@kernel
def double(x: float) -> float:
    return {factor} * x
"""


def run(folder: Path, code: str, **environment: str) -> str:
    """What a fresh process prints that can import from `folder`."""
    paths = os.pathsep.join([str(folder), str(Path(compiled.__file__).parents[1])])
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "PYTHONPATH": paths, **environment},
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout.strip()


@pytest.mark.parametrize("chosen", ["LUXLOOP_CACHE", "NUMBA_CACHE_DIR"])
def test_compiled_code_is_kept_in_the_cache_and_follows_its_source(tmp_path: Path, chosen: str) -> None:
    """A second process loads what the first compiled; a changed source, also of another file, is compiled again."""
    source, cache = tmp_path / "code", tmp_path / "cache"
    source.mkdir()
    (source / "inner.py").write_text(DOUBLE.format(factor=2.0))
    (source / "outer.py").write_text(
        "from inner import double\nfrom containers.compiled import kernel\n"
        "@kernel\ndef twice(x: float) -> float:\n    return double(double(x))\n"
    )
    call = "import outer; print(outer.twice(1.0), sum(outer.twice.stats.cache_hits.values()))"
    settings = {"LUXLOOP_CACHE": "", "LUXLOOP_KERNELS": "", "NUMBA_CACHE_DIR": "", chosen: str(cache)}
    assert run(source, call, **settings) == "4.0 0"
    assert run(source, call, **settings) == "4.0 1"
    (source / "inner.py").write_text(DOUBLE.format(factor=3.0))
    assert run(source, call, **settings) == "9.0 0"
    assert list(cache.rglob("*.nbc"))
    assert not list(source.rglob("*.nbc"))


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="madvise is asked of Linux only")
def test_compiler_pages_can_be_released_and_kernels_go_on() -> None:
    """It is asked of most of the library; after it kernels give the same, new ones compile, also a second time."""
    (library,) = Path(llvmlite.__file__).parent.rglob("libllvmlite.so")
    pages = compiled._library_pages("llvmlite")
    assert library.stat().st_size / 2 < sum(end - start for start, end in pages) <= library.stat().st_size * 1.01
    arguments = (2.5, 1.0, [2.0], [50.0], [[0]], [445.0], [0.3, 0.9])
    before = family_reflectance(*arguments)
    for factor in (2.0, 4.0):
        compiled.release_compiler_pages()
        assert (family_reflectance(*arguments) == before).all()
        assert compiled.kernel(lambda x, factor=factor: factor * x)(1.5) == 1.5 * factor


def test_how_kernels_are_compiled_is_part_of_their_folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Options of the compiler stand in that one file."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    compiled._kernel_folder.cache_clear()
    before = compiled._kernel_folder(tmp_path)
    changed = tmp_path / "compiled.txt"
    changed.write_bytes(Path(compiled.__file__).read_bytes() + b"# changed\n")
    monkeypatch.setattr(compiled, "__file__", str(changed))
    compiled._kernel_folder.cache_clear()
    assert Path(before).parent == tmp_path
    assert compiled._kernel_folder(tmp_path) != before
    compiled._kernel_folder.cache_clear()
