"""The double DQN: its equations by hand, its schedule, and that seed and steps alone decide what it does."""

from __future__ import annotations

import copy
import subprocess
import sys
import time

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from agent.ask_tell import Checkpoint
from agent.ddqn import PRESETS, DoubleDqn, Learner, Learning, act, q_values, target_values
from agent.designers import designer, learning_of
from agent.moves import Profile, Space, key_of
from luxloop.design import Bounds, Design
from luxloop.errors import InputError
from luxloop.words import parse
from tests.agent.test_campaign import Door, found
from tests.agent.walking import PLANE, Function, Told, action_of, designs, drive
from tests.objectives import BOUNDS, ENVIRONMENT, Controller

SPACE = Space(BOUNDS, ENVIRONMENT.distance_from, ENVIRONMENT.spacing_is)


def fast(seed: int, lanes: int = 1, **changes: object) -> DoubleDqn:
    """The fast learner on the box of the objectives."""
    return DoubleDqn(SPACE, PRESETS["fast"].model_copy(update=changes), seed=seed, lanes=lanes)


def trail(told: Told) -> list[tuple[Design, str, float | None]]:
    """What must be the same in two runs: designs, hashes of the weights, losses."""
    return [(step.design, proposal.record.weights_sha256, proposal.record.loss) for proposal, step in told]


def test_one_net_chooses_and_the_other_values() -> None:
    """Two nets that disagree, by hand: theta prefers move 1, which theta' values at 3; neither alone says that."""
    ours, theirs = torch.tensor([[2.0, 7.0, 5.0]]), torch.tensor([[11.0, 3.0, 4.0]])
    reward, done, every = torch.tensor([[0.5]]), torch.tensor([[0.0]]), torch.tensor([[True, True, True]])
    assert target_values(reward, done, ours, theirs, every, 0.9).item() == pytest.approx(0.5 + 0.9 * 3.0)


def test_only_allowed_moves_are_chosen_and_an_end_ends_the_sum() -> None:
    """With move 1 forbidden theta falls back on move 2; where nothing is allowed the reward is all."""
    ours, theirs = torch.tensor([[2.0, 7.0, 5.0]]).repeat(2, 1), torch.tensor([[11.0, 3.0, 4.0]]).repeat(2, 1)
    reward, done = torch.tensor([[0.5], [0.5]]), torch.tensor([[0.0], [1.0]])
    allowed = torch.tensor([[True, False, True], [False, False, False]])
    assert target_values(reward, done, ours, theirs, allowed, 0.9).flatten().tolist() == pytest.approx([4.1, 0.5])


def test_an_update_takes_theta_for_the_choice_and_theta_dash_for_the_value() -> None:
    """Networks that are their last bias alone: r 0.5, gamma 0.9, Q 2 against y 3.2; Huber's loss of 1.2 is 0.7."""
    learner = Learner(Learning(batch=4), 3, seed=1)
    for weights, bias in ((learner.theta, [2.0, 7.0, 5.0]), (learner.target, [11.0, 3.0, 4.0])):
        for parameter in weights:
            parameter.data.zero_()
        weights[-1].data.copy_(torch.tensor(bias))
    learner.batch.reward[:], learner.batch.allowed[:] = 0.5, True
    learner.update()
    assert float(learner.loss or 0.0) == pytest.approx(0.7)


def test_numpy_chooses_by_the_values_of_torch() -> None:
    """The copy of the weights that chooses moves gives torch's Q."""
    learner, state = Learner(PRESETS["fast"], 40, seed=3), np.linspace(-1.0, 1.0, 5, dtype=np.float32)
    theirs = q_values(learner.theta, torch.from_numpy(state[None])).detach().numpy()[0]
    np.testing.assert_allclose(act(learner.weights(), state), theirs, rtol=1e-5, atol=1e-6)


def test_an_update_lowers_the_loss_and_the_target_follows_by_its_period() -> None:
    """On one minibatch with gamma 0 the loss falls a thousandfold; theta' changes every `target_period` only."""
    learner = Learner(Learning(gamma=0.0, target_period=300, batch=8), 10, seed=1)
    random = np.random.default_rng(1)
    learner.batch.state[:], learner.batch.reward[:] = random.uniform(-1, 1, (8, 5)), random.normal(size=(8, 1))
    learner.batch.allowed[:] = True
    begin, losses = learner.target[0].clone(), []
    for _ in range(299):
        learner.update()
        losses.append(float(learner.loss or 0.0))
    assert losses[-1] < 1e-3 * losses[0]
    assert torch.equal(learner.target[0], begin)
    learner.update()
    assert all(torch.equal(a, b) for a, b in zip(learner.target, learner.theta, strict=True))


def test_weights_move_as_by_the_class_of_torch(monkeypatch: pytest.MonkeyPatch) -> None:
    """Twenty updates of a minibatch leave the same bits as torch.optim.Adam, fused."""
    learner, random = Learner(Learning(batch=8, target_period=1000), 10, seed=1), np.random.default_rng(1)
    learner.batch.state[:], learner.batch.reward[:] = random.uniform(-1, 1, (8, 5)), random.normal(size=(8, 1))
    learner.batch.allowed[:] = True
    other = copy.deepcopy(learner)
    adam = torch.optim.Adam(other.theta, lr=other.learning.learning_rate, fused=True)
    monkeypatch.setattr(other.adam, "step", adam.step)
    for _ in range(20):
        learner.update()
        other.update()
        adam.zero_grad()
    assert all(torch.equal(a, b) for a, b in zip(learner.theta, other.theta, strict=True))
    for i, parameter in enumerate(other.theta):
        ours, theirs = learner.adam.memory(i), adam.state[parameter]
        assert ours.keys() == theirs.keys()
        assert all(torch.equal(ours[name], theirs[name]) for name in ours)


def test_a_learner_that_goes_back_to_its_beginning_remembers_nothing() -> None:
    """What was learnt is gone where no update is on record: the next one is the first one's."""
    learner = Learner(Learning(batch=4), 10, seed=1)
    learner.batch.reward[:], learner.batch.allowed[:] = 0.5, True
    begin = learner.state()
    assert not [name for name in begin if name.startswith("adam")]
    learner.update()
    first = learner.weights()
    learner.restore(begin, 0)
    learner.update()
    assert all(np.array_equal(a, b) for a, b in zip(first, learner.weights(), strict=True))


def test_learning_does_not_import_the_compiler() -> None:
    """Which would take longer than all else that a designer's process does at its start."""
    code = (
        "import sys\nfrom agent.ddqn import PRESETS, Learner\nlearner = Learner(PRESETS['fast'], 40, seed=1)\n"
        "learner.update()\nprint('torch' in sys.modules, 'torch._dynamo' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["True", "False"]


def test_epsilon_falls_evenly_and_stays() -> None:
    """Paper: 1 at first, halfway at a quarter of the budget, 0.05 from half of it on; random actions stay random."""
    paper = Learning(budget=1000)
    assert [paper.epsilon(n) for n in (0, 250, 500, 999)] == pytest.approx([1.0, 0.525, 0.05, 0.05])
    assert Learning(random_actions=True).epsilon(16_000) == 1.0


@pytest.mark.parametrize("profile", ["paper", "fast"])
def test_presets_are_the_recipes(profile: Profile) -> None:
    """The number of actions, rewards and restarts that the recipes name."""
    learning = PRESETS[profile]
    expected = {"paper": ("r1", "random", 50, 0.9, False), "fast": ("gain", "best", 10, 0.5, True)}
    found = (learning.reward, learning.restart, learning.episode, learning.gamma, learning.mask_known)
    assert found == expected[profile]


@settings(max_examples=8, derandomize=True, deadline=None)
@given(seed=st.integers(0, 10**6), lanes=st.integers(1, 3), name=st.sampled_from(["ddqn-paper", "ddqn-fast-random"]))
def test_no_step_leaves_the_box_or_cannot_be_built(seed: int, lanes: int, name: str) -> None:
    """Every proposal is a design in the bounds that can be built, and a fast one is new."""
    told = drive(designer(name, SPACE, seed=seed, lanes=lanes), Controller(), 60, lanes)
    assert all(step.feasible and not step.reason and BOUNDS.contains(step.design) for _, step in told)
    if name.startswith("ddqn-fast"):
        moved = [key_of(step.design) for proposal, step in told if proposal.move is not None]
        assert len(moved) == len(set(moved))


def test_the_seed_decides_everything() -> None:
    """Same seed: same designs, losses and hashes of the weights; another seed: others."""
    first, again, other = (trail(drive(fast(seed), Controller(), 90)) for seed in (7, 7, 8))
    assert first == again
    assert first[-1][1] != other[-1][1]
    assert [design for design, _, _ in first] != [design for design, _, _ in other]


def test_neither_delays_nor_the_time_of_learning_matter() -> None:
    """With pauses before each answer, and with `learn` called while it is awaited or never: the same trail."""

    class Slow(Controller):
        def act(self, action):  # type: ignore[no-untyped-def]  # as its base
            time.sleep(0.002 * (action.number * 7 % 3))
            return super().act(action)

    plain = trail(drive(fast(5, lanes=2), Controller(), 40, lanes=2))
    slow = trail(drive(fast(5, lanes=2), Slow(), 40, lanes=2, learn=True))
    assert plain == slow


@pytest.mark.parametrize("name", ["ddqn-paper", "ddqn-fast", "ddqn-fast-random"])
def test_a_restored_learner_goes_on_bit_for_bit(name: str) -> None:
    """Checkpointed with proposals under way, through bytes into a new designer: same designs, weights and losses."""
    learning = learning_of(name).model_copy(update={"target_period": 30, "episode": 7})
    first, second = (DoubleDqn(SPACE, learning, seed=2, lanes=2) for _ in range(2))
    controller = Controller()
    drive(first, controller, 50, lanes=2)
    asked = [first.ask(lane) for lane in range(2)]
    second.restore(Checkpoint.from_bytes(first.state().to_bytes()))
    assert [second.awaited(lane) for lane in range(2)] == asked
    trails = []
    for part, its_controller in ((first, controller), (second, copy.deepcopy(controller))):
        for lane, proposal in enumerate(asked):
            assert proposal is not None
            part.tell(lane, its_controller.act(action_of(proposal)))
        trails.append(trail(drive(part, its_controller, 60, lanes=2)))
    assert trails[0] == trails[1]


def test_failed_steps_are_not_learnt_from() -> None:
    """Nothing of a failed step enters memory or the known designs, and its lane begins a new episode at a design."""
    controller, learner = Controller(), fast(4)
    controller.failing = {(0, number) for number in range(5, 60, 6)}
    told = drive(learner, controller, 60)
    failed = [i for i, (_, step) in enumerate(told) if step.failure is not None]
    good_moves = sum(proposal.move is not None and step.failure is None for proposal, step in told)
    assert len(failed) == 10
    assert learner.memory.put_in == good_moves
    assert all(told[i + 1][0].design is not None for i in failed if i + 1 < len(told))
    assert set(learner.known.uniformity) == {key_of(step.design) for _, step in told if step.failure is None}


def test_episodes_begin_at_the_best_design() -> None:
    """In `fast` an episode begins where the best design so far is, told or already stood on."""
    learner, best = fast(9, patience=None), (0.0, None)
    for proposal, step in drive(learner, Controller(), 120):
        if proposal.design is not None and best[1] is not None:
            assert proposal.design == best[1]
        best = max(best, (step.uniformity, step.design), key=lambda pair: pair[0])


def test_after_its_patience_it_begins_elsewhere() -> None:
    """On a flat objective nothing ever gains: with patience 2 every third episode begins at a design never seen."""
    told = drive(fast(1, patience=2, random_actions=True), Function(lambda _: 50.0, BOUNDS), 200)
    seen: set[Design] = set()
    fresh = 0
    for proposal, step in told:
        fresh += proposal.design is not None and proposal.design not in seen
        seen.add(step.design)
    assert fresh >= 5


def test_a_box_of_one_design_ends_at_once() -> None:
    """Where no move leads anywhere the learner says so after the one design there is."""
    one = Bounds(low=BOUNDS.high, high=BOUNDS.high, step=BOUNDS.step)
    for name in ("ddqn-paper", "ddqn-fast"):
        learner = designer(name, Space(one), seed=0)
        assert len(drive(learner, Controller(bounds=one), 5)) == 1
        assert learner.finished


def test_learning_beats_its_ablation_on_a_hill() -> None:
    """Two variables, the paper's ten moves, random starts: the last 300 of 1,000 designs lie 5 points higher."""

    def hill(x: np.ndarray) -> float:
        return float(90.0 - 30.0 * (x[0] - 0.5) ** 2 - 30.0 * (x[2] + 0.25) ** 2)

    means = {}
    for random_actions in (False, True):
        learning = Learning(budget=1000, episode=20, gamma=0.8, reward="gain", random_actions=random_actions)
        runs = [drive(DoubleDqn(Space(PLANE), learning, seed=s), Function(hill, PLANE), 1000) for s in (1, 2)]
        means[random_actions] = [100.0 * np.mean([step.uniformity for _, step in told[-300:]]) for told in runs]
    assert min(means[False]) > max(means[True]) + 5.0


@pytest.mark.slow
def test_fast_comes_within_half_a_point_of_the_best_in_400_evaluations() -> None:
    """Objective A with 0.3 % noise, three seeds; the best known is 97.2 (a search of 200 ascents prints it)."""
    for seed in range(3):
        learner, controller = fast(seed), Controller(noise=0.003, seed=seed)
        told = drive(learner, controller, 440)
        assert learner.known.evaluations <= 440
        within = [controller.true_percent(design) for design in list(dict.fromkeys(designs(told)))[:400]]
        assert max(within) > 97.2 - 0.5


def test_hyper_parameters_out_of_range_are_named() -> None:
    """Unknown keys and values that cannot be are refused with their path."""
    for wrong in (
        {"batch": 33, "replay": 32},
        {"gamma": 1.0},
        {"episode": 0},
        {"profil": "fast"},
        {"learning_rate": float("nan")},
    ):
        with pytest.raises(InputError, match=next(iter(wrong))):
            parse(Learning, wrong)


def test_the_papers_target_network_is_never_copied_in_a_short_campaign() -> None:
    """As docs/campaigns.md says: about one update a design, and a copy every 500."""
    designer = found(Door(), "ddqn-paper", lanes=4, evaluations=200)[1].designer
    assert isinstance(designer, DoubleDqn)
    assert designer.learner is not None
    assert 150 < designer.learner.updates < designer.learning.target_period == 500
