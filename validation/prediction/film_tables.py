"""Film tables of DBRs, asked of the thin-film worker once and remembered."""

from __future__ import annotations

from typing import TYPE_CHECKING

from luxloop.film import FilmTableRequest, Spectrum
from luxloop.model import Environment
from luxloop.ray import Film

if TYPE_CHECKING:
    from luxloop.model import Model
    from validation.prediction.catalogue import Catalogue
    from validation.prediction.words import Asks

FIELDS = ("peak_nm", "fwhm_nm", "indices", "n_gan", "n_aln", "gan_layer_nm", "aln_layer_nm", "layer_order")
"""All of an environment that decides a DBR; the rest moves in a fit, and no table with it."""


class FilmTables:
    """The tables of one session."""

    def __init__(self, client: Asks, catalogue: Catalogue) -> None:
        self._client, self._catalogue = client, catalogue
        self._known: dict[str, Film] = {}
        self._fresh = False

    def of(self, model: Model, dbr_pairs: float) -> Film | None:
        """The table of a DBR of the model; None without pairs. Raises RemoteError."""
        if not dbr_pairs:
            return None
        environment = Environment(**{name: getattr(model.environment, name) for name in FIELDS})
        line = Spectrum(peak_nm=environment.peak_nm, fwhm_nm=environment.fwhm_nm)
        effects = self._catalogue.of_films(model)
        request = FilmTableRequest(environment=environment, dbr_pairs=dbr_pairs, spectrum=line, effects=effects)
        key = request.model_dump_json()
        if key not in self._known:
            result = self._client.run(request, fresh=self._fresh).result
            self._known[key] = Film(sha256=str(result["table_sha256"]), bytes=int(result["table_bytes"]))
        return self._known[key]

    def forget(self) -> None:
        """Whoever held the tables has gone: from now on they are computed again."""
        self._known.clear()
        self._fresh = True
