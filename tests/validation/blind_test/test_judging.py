"""What sets of one light share: the anchor with which the fit of the first one ended."""

from __future__ import annotations

import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from luxloop.errors import InputError
from luxloop.model_file import find_model
from tests.validation.analytic import HALO, MODEL, PATHS, SIGMA, Spots, two_images
from tests.validation.blind_test.pretend import answer, bound_folder_of, folder_of, record
from validation.blind_test import code as code_module
from validation.blind_test import judging, told
from validation.blind_test.bound import Chain, close
from validation.blind_test.code import PACKAGES, code_sha256
from validation.blind_test.folders import CHAIN, SETS, Entry, read_index, write_whole
from validation.blind_test.judging import KEPT, Judge, Shared, SharedDiagnosing, SharedSolver, not_made, seed_of_light
from validation.blind_test.records import read_record, record_path
from validation.blind_test.seals import seal
from validation.comparing import Solver
from validation.diagnose.anew import about_itself
from validation.diagnose.ground import Ground
from validation.diagnosing import Diagnosing
from validation.observed import Observed
from validation.prediction import Anchored


def test_a_state_of_the_sources_is_all_of_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Names and bytes of three packages: a change in any, or another name, is another state."""
    for package in PACKAGES:
        (tmp_path / package / "inside").mkdir(parents=True)
        (tmp_path / package / "inside" / "light.py").write_text("x = 1\n")
    found = {package: SimpleNamespace(submodule_search_locations=[str(tmp_path / package)]) for package in PACKAGES}
    monkeypatch.setattr(code_module, "find_spec", found.get)
    states = {code_sha256.__wrapped__(), code_sha256.__wrapped__()}
    assert len(states) == 1
    for package in PACKAGES:
        (tmp_path / package / "inside" / "light.py").write_text("x = 2\n")
        states.add(code_sha256.__wrapped__())
    (tmp_path / "luxloop" / "inside" / "light.py").rename(tmp_path / "luxloop" / "light.py")
    assert len(states | {code_sha256.__wrapped__()}) == 1 + len(PACKAGES) + 1


PAPER = find_model("paper")
MOVED = PAPER.with_value("environment.receiver.reflectance", 0.3)


def test_sets_that_are_not_made_yet_are_passed_over(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A killed make left one of two sets: that one gets its verdict, and the other one is said."""
    folder = folder_of(tmp_path / "run", (answer("set-1"), None), (answer("set-2"), None))
    shutil.rmtree(folder / SETS / "set-1")
    index, nobody = read_index(folder), cast("Any", None)
    judge = Judge(folder, PAPER, nobody, nobody, Solver(None))

    def verdict(self: Judge, one: Entry, shared: Shared, chain: Chain) -> dict[str, Any]:
        placed = chain.added(record("nothing_visible", id=one.id))
        write_whole(record_path(folder, one.id), placed)
        return placed

    monkeypatch.setattr(Judge, "_verdict", verdict)
    assert [one["id"] for one in judge.verdicts(index)] == ["set-2"]
    assert not_made(folder, index) == ["set-1"]
    document = {"folder": "run", "judged": 1, "before": 0, "not_made": 1, "verdicts": {}}
    assert any("1 sets are not made yet: repeat the `luxloop blind make run" in one for one in told.judged(document))
    seal(folder, folder / SETS / "set-1", answer("set-1"))
    closed = close(folder, index)
    assert [one["id"] for one in judge.verdicts(closed)] == ["set-1"]
    shutil.rmtree(folder / SETS / "set-1")
    assert not_made(folder, closed) == []  # a gap in a whole folder is damage


def test_a_chain_that_was_cut_short_is_ended(tmp_path: Path) -> None:
    """Killed between the last record and the chain: its file stayed one behind for good, and so did what is noted."""
    said = record("nothing_visible")
    folder = bound_folder_of(tmp_path / "run", *((answer(name), said) for name in ("set-1", "set-2")))
    whole, nobody = (folder / CHAIN).read_bytes(), cast("Any", None)
    judge = Judge(folder, PAPER, nobody, nobody, Solver(None))
    first = read_record(folder, "set-1")
    Chain(1, first["sha256"]).write(folder)
    for _ in range(2):
        assert list(judge.verdicts(read_index(folder))) == []
        assert (folder / CHAIN).read_bytes() == whole
    for name in ("set-1", "set-2"):
        record_path(folder, name).unlink()
    with pytest.raises(InputError, match="a verdict was taken away"):
        next(judge.verdicts(read_index(folder)))


def test_the_first_set_makes_its_anchor_anew_where_its_fit_moves_and_lends_the_last(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Where the twin ends at first may be far from where the fit ends: 311 /cm for 205, with nothing hidden."""
    shared = Shared("a")
    solver = SharedSolver(1000, 1, shared=shared)
    nobody: Any = None  # neither data nor workers are asked here
    engine: Any = SharedDiagnosing(PAPER, nobody, nobody, nobody, solver, (), shared=shared)

    def fitted(self: Any, model: Any) -> Any:
        asked = [self.solver.anchor(one) for one in (model, MOVED)]
        return SimpleNamespace(problem=SimpleNamespace(anchor=asked[-1]), asked=asked)

    monkeypatch.setattr(Diagnosing, "fitted", fitted)
    first, second = engine.fitted(PAPER), engine.fitted(PAPER)
    assert first.asked == [Anchored(PAPER, 1000, 1), Anchored(MOVED, 1000, 1)]
    assert second.asked == [Anchored(MOVED, 1000, 1)] * 2


def test_a_further_set_of_a_light_ends_where_a_fit_of_its_own_does_with_fewer_questions() -> None:
    """Other noise on the same scene: begun where the first one ended, or from nothing where that is not trusted."""
    solver, shared, known = Solver(1000), Shared("a"), cast("Any", SimpleNamespace(specs=[]))

    def engine(kind: Any, seed: int, **more: Any) -> tuple[Any, Spots]:
        predictor, observed = Spots(), Observed(tuple(two_images(seed)), (), (), {})
        return kind(MODEL, observed, predictor, known, solver, PATHS, **more), predictor

    first = engine(SharedDiagnosing, 1, shared=shared)[0].fitted(MODEL)
    shared.ground = cast("Any", SimpleNamespace(fit=first))
    (own, asked), (begun, fewer) = engine(Diagnosing, 2), engine(SharedDiagnosing, 2, shared=shared)
    alone, found = own.fitted(MODEL), begun.fitted(MODEL)
    assert fewer.asked < asked.asked
    for path in PATHS:
        assert abs(found.value(path) - alone.value(path)) < 0.1 * alone.error(path)
    assert found.chi2 == pytest.approx(alone.chi2, abs=1.0)  # each by the whitening of where it stood before
    shared.ground = cast("Any", SimpleNamespace(fit=first.doubted(["it"])))
    again, afresh = engine(SharedDiagnosing, 2, shared=shared)
    again.fitted(MODEL)
    assert afresh.asked > fewer.asked


def test_a_further_set_of_a_light_is_fitted_by_its_own_priors() -> None:
    """By what its entry says was known before, as a fit by itself is; the first one's are another laboratory's."""
    solver, shared, known = Solver(1000), Shared("a"), cast("Any", SimpleNamespace(specs=[]))
    tight = MODEL.model_copy(
        update={"fit": MODEL.fit | {SIGMA: MODEL.fit[SIGMA].model_copy(update={"prior_sd": 0.02})}}
    )
    first, second = (Entry(id=f"set-{n}", light="a", priors={SIGMA: mean}) for n, mean in ((1, 5.95), (2, 6.05)))

    def engine(kind: Any, one: Entry, **more: Any) -> Any:
        observed = Observed(tuple(two_images(int(one.id[-1]))), (), (), {})
        return kind(one.known_before(tight), observed, Spots(), known, solver, PATHS, **more)

    begun: Any = engine(SharedDiagnosing, first, shared=shared)
    shared.ground = cast("Any", SimpleNamespace(fit=begun.fitted(begun.model)))
    alone, other, found = (
        each.fitted(each.model)
        for each in (
            engine(Diagnosing, second), engine(Diagnosing, first.model_copy(update={"id": "set-2"})),
            engine(SharedDiagnosing, second, shared=shared),
        )
    )  # fmt: skip
    assert abs(alone.value(SIGMA) - other.value(SIGMA)) > 0.5 * alone.error(SIGMA)
    for path in PATHS:
        assert abs(found.value(path) - alone.value(path)) < 0.1 * alone.error(path)
    for each in (found, about_itself(found)):  # the latter where a fit has gone too far from the first one's anchor
        assert each.model.fit[SIGMA].prior_mean == 6.05
        assert {p.name: p.prior_mean for p in each.problem.unknowns.parameters}[SIGMA] == 6.05
    pulls = [one.residual_with_priors[len(one.residual)] for one in (alone, found, other)]  # from SIGMA's prior
    assert abs(pulls[1] - pulls[0]) < 0.1 < 0.5 < abs(pulls[2] - pulls[0])


def test_a_light_is_judged_by_random_numbers_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By one seed the anchors of all truths erred alike; the record says by which, and what was known before."""
    sets = [answer(f"set-{n}", light=light) for n, light in ((1, "of-a"), (2, "of-a"), (3, "of-b"))]
    folder, nobody = bound_folder_of(tmp_path / "run", *((one, None) for one in sets)), cast("Any", None)
    own = {SIGMA: 6.5}
    index = read_index(folder)
    index = index.model_copy(
        update={"sets": tuple(one.model_copy(update={"priors": own}) for one in index.sets)}
    )  # as `make` writes it
    asked: list[tuple[float | None, int]] = []

    def diagnosed(self: SharedDiagnosing) -> Any:
        asked.append((self.model.fit[SIGMA].prior_mean, self.solver.seed))

    monkeypatch.setattr(SharedDiagnosing, "diagnosed", diagnosed)
    monkeypatch.setattr(judging, "read_dataset", lambda _: SimpleNamespace(sha256="d" * 64))
    monkeypatch.setattr(judging, "Observed", SimpleNamespace(of=lambda _: None))
    monkeypatch.setattr(judging, "residuals_of", lambda _: {})
    monkeypatch.setattr(
        judging, "document", lambda _, seed: record("one_effect", "vignetting") | dict.fromkeys(KEPT) | {"seed": seed}
    )
    by_seed = {}
    for seed in (1, 2):
        judge = Judge(folder, MODEL, nobody, nobody, Solver(None, seed))
        shared = Shared()
        records = [judge._verdict(one, shared, Chain()) for one in index.sets]
        by_seed[seed] = [one["seed"] for one in records]
        assert [one["priors"] for one in records] == [own] * 3
        assert [one["solver"]["seed"] for one in records] == [seed] * 3
        assert {one["code_sha256"] for one in records} == {code_sha256()}
    assert asked == [(6.5, seed) for seeds in by_seed.values() for seed in seeds]
    assert by_seed[1][0] == by_seed[1][1] == seed_of_light(1, "of-a")
    assert len({*by_seed[1], *by_seed[2]}) == 4


def test_priors_that_the_model_has_not_are_refused() -> None:
    """An index that somebody wrote into."""
    for path in ("environment.nothing", HALO):
        with pytest.raises(InputError, match=f"set-1: priors: got '{path}'"):
            Entry(id="set-1", light="a", priors={path: 0.5}).known_before(MODEL)
    with pytest.raises(
        InputError, match=rf"set-1: priors\.{SIGMA}: got 50.0, allowed: 1 to 15; blind\.json was changed"
    ):
        Entry(id="set-1", light="a", priors={SIGMA: 50.0}).known_before(MODEL)


def test_the_structure_of_a_further_set_is_that_of_the_first_sets_contrasts() -> None:
    """Other poses put other pixels into a ring; its variance and its null are of those of the first set."""
    solver, shared, known = Solver(None), Shared("a"), cast("Any", SimpleNamespace(specs=[]))
    grounds: list[Ground] = []
    for seed in (1, 2):
        observed = Observed(tuple(two_images(seed)), (), (), {})
        engine: Any = SharedDiagnosing(MODEL, observed, Spots(), known, solver, PATHS, shared=shared)
        grounds.append(engine.ground(engine.fitted(MODEL)))
    first, second = grounds
    assert second.null is first.null
    again = second.judged(second.fit.residual)
    assert (second.structure.statistic, second.structure.where) == (again.statistic, again.where)
