"""What `effects check` demands of whole predictions: the shipped examples keep it, and the mend it names is right.

On two images of single chips, which is what a trial of seconds can look at.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from containers.effects import side_wall_roughness
from luxloop.model_file import find_model
from tests.validation.workers import Workers
from validation.effects import checking
from validation.effects.confusing import Ground, image_ground
from validation.effects.example_set import example_images
from validation.effects.known import Known, acting
from validation.effects.signatures import Sight
from validation.effects.templates import source_of
from validation.prediction import Predictor

PAPER = find_model("paper")
STAGES = ("stack", "surface", "volume", "emission", "geometry", "module", "detector")
UNSAID = "my_unsaid"
"""Rough side faces without the line that says that each value has walks of its own."""


@pytest.fixture(scope="module")
def workers(tmp_path_factory: pytest.TempPathFactory) -> Workers:
    """Workers that know the examples of all stages that images show."""
    folder = tmp_path_factory.mktemp("effects")
    for stage in STAGES:
        (folder / f"my_{stage}.py").write_text(source_of(f"my_{stage}", stage))
    rough = Path(side_wall_roughness.__file__).read_text()
    assert "    walks = True\n" in rough
    unsaid = rough.replace("    walks = True\n", "").replace('"side_wall_roughness"', f'"{UNSAID}"')
    (folder / f"{UNSAID}.py").write_text(unsaid)
    return Workers(tmp_path_factory.mktemp("films"), folder)


@pytest.fixture(scope="module")
def known(workers: Workers) -> Known:
    """All effects."""
    return Known.ask(workers)


@pytest.fixture(scope="module")
def ground(workers: Workers, known: Known) -> Ground:
    """Two single chips."""
    predictor = Predictor(workers)
    images = [one for one in example_images(PAPER, predictor) if one.sample.layout == "single"][:2]
    return image_ground(PAPER, predictor, known, images, histories=100_000)


@pytest.mark.parametrize("stage", STAGES)
def test_the_example_of_a_stage_keeps_what_is_demanded(
    stage: str, workers: Workers, known: Known, ground: Ground
) -> None:
    """Who changes an example should begin with one that nothing is wrong with."""
    spec = known.spec(f"my_{stage}")
    found = list(checking.derivative(ground, PAPER, spec, ground.columns(PAPER, spec)))
    assert len(found) == len(acting(spec))
    found.append(checking.shared_numbers(ground, Predictor(workers), PAPER, spec))
    assert not [one.said for one in found if one.ok is False]
    assert (found[-1].ok is None) == spec.walks


def test_an_effect_on_the_mirror_is_seen_though_the_last_image_has_none(
    workers: Workers, known: Known, ground: Ground
) -> None:
    """A data set of one's own has its images in any order."""
    views = sorted(ground.sight.views, key=lambda one: -one.sample.dbr_pairs)
    last = [replace(one, sample=one.sample.model_copy(update={"dbr_pairs": 0.0})) for one in views[1:]]
    other = replace(ground, sight=Sight(Predictor(workers), [views[0], *last], (), known.beyond_twin))
    assert views[0].sample.dbr_pairs > 0.0
    assert other.columns(PAPER, known.spec("dbr_thickness_error"))


def test_walks_that_nobody_told_of_are_found_and_the_mend_is_to_tell(known: Known, ground: Ground) -> None:
    """Its derivative is another one with another step: by noise, and the sentence says so."""
    spec = known.spec(UNSAID)
    (found,) = checking.derivative(ground, PAPER, spec, ground.columns(PAPER, spec))
    assert found.ok is False
    assert found.said.endswith("each value has its own: write walks = True")


def test_a_square_that_is_taken_for_a_value_is_found(known: Known, ground: Ground) -> None:
    """Faces that are rough by s nm show s^2: in s there is no slope at off."""
    spec = known.spec("my_stack")
    (rough,) = spec.parameters
    plain = spec.model_copy(update={"parameters": (rough.model_copy(update={"score_variable": "value"}),)})
    (found,) = checking.derivative(ground, PAPER, plain, ground.columns(PAPER, plain))
    assert found.ok is False
    assert found.said.endswith("is score = 'square' right, or a range smaller?")
