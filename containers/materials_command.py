"""`luxloop materials list|show`: the optical constants that ship with luxloop, with source and valid range."""

from __future__ import annotations

import json
from typing import Annotated, Any

import typer

from containers.typed import numbers

JsonOption = Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")]


def list_(as_json: JsonOption = False) -> None:
    """List the materials with their valid range and source."""
    from containers.materials import list_materials, material

    rows = [_facts(material(name)) for name in list_materials()]
    if as_json:
        typer.echo(json.dumps({"materials": rows}))
        return
    typer.echo(f"{'name':<7}{'range':>16}  source")
    for row in rows:
        low, high = row["range_nm"]
        typer.echo(f"{row['name']:<7}{f'{low:g}-{high:g} nm':>16}  {row['reference']}")


def show(
    name: Annotated[str, typer.Argument(help="The material's name, e.g. GaN.")],
    wavelengths: Annotated[str, typer.Option(help="Wavelengths in nm: a list, or first:last:step.")] = "",
    as_json: JsonOption = False,
) -> None:
    """Show a material: source, licence, range, and n + ik at some wavelengths."""
    from containers.materials import material

    chosen = material(name)
    low, high = chosen.range_nm
    at = (
        numbers("--wavelengths", wavelengths) if wavelengths else [x for x in range(350, 951, 50) if low <= x <= high]
    )
    index = chosen.index(at)
    facts = _facts(chosen) | {"wavelength_nm": list(at), "n": index.real.tolist(), "k": index.imag.tolist()}
    if as_json:
        typer.echo(json.dumps(facts))
        return
    for key in ("name", "description", "reference", "doi", "licence", "note"):
        if facts[key]:
            typer.echo(f"{key:<12}{facts[key]}")
    typer.echo(f"{'range':<12}{low:g} to {high:g} nm\n")
    typer.echo(f"{'wavelength_nm':>13}{'n':>11}{'k':>13}")
    for x, n, k in zip(at, index.real, index.imag, strict=True):
        typer.echo(f"{x:>13g}{n:>11.5f}{k:>13.4g}")


def _facts(chosen: Any) -> dict[str, Any]:
    names = ("name", "description", "reference", "doi", "licence", "note", "range_nm", "formula")
    return {name: getattr(chosen, name) for name in names}
