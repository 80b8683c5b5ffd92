"""A real film by the commands that a user has: compare, diagnose, add, ladder, from a model without native oxide.

    python -m benchmarks.pnipam_diagnose [--data FOLDER]

psi and delta of a polymer on silicon at seven angles (refnx/refellips demos, BSD 3-Clause; pnipam_ladder.py says
where the file is looked for): the mean of four zones with its standard error. The film's thickness and index are what
pnipam_compare.py finds with 1.5 nm of oxide, as if another instrument had measured them: the size that is found for
the oxide proves nothing by itself. What is judged is the verdict, the errors at angles left out, and whether a rough
film is refused. The same is asked where the index, or nothing, is known.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.pnipam_compare import write
from benchmarks.pnipam_ladder import DATA_FILE, Measured, data_folder, read_measured

THICKNESS_NM, CAUCHY = 28.76, (1.4549, 0.0066)
FREE = {"a": [1.2, 1.8], "b_um2": [-0.05, 0.05]}
FILMS = {
    "known": {},
    "thickness-known": FREE,
    "free": {"thickness_nm": [5.0, 80.0], **FREE},
}
"""The polymer on bare silicon, and what of it is fitted."""
ROUGH = ("film_interface_roughness", "film_interlayer")
"""What the film does not have: the second is roughness as ellipsometry describes it."""


def layers_of(free: dict[str, list[float]]) -> str:
    """The film's layers in a manifest."""
    limits = ", ".join(f"{name} = {limit}" for name, limit in free.items())
    return f"[{{ cauchy = {list(CAUCHY)}, thickness_nm = {THICKNESS_NM}, free = {{ {limits} }} }}]"


def error_deg(zones_deg: np.ndarray[Any, np.dtype[np.float64]]) -> float:
    """Standard error of the mean over zones (zone, wavelength, aoi), rms over all values."""
    count = len(zones_deg)
    return float(np.sqrt(np.mean(zones_deg.var(axis=0, ddof=1)) / count))


def dataset(folder: Path, data: Measured) -> None:
    """The data as a user would have them."""
    sigma = {"psi": error_deg(data.psi_deg), "delta": error_deg(data.delta_deg)}
    write(folder, data, {name: layers_of(free) for name, free in FILMS.items()}, sigma)
    print(f"errors of the mean of the zones: psi {sigma['psi']:.3f}, delta {sigma['delta']:.3f} deg")


def luxloop(folder: Path, command: str, *, json_wanted: bool = True) -> Any:
    """What a command says, as values or as text."""
    words = [sys.executable, "-m", "luxloop", *command.split(), *(["--json"] if json_wanted else [])]
    said = subprocess.run(words, cwd=folder, capture_output=True, text=True, check=False)
    if said.returncode:
        raise SystemExit(f"luxloop {command}\n{said.stdout}{said.stderr}")
    return json.loads(said.stdout) if json_wanted else said.stdout


def tell(title: str, found: dict[str, Any]) -> None:
    """A diagnosis in some lines."""
    print(f"\n{title}: {found['verdict']}, structure p {found['structure']['p_text']}\n  {found['sentence']}")
    for one in found["held"]:
        print(f"  {one['words']}")
    for row in found["effects"]:
        ((name, size),) = row["size"].items()
        held = "no held-out test"
        if row["held_out_before"] is not None:
            held = f"left-out angles {row['held_out_before']:.3f} -> {row['held_out_after']:.3f} %"
        error = "" if size["error"] is None else f" +- {size['error']:.2g}"
        print(
            f"  {row['name']:26s} {name} {size['value']:.3g}{error} {size['unit']}: chi2 -{row['chi2_drop']:.0f},"
            f" explains {100.0 * row['explained_share']:.0f} %, {held}, p left {row['p_left']:.2g}"
        )


def main() -> None:
    """Run the commands and print what they say."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=data_folder(), help="folder of " + DATA_FILE)
    data = read_measured(parser.parse_args().data / DATA_FILE)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "data").mkdir()
        dataset(folder / "data", data)
        for film in FILMS:
            model = f"--model {film}.toml --film {film}"
            print(f"\n{film}: {luxloop(folder, f'compare data {model}')['sentence']}")
            tell("diagnose", luxloop(folder, f"diagnose {model}"))
        model = "--model known.toml --film known"
        print("\nknown, luxloop add film_missing_layer")
        print(luxloop(folder, f"add film_missing_layer {model}", json_wanted=False))
        tell("diagnose again", luxloop(folder, f"diagnose {model}"))
        for effect in ROUGH:
            print(f"\nluxloop add {effect} --dry-run")
            print(luxloop(folder, f"add {effect} {model} --dry-run", json_wanted=False))
        print("luxloop ladder")
        print(luxloop(folder, "ladder --model known.toml", json_wanted=False))


if __name__ == "__main__":
    main()
