"""Films that several tests look at, and what an independent program (tmm) says of them."""

from __future__ import annotations

import functools
import warnings

import numpy as np
import tmm

from containers.stack import dbr_layers, dbr_of, resolve
from containers.thin_film.table import FilmTable, Side, film_table
from luxloop.film import Grid
from luxloop.model import Environment
from luxloop.stack import Layer, Medium, Stack

DEG = np.pi / 180.0
GAN, ALN = (2.4869, 45.2), (2.1793, 51.6)


@functools.cache
def film(pairs: float = 5.5, roughness_nm: float = 0.0) -> FilmTable:
    """The paper's DBR, gan_first; each face as rough as the next."""
    rows = [(GAN, ALN)[kind] for kind in dbr_layers(pairs)]
    layers = tuple(Layer(medium=Medium(n=n), thickness_nm=t, roughness_nm=roughness_nm) for n, t in rows)
    stack = Stack(
        inside=Medium(n=GAN[0]), layers=layers, outside=Medium(n=1.0), inside_roughness_nm=roughness_nm
    )  # fmt: skip
    return film_table(stack, grid=Grid(wavelengths=21))


@functools.cache
def dispersive() -> FilmTable:
    """5.5 pairs of GaN and AlN with the dispersion of their materials."""
    environment = Environment().model_copy(update={"indices": "dispersive"})
    return film_table(dbr_of(environment, 5.5), grid=Grid(wavelengths=21))


def tmm_powers(table: FilmTable, side: Side, wavelength_nm: float, theta_deg: float) -> list[list[float]]:
    """R and T of s and p by the independent program, light from one side."""
    rows = resolve(table.stack, [wavelength_nm])
    n, d = rows.index[0], [np.inf, *rows.thickness_nm, np.inf]
    n, d = (n, d) if side == "inside" else (n[::-1], d[::-1])
    found = []
    for p in "sp":
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            both = tmm.coh_tmm(p, n, d, theta_deg * DEG, wavelength_nm)
        found.append([both["R"], both["T"]])
    return found


def line_average(table: FilmTable, side: Side, theta_deg: float) -> list[float]:
    """R and T of unpolarised light of the whole line, by the independent program."""
    pairs = zip(table.weight, table.wavelength_nm, strict=True)
    return list(sum(w * np.mean(tmm_powers(table, side, float(nm), theta_deg), axis=0) for w, nm in pairs))
