"""Predictions of images, spectra and far fields through one client."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from luxloop.errors import RemoteError
from validation.prediction import far_fields, images, spectra
from validation.prediction.catalogue import Catalogue
from validation.prediction.film_tables import FilmTables
from validation.prediction.words import Anchored, Asks, Curve, FarView, Predicted, PredictedCurve, Real, Traced, View

if TYPE_CHECKING:
    from luxloop.client import Answer
    from luxloop.model import Model

T = TypeVar("T")
Heard = Callable[[int, int], None]
Progress = Callable[[float, str], None]

LIMIT_S = 86_400.0
"""Of one attempt: an anchor of many histories takes long."""


class Predictor:
    """What asks the workers; film tables are remembered, so keep one for a session."""

    def __init__(self, client: Asks) -> None:
        self._client, self._catalogue = client, Catalogue(client)
        self._films = FilmTables(client, self._catalogue)
        self._progress: Progress | None = None
        self._noise_of_data: Mapping[str, Real] = {}

    def telling(self, progress: Progress) -> Predictor:
        """The same; `progress` is told the share done of each long answer, and what is done, from several threads."""
        found = copy(self)
        found._progress = progress
        return found

    def knowing(self, noise_per_mm2: Mapping[str, Real]) -> Predictor:
        """The same, for data that are Monte Carlo's own: their noise is told with that of an anchor.

        Parameters
        ----------
        noise_per_mm2 : (function, row, column) by sample, as in `Predicted`. A laboratory's light has none.
        """
        found = copy(self)
        found._noise_of_data = noise_per_mm2
        return found

    def images(
        self,
        model: Model,
        views: Sequence[View],
        paths: Sequence[str] = (),
        anchor: Anchored | None = None,
        *,
        noise: bool = True,
    ) -> list[Predicted]:
        """The expected images of views, in their order.

        Parameters
        ----------
        paths : parameters of the model, and names of `POSE_COLUMNS`, to differentiate by.
        anchor : where Monte Carlo is run; none: the twin alone. Derivatives by parameters that no worker
            differentiates (all but reflectances, the substrate's sigma, absorption and poses) are then those there.
        noise : of the anchor's Monte Carlo, with the images. Without it they are by another run, whose noise is not
            theirs, for differences between images of one anchor.

        Raises
        ------
        InputError : a path that is not in the model or cannot move.
        RemoteError : what a worker refuses, with the field of its shot.
        """
        known = self._catalogue
        special = known.beyond_twin(model), known.on_all_light(model), known.by_chance(model)
        wanted = images.Wanted(model, tuple(paths), anchor, self._films.of, *special, noise=noise)
        found = self._again(lambda: images.predict(wanted, views, self._answers))
        return [self._with_noise_of_data(one, view) for one, view in zip(found, views, strict=True)]

    def several(self, wanted: Sequence[tuple[Model, View]], lender: Model, exit_seed: int = 1) -> list[Real]:
        """The twin's images (row, column) of views, each in a model of its own, as many together as a request holds.

        Parameters
        ----------
        lender : whose chips' exits stand for those of a chip near them, so that what was moved has no new noise.
        exit_seed : of the walks inside chips.
        """
        return self._again(lambda: images.several(wanted, lender, self._films.of, self._answers, exit_seed))

    def monte_carlo(
        self, model: Model, views: Sequence[View], histories: int, seed: int, heard: Heard | None = None
    ) -> list[Traced]:
        """The images of views by Monte Carlo alone, each with random numbers of its own: what a truth is made of.

        Parameters
        ----------
        histories : for each view, at least so many.
        heard : told how many of how many views are done.
        """

        def ask() -> list[Traced]:
            requests = [images.simulation(model, v, histories, seed, n, self._films.of) for n, v in enumerate(views)]
            return [images.simulated(*one) for one in zip(self._answers(requests, heard), views, strict=True)]

        return self._again(ask)

    def spectra(self, model: Model, curves: Sequence[Curve], paths: Sequence[str] = ()) -> list[PredictedCurve]:
        """The expected spectra of films; paths: "films.ID.layers.N.thickness_nm", ".a", ".b_um2", and effects'."""
        return spectra.predict(model, curves, tuple(paths), self._answers)

    def far_fields(
        self,
        model: Model,
        views: Sequence[FarView],
        paths: Sequence[str] = (),
        histories: int = far_fields.HISTORIES,
        seed: int = 1,
    ) -> list[PredictedCurve]:
        """The far fields of modules by Monte Carlo, per flux of a chip; derivatives have common random numbers."""
        wanted = far_fields.Wanted(model, tuple(paths), histories, seed, self._films.of)
        return self._again(lambda: far_fields.predict(wanted, views, self._answers))

    def _with_noise_of_data(self, found: Predicted, view: View) -> Predicted:
        own, of_data = found.noise_per_mm2, self._noise_of_data.get(view.sample.id)
        if own is None or of_data is None:
            return found
        return replace(found, noise_per_mm2=np.concatenate([own, of_data]))

    def _answers(self, requests: Sequence[Any], heard: Heard | None = None) -> list[Answer]:
        """The answers to requests, in their order; the first failure is raised."""
        found: dict[int, Answer] = {}
        tell = self._progress
        options: Any = {} if tell is None else {"on_pending": lambda at: tell(at.progress_ratio, at.note)}
        for number, answer in self._client.map(requests, limit_s=LIMIT_S, **options):
            if isinstance(answer, RemoteError):
                raise answer
            found[number] = answer
            if heard is not None:
                heard(len(found), len(requests))
        return [found[number] for number in range(len(requests))]

    def _again(self, ask: Callable[[], T]) -> T:
        """What was asked; once more where a film table has gone with its worker."""
        try:
            return ask()
        except RemoteError as error:
            if error.failure.code != "not_found":
                raise
        self._films.forget()
        return ask()
