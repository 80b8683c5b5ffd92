"""What is put before which instruments when a data set is simulated: a plan file, or the paper's six groups."""

from __future__ import annotations

from pathlib import Path

from pydantic import Field, field_validator

from luxloop.effect import refuse_twice
from luxloop.files import read_text, toml_of
from luxloop.words import Words, parse
from validation.dataset.manifest import CameraFacts, FilmLayer, FilmSample, Sample

DECLARED = CameraFacts(
    pixel_um=8.0, bit_depth=12, gain_dn_per_e=0.38, read_noise_e=6.0, full_well_e=10_000.0, black_level_dn=64.0
)
"""The camera at which all targets of the project are stated; one frame of 128 x 128 pixels."""
FILM = FilmSample(
    id="gan-on-sapphire",
    layers=(
        FilmLayer(material="GaN", thickness_nm=5600.0),
        FilmLayer(material="Al2O3", thickness_nm=430_000.0, coherent=False),
    ),
)
"""Where a plan has no films: what an epitaxial wafer shows."""


def paper_samples() -> tuple[Sample, ...]:
    """The paper's six groups: a single chip and 5 x 5 of them, with 0, 2.5 and 5.5 pairs (its Fig. 5)."""
    common = {"distance_um": 180.0, "width_um": 40.0, "spacing_um": 400.0, "thickness_um": 20.0}
    layouts = {"single": {}, "array": {"rows": 5, "columns": 5}}
    return tuple(
        parse(Sample, {"id": f"{layout}-{pairs:g}", "layout": layout, "dbr_pairs": pairs, **chips, **common})
        for layout, chips in layouts.items()
        for pairs in (0.0, 2.5, 5.5)
    )


class Plan(Words):
    """A plan file: which samples are put before which camera, one image of each; which films have their spectra.

    What it leaves out is the paper's: its samples, and a wafer for a film.
    """

    name: str = "simulated"
    licence: str = ""
    camera: CameraFacts = DECLARED
    samples: tuple[Sample, ...] = Field(default_factory=paper_samples, min_length=1, max_length=64)
    films: tuple[FilmSample, ...] = Field((FILM,), min_length=1, max_length=64)

    @field_validator("samples")
    @classmethod
    def _ids_differ(cls, samples: tuple[Sample, ...]) -> tuple[Sample, ...]:
        refuse_twice("samples", (sample.id for sample in samples))
        return samples

    @field_validator("films")
    @classmethod
    def _film_ids_differ(cls, films: tuple[FilmSample, ...]) -> tuple[FilmSample, ...]:
        refuse_twice("films", (film.id for film in films))
        return films


def paper_plan() -> Plan:
    """The paper's six groups before the declared camera."""
    return Plan(name="paper-like set, single chips and 5 x 5 arrays", licence="CC0-1.0")


def read_plan(path: Path) -> Plan:
    """The plan in a TOML file: name, licence, [camera], [[samples]], [[films]] as in a data set; else InputError."""
    text = read_text(path, "--plan", "a TOML file with [[samples]], [[films]]")
    return parse(Plan, toml_of(text, path.name), path.name)


def with_camera(plan: Plan, **changes: float | None) -> Plan:
    """The plan with what options change of its camera; InputError for what no camera has."""
    given = {name: value for name, value in changes.items() if value is not None}
    return plan.model_copy(update={"camera": parse(CameraFacts, plan.camera.model_dump() | given, "camera")})
