"""Optical constants n + ik of named materials, from data files with source and valid range.

One TOML file per material in `material_data/`, converted from the refractiveindex.info database (CC0 1.0). A formula
is one of

    sellmeier   n^2 = 1 + c0 + sum c_j l^2 / (l^2 - c_(j+1)^2)          (l: wavelength in um)
    gas         n = 1 + c0 + sum c_j / (c_(j+1) - l^-2)

and a table is interpolated linearly, as its source's own reader does. Nothing is extrapolated.
"""

from __future__ import annotations

import difflib
import hashlib
import tomllib
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from luxloop.errors import InputError
from luxloop.model import Environment

DATA = Path(__file__).with_name("material_data")
DISPERSIVE = ("GaN", "AlN")
"""What chip and mirror are made of where `indices` is dispersive."""


@dataclass(frozen=True)
class Material:
    """A material: where its optical constants come from, where they hold, what they are."""

    name: str
    description: str
    reference: str
    doi: str
    licence: str
    note: str
    range_nm: tuple[float, float]
    formula: str
    """`sellmeier`, `gas` or `table`."""
    coefficients: tuple[float, ...]
    table: NDArray[np.float64]
    """(rows, 3): wavelength in nm, n, k; empty where there is a formula."""
    sha256: str
    """Of its file."""

    def index(self, wavelength_nm: ArrayLike) -> NDArray[np.complex128]:
        """Complex index n + ik at each vacuum wavelength, in the shape of `wavelength_nm`.

        Raises
        ------
        InputError where a wavelength lies outside `range_nm`.
        """
        wavelength = np.asarray(wavelength_nm, dtype=float)
        self._refuse_outside(wavelength)
        if self.formula == "table":
            nm, n, k = self.table.T
            return np.asarray(np.interp(wavelength, nm, n) + 1j * np.interp(wavelength, nm, k))
        evaluate = {"sellmeier": _sellmeier, "gas": _gas}[self.formula]
        return evaluate(wavelength / 1000.0, self.coefficients).astype(complex)

    def _refuse_outside(self, wavelength: NDArray[np.float64]) -> None:
        low, high = self.range_nm
        outside = ~((wavelength >= low) & (wavelength <= high))
        if outside.any():
            raise InputError(
                "wavelength_nm",
                float(wavelength[outside].flat[0]),
                f"{low:g} to {high:g} nm, where the data of {self.name} are valid",
                "choose other wavelengths, another material, or a fixed index n",
            )


def material(name: str) -> Material:
    """The material called `name`; InputError with near spellings and all names where there is none."""
    if name not in list_materials():
        near = _near(name)
        mend = f"did you mean {' or '.join(near)}?" if near else "or give the medium a fixed index n and k"
        raise InputError("material", name, f"one of {', '.join(list_materials())}", mend)
    return _load(name)


@cache
def list_materials() -> tuple[str, ...]:
    """Names of all materials, in alphabetical order."""
    return tuple(sorted((path.stem for path in DATA.glob("*.toml")), key=str.lower))


def tables_of(environment: Environment) -> dict[str, str]:
    """The data files that an environment's indices come from, by name: for the record of a run.

    None where the indices are fixed: then the model file says them.
    """
    if environment.indices == "fixed":
        return {}
    return {f"material-{name}.toml": (DATA / f"{name}.toml").read_text(encoding="utf-8") for name in DISPERSIVE}


def _near(name: str) -> list[str]:
    lower = {known.lower(): known for known in list_materials()}
    return [lower[match] for match in difflib.get_close_matches(name.lower(), lower, n=2, cutoff=0.6)]


@cache
def _load(name: str) -> Material:
    raw = (DATA / f"{name}.toml").read_bytes()
    data = tomllib.loads(raw.decode())
    low, high = data["range_nm"]
    table = np.array(data.get("table", []), dtype=float).reshape(-1, 3)
    table.flags.writeable = False
    return Material(
        name=data["name"],
        description=data["description"],
        reference=data["reference"],
        doi=data.get("doi", ""),
        licence=data["licence"],
        note=data["note"],
        range_nm=(low, high),
        formula=data.get("formula", "table"),
        coefficients=tuple(data.get("coefficients", ())),
        table=table,
        sha256=hashlib.sha256(raw).hexdigest(),
    )


def _sellmeier(wavelength_um: NDArray[np.float64], c: tuple[float, ...]) -> NDArray[np.float64]:
    l2 = wavelength_um**2
    terms = [strength * l2 / (l2 - pole**2) for strength, pole in zip(c[1::2], c[2::2], strict=True)]
    return np.asarray(np.sqrt(1.0 + c[0] + sum(terms)))


def _gas(wavelength_um: NDArray[np.float64], c: tuple[float, ...]) -> NDArray[np.float64]:
    terms = [strength / (pole - wavelength_um**-2.0) for strength, pole in zip(c[1::2], c[2::2], strict=True)]
    return np.asarray(1.0 + c[0] + sum(terms))
