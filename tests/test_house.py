"""The house: what ships, how large the rooms' files are, who may import what."""

from __future__ import annotations

import ast
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

from luxloop.cli import app

ROOT = Path(__file__).parents[1]
ROOMS = ("agent", "containers", "env_controller", "validation", "viewer")
PACKAGES = ("luxloop", *ROOMS)
HALL_LINES = 2400
BUS_LINES = 800
JOURNAL_LINES = 930
MODULE_LINES = 500
HALL_MODULE_LINES = 300


def modules(package: str) -> list[Path]:
    """The Python files of a package."""
    return sorted((ROOT / package).rglob("*.py"))


def code_lines(path: Path) -> int:
    """Lines of a file that are neither blank, nor comment, nor docstring."""
    text = path.read_text()
    documented: set[int] = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            documented.update(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    lines = enumerate(text.splitlines(), 1)
    return sum(bool(line.strip()) and not line.lstrip().startswith("#") and n not in documented for n, line in lines)


def test_the_hall_stays_small() -> None:
    """The shared language is under 2,400 lines of code, bus under 800, journal under 930, no file over 300."""
    bus, journal = modules("luxloop/bus"), modules("luxloop/journal")
    assert sum(map(code_lines, set(modules("luxloop")) - set(bus) - set(journal))) < HALL_LINES
    assert sum(map(code_lines, bus)) < BUS_LINES
    assert sum(map(code_lines, journal)) < JOURNAL_LINES
    assert [str(path) for path in modules("luxloop") if len(path.read_text().splitlines()) > HALL_MODULE_LINES] == []


@pytest.mark.parametrize("package", PACKAGES)
def test_no_module_is_longer_than_a_reader_holds(package: str) -> None:
    """No module is over 500 lines."""
    assert [str(path) for path in modules(package) if len(path.read_text().splitlines()) > MODULE_LINES] == []


def test_the_wheel_holds_the_six_packages_and_their_data(tmp_path: Path) -> None:
    """What is built ships the packages, py.typed, models and materials, and nothing else at the top level."""
    subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(tmp_path)],
        cwd=ROOT,
        check=True,
        capture_output=True,
    )
    (wheel,) = tmp_path.glob("*.whl")
    names = zipfile.ZipFile(wheel).namelist()
    top = {name.split("/")[0] for name in names}
    assert {name for name in top if not name.endswith(".dist-info")} == set(PACKAGES)
    assert {f"{package}/py.typed" for package in PACKAGES} <= set(names)
    assert {"luxloop/models/paper.toml", "luxloop/models/clear_chip.toml"} <= set(names)
    assert "containers/material_data/GaN.toml" in names


def test_every_command_and_view_can_be_loaded() -> None:
    """Each entry point names something that is there, with a docstring that its help shows."""
    from importlib.metadata import entry_points

    wanted = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["entry-points"]
    for group, points in wanted.items():
        loaded = {point.name: point.load() for point in entry_points(group=group)}
        assert set(loaded) == set(points)
        assert all(function.__doc__ for function in loaded.values())


def test_the_blind_truth_may_import_no_other_module_of_validation() -> None:
    """Its contract names every one of them: a new module is forbidden from its first day."""
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    (contract,) = [one for one in contracts if one.get("source_modules") == ["validation.blind"]]
    there = {path.stem for path in (ROOT / "validation").iterdir() if path.suffix == ".py" or list(path.glob("*.py"))}
    assert {f"validation.{name}" for name in there - {"__init__", "blind"}} <= set(contract["forbidden_modules"])
    assert set(PACKAGES) - {"validation"} <= set(contract["forbidden_modules"])


WRITTEN_OTHERWISE = {
    "containers/effect_files.py": "what an attempt found, renamed when it is whole",
    "validation/dataset/images.py": "an image of a data set; its manifest comes last",
    "validation/dataset/simulated_curves.py": "a table of a data set; its manifest comes last",
    "validation/dataset/simulate.py": "the truth beside a data set; its manifest comes last",
    "validation/blind_test/scenes.py": "in a folder that is renamed when it is whole",
    "validation/blind_test/further.py": "in a folder that is renamed when it is whole",
}


def test_what_a_user_gets_is_written_whole() -> None:
    """Pictures and texts go to what `luxloop.files.whole` gives, which is called fresh; with reasons why not."""
    writes = {"savefig", "imwrite", "write_text", "write_bytes", "savez_compressed"}
    found = set()
    for path in [path for package in PACKAGES for path in modules(package)]:
        for node in ast.walk(ast.parse(path.read_text())):
            if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in writes):
                continue
            names = {ast.unparse(one) for one in (node.func.value, *node.args[:1])}
            if names.isdisjoint({"fresh", "opened", "memory"}):
                found.add(path.relative_to(ROOT).as_posix())
    assert found == set(WRITTEN_OTHERWISE)


def test_docker_is_no_package() -> None:
    """An `__init__.py` there would hide an installed docker SDK."""
    assert not (ROOT / "docker" / "__init__.py").exists()


def test_help_imports_nothing_numeric() -> None:
    """`luxloop --help` loads every command's module, and neither numba, matplotlib nor zenoh."""
    code = (
        "import sys\nfrom luxloop.cli import app\nimport typer\ntyper.main.get_command(app())\n"
        "print([name for name in ('numba', 'matplotlib', 'zenoh', 'torch', 'scipy') if name in sys.modules])\n"
    )
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert shown.stdout.strip() == "[]"


def test_an_auditor_needs_no_numba() -> None:
    """Who replays a run need not trace: the designer's image, and a laptop, have no numba."""
    code = (
        "import sys\nfrom importlib.metadata import entry_points\n"
        "points = [point.load() for point in entry_points(group='luxloop.auditors')]\n"
        "print(len(points) > 3, 'numba' in sys.modules)\n"
    )
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert shown.stdout.strip() == "True False"


def test_a_command_line_loads_what_it_can_mean() -> None:
    """A command comes alone, a group whole where its second word is no command of it; no command: all of them."""

    def shown(*words: str) -> dict[str, list[str]]:
        root = app(words)
        alone = [one.name or "" for one in root.registered_commands]
        return {"": alone} | {
            str(group.name): [one.name or "" for one in group.typer_instance.registered_commands]
            for group in root.registered_groups
            if group.typer_instance is not None
        }

    assert shown("compare", "audit") == {"": ["compare"]}
    assert shown("audit", "verify", "runs/a") == {"": [], "audit": ["verify"]}
    assert shown("audit", "verfy") == {"": [], "audit": shown()["audit"]}
    assert shown("compar") == shown("--help") == shown()
