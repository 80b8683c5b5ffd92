"""`luxloop film`: what a stack or the DBR of a model does to light, against angle or wavelength; computed by PC2."""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from containers.asking import answers, connected, fetched
from containers.drawing import PICTURES, view
from containers.film_text import as_text
from containers.typed import angles_deg, bandwidth_nm, check_file, dbr_pairs, parse_stack, wavelengths_nm
from luxloop.errors import InputError
from luxloop.model_file import find_model
from luxloop.settings import load_settings, usable_cache

if TYPE_CHECKING:
    from containers.thin_film.table import FilmTable
    from luxloop.client import Client
    from luxloop.film import FilmMeasurementRequest, FilmTableRequest
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
    plot: Annotated[Path | None, typer.Option(help="Draw it into this file: .png, .pdf or .svg.")] = None,
    export: Annotated[
        Path | None,
        typer.Option(
            help="Write one DBR's table for another program: .coated (Speos), .bsdf (OpticStudio), .xml (Radiance)."
        ),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object on stdout.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", help="Say nothing on stderr but errors.")] = False,
) -> None:
    """Reflectance, transmittance or ellipsometry of a stack against angle or wavelength."""
    if (pairs is None) == (stack is None):
        given = "neither" if pairs is None else "both"
        raise InputError("--pairs, --stack", given, "exactly one of the two", "e.g. --pairs 5.5")
    question = _Question(
        find_model(model), model, pairs, stack, quantity, against, angles, wavelengths, side, polarisation, bandwidth
    )
    measurements = question.measurements(dense=plot is not None)
    wanting = "--tables" if tables else "--export"
    table_requests = question.table_requests(wanting) if tables or export is not None else []
    if export is not None and len(table_requests) != 1:
        raise InputError("--export", str(export), "one number of pairs", "export one DBR at a time")
    check_file("--plot", plot, PICTURES)
    check_file("--export", export, EXPORTS)
    if table_requests and find_spec("numba") is None:  # a table's modules hold kernels; the designer's image has none
        mend = "pip install 'luxloop[workers]'"
        raise InputError(wanting, tables or str(export), "an installation with numba", mend)
    draw = view("film", plot) if plot is not None else None
    settings = load_settings()
    usable_cache(settings)
    show = sys.stderr.isatty() and not (as_json or quiet)
    with connected(settings, show) as client:
        document = question.ask(client, measurements, show)
        film_tables = question.fetch_tables(client, table_requests, document, show) if table_requests else []
    if export is not None:
        from containers.film_export import export_table

        document["export"] = {"file": str(export), "lost": export_table(film_tables[0], question.side, export)}
    if plot is not None and draw is not None:
        draw(document, plot)
        document["plot"] = str(plot)
    columns = shutil.get_terminal_size().columns if sys.stdout.isatty() else None
    typer.echo(json.dumps(document) if as_json else as_text(document, columns))


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
        bandwidth: float | None,
    ) -> None:
        environment = model.environment
        self.model, self.model_name, self.against = model, model_name, against
        self.quantity, self.polarisation = quantity, polarisation
        self.own_line = {"--wavelengths": wavelengths or None, "--bandwidth": bandwidth}
        self.pairs = dbr_pairs("--pairs", pairs) if pairs is not None else []
        self.stack = parse_stack(stack) if stack is not None else None
        self.side: Side = side or ("inside" if self.stack is None and quantity in ("R", "T") else "outside")
        from_chip = self.stack is None and self.side == "inside"  # beyond 24 deg all light is totally reflected there
        steps, line = "0:26:2" if from_chip else "0:85:5", f"{environment.peak_nm:g}"
        at_angle, at_wavelength = (steps, line) if against == "angle" else ("0", "400:500:10")
        self.angles_deg = angles_deg("--angles", angles or at_angle)
        self.wavelengths_nm = wavelengths_nm("--wavelengths", wavelengths or at_wavelength)
        of_line = self.stack is None and against == "angle" and not wavelengths
        default_nm = environment.fwhm_nm if of_line else 0.0
        self.bandwidth_nm = bandwidth_nm("--bandwidth", default_nm if bandwidth is None else bandwidth)
        fixed = self.wavelengths_nm if against == "angle" else self.angles_deg
        if len(fixed) != 1:
            option = "--wavelengths" if against == "angle" else "--angles"
            allowed, mend = f"one value when the table runs against {against}", "ask for each in turn"
            raise InputError(option, fixed, allowed, mend)

    @property
    def axis(self) -> list[float]:
        """What runs down the table."""
        return self.angles_deg if self.against == "angle" else self.wavelengths_nm

    @property
    def curve_axis(self) -> list[float]:
        """The finer points that a plot is drawn through."""
        first, last = min(self.axis), max(self.axis)
        if first == last:
            return [first]
        return [first + (last - first) * i / (CURVE_POINTS - 1) for i in range(CURVE_POINTS)]

    @property
    def films(self) -> list[dict[str, Any]]:
        """What each column is about."""
        return [{"dbr_pairs": p} for p in self.pairs] or [{"stack": str(self.stack)}]

    def measurements(self, *, dense: bool) -> dict[str, list[FilmMeasurementRequest]]:
        """The requests by the name of what they answer: the films' `values`; with `dense` also each `curve`."""
        from containers.stack import dbr_of, resolve

        wanted = {"values": self.axis} | ({"curve": self.curve_axis} if dense else {})
        requests = {name: [self._request(film, values) for film in self.films] for name, values in wanted.items()}
        stack = self.stack if self.stack is not None else dbr_of(self.model.environment, max(self.pairs))
        resolve(stack, self.wavelengths_nm)  # a material that is not there, or has no data for a wavelength
        return requests

    def table_requests(self, option: str) -> list[FilmTableRequest]:
        """A request for each DBR's table; `option` is what asks for them."""
        from luxloop.film import FilmTableRequest, Spectrum

        if self.stack is not None or self.against != "angle" or self.quantity not in ("R", "T"):
            asked = f"{self.quantity} of {'a stack' if self.stack else 'a DBR'} against {self.against}"
            raise InputError(option, asked, "R or T of a DBR against angle", "use --pairs, and leave --against out")
        for name, value in self.own_line.items():
            if value is not None:
                mend = f"leave it out beside {option}: a table is of the model's line; change that in a model file"
                raise InputError(name, value, "values without a table, or stack, alone", mend)
        environment = self.model.environment
        line = Spectrum(peak_nm=environment.peak_nm, fwhm_nm=environment.fwhm_nm)
        return [
            FilmTableRequest(environment=environment, dbr_pairs=p, effects=self.model.effects, spectrum=line)
            for p in self.pairs
        ]

    def ask(
        self, client: Client, measurements: dict[str, list[FilmMeasurementRequest]], show: bool
    ) -> dict[str, Any]:
        """The result document."""
        films, warnings = self.films, dict[str, None]()
        for name, requests in measurements.items():
            for number, answer in answers(client, requests, "films" if name == "values" else "curves", show):
                films[number][name] = [float(value) for value in answer.arrays["value"].ravel()]
                films[number].setdefault("worker", answer.worker)
                warnings |= dict.fromkeys(answer.result.get("warnings", ()))
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
            "warnings": list(warnings),
            **({"curve_axis": self.curve_axis} if "curve" in measurements else {}),
        }

    def fetch_tables(
        self, client: Client, requests: list[FilmTableRequest], document: dict[str, Any], show: bool
    ) -> list[FilmTable]:
        """Each DBR's table, fetched by its hash; notes what it is and how far interpolation is from the values."""
        from containers.thin_film.packing import unpack
        from containers.thin_film.table import FilmTable

        tables: dict[int, FilmTable] = {}
        for number, first in answers(client, requests, "tables", show):
            answer, packed = fetched(client, requests[number], first)
            tables[number] = table = FilmTable.from_parts(*unpack(packed))
            film = document["films"][number]
            film["table"] = {
                "sha256": answer.result["table_sha256"],
                "bytes": len(packed),
                "nodes": int(table.u.size),
                "wavelengths": int(table.wavelength_nm.size),
                "known": answer.result["known"],
                "largest_difference": self._difference(table, film["values"]),
                "error_average_ratio": table.error_average_ratio,
                "error_single_ratio": table.error_single_ratio,
                "resolved": table.resolved,
            }
        return [tables[number] for number in range(len(requests))]

    def _difference(self, table: FilmTable, values: list[float]) -> float:
        """Largest difference between the table, interpolated at the asked angles, and the exact values."""
        import numpy as np

        index = table.n_inside if self.side == "inside" else table.n_outside
        u = float(index @ table.weight) * np.sin(np.radians(self.angles_deg))
        power = getattr(table.powers(self.side), self.quantity)
        kept = power.mean(axis=1) if self.polarisation == "u" else power[:, "sp".index(self.polarisation)]
        return float(np.abs(table.at(table.weight @ kept, u) - values).max())

    def _request(self, film: dict[str, Any], values: Sequence[float]) -> FilmMeasurementRequest:
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
                "effects": self.model.effects,
                "quantity": self.quantity,
                "wavelength_nm": tuple(self.wavelengths_nm if along_angle else values),
                "aoi_deg": tuple(values if along_angle else self.angles_deg),
                "polarisation": self.polarisation,
                "bandwidth_nm": self.bandwidth_nm,
                "from_side": self.side,
            },
        )
