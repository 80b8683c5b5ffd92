"""`luxloop film`: what a stack or the DBR of a model does to light, against angle or wavelength; computed by PC2."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from importlib.metadata import entry_points
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from containers.typed import check_file, numbers, parse_stack
from luxloop.errors import InputError, RemoteError
from luxloop.model_file import find_model
from luxloop.settings import load_settings

if TYPE_CHECKING:
    from containers.thin_film.table import FilmTable
    from luxloop.client import Answer, Client
    from luxloop.model import Model

Against = Literal["angle", "wavelength"]
Quantity = Literal["R", "T", "psi", "delta"]
Side = Literal["inside", "outside"]
Polarisation = Literal["s", "p", "u"]
CURVE_POINTS = 361
EXPORTS = (".coated", ".bsdf", ".xml")


def film(
    pairs: Annotated[
        str | None, typer.Option(help="Pairs of the model's DBR: 5.5, or 4.5,5.5, or 4.5:9.5:0.5 for a range.")
    ] = None,
    stack: Annotated[
        str | None,
        typer.Option(help="Any stack from the bulk outwards, e.g. 'Si | SiO2 1.5 | 1.45 28.9 | air' (nm)."),
    ] = None,
    quantity: Annotated[Quantity, typer.Option(help="R, T, or ellipsometric psi, delta.")] = "R",
    against: Annotated[Against, typer.Option(help="What runs down the table.")] = "angle",
    angles: Annotated[str, typer.Option(help="Angles of incidence in deg: a list, or first:last:step.")] = "",
    wavelengths: Annotated[str, typer.Option(help="Wavelengths in nm: a list, or first:last:step.")] = "",
    side: Annotated[
        Side | None, typer.Option(help="Where the light comes from; default: the chip for a DBR.")
    ] = None,
    polarisation: Annotated[Polarisation, typer.Option(help="s, p, or u (unpolarised).")] = "u",
    bandwidth: Annotated[float | None, typer.Option(help="FWHM in nm; default: the model's line, or 0.")] = None,
    model: Annotated[str, typer.Option(help="paper, clear_chip, or a model file.")] = "paper",
    tables: Annotated[
        bool, typer.Option("--tables", help="Also fetch the tables a tracer uses, and hold them against the values.")
    ] = False,
    plot: Annotated[Path | None, typer.Option(help="Draw it into this PNG file.")] = None,
    export: Annotated[
        Path | None,
        typer.Option(
            help="Write one DBR's table for another program: .coated (Speos), .bsdf (OpticStudio), .xml (Radiance)."
        ),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")] = False,
) -> None:
    """Reflectance, transmittance or ellipsometry of a stack against angle or wavelength."""
    from luxloop.client import Client

    if (pairs is None) == (stack is None):
        raise InputError("--pairs", pairs, "--pairs or --stack", "give exactly one of the two")
    check_file("--plot", plot, (".png",))
    check_file("--export", export, EXPORTS)
    chosen = find_model(model)
    question = _Question(
        chosen, model, pairs, stack, quantity, against, angles, wavelengths, side, polarisation, bandwidth
    )
    with Client(load_settings()) as client:
        document = question.ask(client, dense=plot is not None)
        if tables or export is not None:
            fetched = question.fetch_tables(client, document)
    if export is not None:
        from containers.film_export import export_table

        document["export"] = {"file": str(export), "lost": export_table(fetched, question.side, export)}
    if plot is not None:
        _draw(document, plot)
        document["plot"] = str(plot)
    typer.echo(json.dumps(document) if as_json else _as_text(document))


class _Question:
    """The options of one call, checked, and the requests that they make."""

    def __init__(
        self,
        model: Model,
        model_name: str,
        pairs: str | None,
        stack: str | None,
        quantity: Quantity,
        against: Against,
        angles: str,
        wavelengths: str,
        side: Side | None,
        polarisation: Polarisation,
        bandwidth_nm: float | None,
    ) -> None:
        environment = model.environment
        self.model, self.model_name, self.against = model, model_name, against
        self.quantity, self.polarisation = quantity, polarisation
        self.pairs = numbers("--pairs", pairs) if pairs is not None else []
        self.stack = parse_stack(stack) if stack is not None else None
        self.side: Side = side or ("inside" if self.stack is None and quantity in ("R", "T") else "outside")
        from_chip = self.stack is None and self.side == "inside"  # beyond 24 deg all light is totally reflected there
        steps, line = "0:26:2" if from_chip else "0:85:5", f"{environment.peak_nm:g}"
        at_angle, at_wavelength = (steps, line) if against == "angle" else ("0", "400:500:10")
        self.angles_deg = numbers("--angles", angles or at_angle)
        self.wavelengths_nm = numbers("--wavelengths", wavelengths or at_wavelength)
        of_line = self.stack is None and against == "angle" and not wavelengths
        self.bandwidth_nm = bandwidth_nm if bandwidth_nm is not None else environment.fwhm_nm if of_line else 0.0
        fixed = self.wavelengths_nm if against == "angle" else self.angles_deg
        if len(fixed) != 1:
            option = "--wavelengths" if against == "angle" else "--angles"
            raise InputError(option, fixed, f"one value when the table runs against {against}")

    @property
    def axis(self) -> list[float]:
        """What runs down the table."""
        return self.angles_deg if self.against == "angle" else self.wavelengths_nm

    def ask(self, client: Client, *, dense: bool) -> dict[str, Any]:
        """The result document; with `dense` also the curves' finer points, for a plot."""
        films: list[dict[str, Any]] = [{"dbr_pairs": p} for p in self.pairs] or [{"stack": str(self.stack)}]
        fine = [self.axis[0] + (self.axis[-1] - self.axis[0]) * i / (CURVE_POINTS - 1) for i in range(CURVE_POINTS)]
        for values, name in [(self.axis, "values")] + [(fine, "curve")] * dense:
            requests = [self._request(film, values) for film in films]
            for number, answer in _answers(client, requests, "points of the curves" if name == "curve" else "films"):
                films[number][name] = [float(value) for value in answer.arrays["value"].ravel()]
                films[number].setdefault("worker", answer.worker)
        unit = "deg" if self.quantity in ("psi", "delta") else "1"
        return {
            "command": "film",
            "quantity": self.quantity,
            "unit": unit,
            "side": self.side,
            "polarisation": self.polarisation,
            "against": self.against,
            "angle_deg": self.angles_deg,
            "wavelength_nm": self.wavelengths_nm,
            "bandwidth_nm": self.bandwidth_nm,
            "model": {"name": self.model_name, "sha256": self.model.sha256},
            "films": films,
            **({"curve_axis": fine} if dense else {}),
        }

    def fetch_tables(self, client: Client, document: dict[str, Any]) -> list[FilmTable]:
        """Each DBR's table, fetched by its hash; notes what it is and how far interpolation is from the values."""
        from containers.thin_film.packing import unpack
        from containers.thin_film.table import FilmTable
        from luxloop.film import FilmTableRequest, Spectrum

        if self.stack is not None or self.against != "angle" or self.quantity not in ("R", "T"):
            raise InputError("--tables", True, "with --pairs, R or T against angle", "the same goes for --export")
        environment = self.model.environment
        line = Spectrum(peak_nm=environment.peak_nm, fwhm_nm=environment.fwhm_nm)
        requests = [
            FilmTableRequest(environment=environment, dbr_pairs=p, effects=self.model.effects, spectrum=line)
            for p in self.pairs
        ]
        tables: dict[int, FilmTable] = {}
        for number, answer in _answers(client, requests, "tables"):
            packed = client.fetch(str(answer.result["table_sha256"]), int(answer.result["table_bytes"]))
            table = FilmTable.from_parts(*unpack(packed))
            tables[number] = table
            values = document["films"][number]["values"]
            document["films"][number]["table"] = {
                "sha256": answer.result["table_sha256"],
                "bytes": len(packed),
                "nodes": int(table.u.size),
                "wavelengths": int(table.wavelength_nm.size),
                "known": answer.result["known"],
                "largest_difference": self._difference(table, values),
            }
        return [tables[number] for number in range(len(requests))]

    def _difference(self, table: FilmTable, values: list[float]) -> float:
        """Largest difference between the table, interpolated at the asked angles, and the exact values."""
        import numpy as np

        index = table.n_inside if self.side == "inside" else table.n_outside
        u = float(index @ table.weight) * np.sin(np.radians(self.angles_deg))
        power = getattr(table.average(self.side), self.quantity)
        return float(np.abs(table.at(power, u) - values).max())

    def _request(self, film: dict[str, Any], values: Sequence[float]) -> Any:
        from luxloop.film import FilmMeasurementRequest
        from luxloop.words import parse

        where = (
            {"stack": self.stack}
            if self.stack is not None
            else {"environment": self.model.environment, "dbr_pairs": film["dbr_pairs"]}
        )
        along_angle = self.against == "angle"
        return parse(
            FilmMeasurementRequest,
            {
                **where,
                "effects": tuple(effect for effect in self.model.effects if self.stack is None),
                "quantity": self.quantity,
                "wavelength_nm": tuple(self.wavelengths_nm if along_angle else values),
                "aoi_deg": tuple(values if along_angle else self.angles_deg),
                "polarisation": self.polarisation,
                "bandwidth_nm": self.bandwidth_nm,
                "from_side": self.side,
            },
        )


def _answers(client: Client, requests: list[Any], what: str) -> Iterator[tuple[int, Answer]]:
    """(number, answer) of each request; raises the first failure. A bar on a terminal, for those that take long."""
    from rich.console import Console
    from rich.progress import track

    console = Console(stderr=True)
    answers = client.map(requests)
    shown = track(
        answers, what, total=len(requests), console=console, transient=True, disable=not console.is_terminal
    )
    for number, answer in shown:
        if isinstance(answer, RemoteError):
            raise answer
        yield number, answer


def _as_text(document: dict[str, Any]) -> str:
    """The table a person reads: one row per angle or wavelength, one column per film."""
    name = "angle_deg" if document["against"] == "angle" else "wavelength_nm"
    titles = [f"{f['dbr_pairs']:g} pairs" if "dbr_pairs" in f else "value" for f in document["films"]]
    width = max(9, *(len(title) + 2 for title in titles))
    digits = 3 if document["unit"] == "deg" else 5
    lines = [_caption(document), f"{name:>13}" + "".join(f"{title:>{width}}" for title in titles)]
    for row, at in enumerate(document[name]):
        cells = "".join(f"{film['values'][row]:>{width}.{digits}f}" for film in document["films"])
        lines.append(f"{at:>13g}" + cells)
    for film in document["films"]:
        if "table" in film:
            table = film["table"]
            lines.append(
                f"table of {film['dbr_pairs']:>4g} pairs: {table['sha256'][:16]}, {table['bytes'] / 1e3:.0f} kB, "
                f"{table['wavelengths']} wavelengths x s, p x {table['nodes']} nodes, "
                f"{'from the database' if table['known'] else 'computed'}, "
                f"within {table['largest_difference']:.1e} of the values above"
            )
    if "export" in document:
        lost = ", ".join(f"{name} {size:.2g}" for name, size in document["export"]["lost"].items()) or "nothing"
        lines.append(f"exported: {document['export']['file']}; lost (power ratio at most): {lost}")
    if "plot" in document:
        lines.append(f"picture: {document['plot']}")
    return "\n".join(lines)


def _caption(document: dict[str, Any]) -> str:
    kinds = {"s": "s-polarised light", "p": "p-polarised light", "u": "unpolarised light"}
    light = "light" if document["unit"] == "deg" else kinds[document["polarisation"]]
    at = document["wavelength_nm"][0] if document["against"] == "angle" else document["angle_deg"][0]
    at_text = f"at {at:g} nm" if document["against"] == "angle" else f"at {at:g} deg"
    line = f", averaged over a line of {document['bandwidth_nm']:g} nm FWHM" if document["bandwidth_nm"] else ""
    film = document["films"][0].get("stack")
    what = film or f"DBR of the model {document['model']['name']!r}"
    unit = " in deg" if document["unit"] == "deg" else ""
    return f"{document['quantity']}{unit} of {what}, {light} from the {document['side']}, {at_text}{line}"


def _draw(document: dict[str, Any], path: Path) -> None:
    (view,) = entry_points(group="luxloop.views", name="film") or (None,)
    if view is None:
        raise InputError("--plot", str(path), "an installation with pictures", "pip install 'luxloop[viewer]'")
    view.load()(document, path)
