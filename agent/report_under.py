"""Winners under several models: does what one model lacks change which design is the best?

winners (one of each run) x models ──film, then rays──▶ uniformity with its error ──▶ rows and differences
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from agent.report_numbers import difference
from luxloop.campaign import LIMIT_S, Fidelity
from luxloop.design import Design
from luxloop.errors import LuxloopError, RemoteError
from luxloop.film import FilmTableRequest, Spectrum
from luxloop.model import Model
from luxloop.ray import Film, RayRequest
from luxloop.words import sha256_of

if TYPE_CHECKING:
    from luxloop.client import Answer, Client

Document = dict[str, Any]
SIGMAS = 2.0  # a difference above so many of its standard errors is one


@dataclass(frozen=True)
class Winner:
    """The best design of a run."""

    run: str
    design: Design


@dataclass(frozen=True)
class Named:
    """A model and what the command line calls it."""

    name: str
    model: Model


def questions(winners: Sequence[Winner], models: Sequence[Named]) -> list[tuple[Winner, Named]]:
    """Every winner under every model, in the order of the table."""
    return list(itertools.product(winners, models))


def row_under(client: Client, winner: Winner, named: Named, how: Fidelity) -> Document:
    """One winner under one model: its figures with errors, or why it cannot be built there.

    Raises RemoteError where no worker can say.

    Notes
    -----
    The seed is of the run, the design and the model, so rows are independent of each other and of what chose the
    design: the best of several noisy finalists is not flattered here.
    """
    model, design = named.model, winner.design
    environment = model.environment
    seed = str(int(sha256_of({"run": winner.run, "design": str(design), "model": model.sha256})[:15], 16))
    row: Document = {
        "run": winner.run,
        "design": design.model_dump(mode="json"),
        "f": design.f,
        "model": named.name,
        "model_sha256": model.sha256,
        "seed": seed,
        "reason": design.feasibility(environment.distance_from, environment.spacing_is) or "",
    }
    if row["reason"]:
        return row
    request = RayRequest(
        environment=environment, design=design, effects=model.effects, seed=seed, exit_seed=seed,
        method=how.method, histories=how.histories, target_error_points=how.target_error_points,
        budget_s=how.budget_s, stored_exits=how.stored_exits,
    )  # fmt: skip
    result = _answer(client, request, film_request(model, design)).result
    metrics = result["metrics"]
    names = ("uniformity", "mean_illuminance_lx", "optical_efficiency", "hot_spot_ratio")
    return row | {name: metrics.get(name) for name in names} | {"histories": result["histories"]}


def film_request(model: Model, design: Design) -> FilmTableRequest | None:
    """What PC2 is asked for: the table of the design's DBR in the light of the model; None without pairs."""
    if not design.dbr_pairs:
        return None
    environment = model.environment
    line = Spectrum(peak_nm=environment.peak_nm, fwhm_nm=environment.fwhm_nm)
    return FilmTableRequest(environment=environment, dbr_pairs=design.dbr_pairs, effects=model.effects, spectrum=line)


def differences(rows: Sequence[Document]) -> list[Document]:
    """Each winner between the models, and under each model between the winners, with combined errors."""
    found = []
    for one, other in itertools.combinations(rows, 2):
        same_run = one["run"] == other["run"] and one["design"] == other["design"]
        same_model = one["model"] == other["model"]
        if same_run == same_model or one["reason"] or other["reason"]:
            continue
        change = difference(other, one) or {}
        shift = change["uniformity"]
        found.append({
            "between": "models" if same_run else "winners",
            "of": one["run"] if same_run else one["model"],
            "from": one["model"] if same_run else one["run"],
            "to": other["model"] if same_run else other["run"],
            **change,
            "significant": abs(shift["value"]) > SIGMAS * shift["standard_error"],
        })  # fmt: skip
    return found


def under_of(models: Iterable[Named], rows: Sequence[Document], how: Fidelity) -> Document:
    """The part of the document that says what the winners are worth under each model."""
    return {
        "models": [{"name": named.name, "sha256": named.model.sha256} for named in models],
        "rows": list(rows),
        "differences": differences(rows),
        "fidelity": how.model_dump(mode="json"),
    }


def _answer(client: Client, request: RayRequest, film: FilmTableRequest | None) -> Answer:
    """PC3's answer; a table that nobody holds any more is computed again, once."""
    if film is None:
        return _run(client, request)
    try:
        return _run(client, with_film(request, _run(client, film)))
    except RemoteError as error:
        if error.failure.code != "not_found":
            raise
    return _run(client, with_film(request, client.run(film, limit_s=LIMIT_S, fresh=True)))


def with_film(request: RayRequest, table: Answer) -> RayRequest:
    """The request for the table that PC2 answered."""
    film = Film(sha256=str(table.result["table_sha256"]), bytes=int(table.result["table_bytes"]))
    return request.model_copy(update={"film": film})


def _run(client: Client, request: RayRequest | FilmTableRequest) -> Answer:
    """The answer; left early (Ctrl-C), the request is withdrawn, so that its worker is free at once."""
    try:
        return client.run(request, limit_s=LIMIT_S)
    except KeyboardInterrupt:
        with suppress(LuxloopError):
            client.withdraw(request)
        raise
