"""Gymnasium's environments over a door: its own checker finds nothing, another library's DQN runs on it."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from agent.gym import DesignEnv, VectorDesignEnv
from agent.moves import Space
from luxloop.design import Design
from luxloop.errors import RemoteError
from tests.objectives import BOUNDS, ENVIRONMENT, Controller

SPACE = Space(BOUNDS, ENVIRONMENT.distance_from, ENVIRONMENT.spacing_is)


def environment(controller: Controller | None = None, **options: object) -> DesignEnv:
    """An environment over a controller in process."""
    return DesignEnv(controller or Controller(), SPACE, run="gym", **options)  # type: ignore[arg-type]


@pytest.mark.parametrize("profile", ["paper", "fast"])
def test_gymnasiums_checker_is_content(profile: str) -> None:
    """check_env, with every warning an error."""
    env = environment(profile=profile)
    check_env(env, skip_render_check=True)
    assert env.action_space == gymnasium.spaces.Discrete({"paper": 10, "fast": 40}[profile])


def test_an_episode_is_truncated_at_its_length_and_never_terminated() -> None:
    """Five moves, then truncated; the design is never an end."""
    env = environment(episode=5)
    env.reset(seed=1)
    ends = [env.step(np.int64(i % 10))[2:4] for i in range(5)]
    assert ends == [(False, False)] * 4 + [(False, True)]


def test_reset_goes_where_it_is_told_and_a_move_outside_leads_nowhere() -> None:
    """At the upper corner +D is masked; taken all the same, the design stays and the info says why."""
    env = environment()
    _, info = env.reset(options={"design": BOUNDS.high})
    np.testing.assert_array_equal(info["design"], BOUNDS.high.as_vector())
    assert info["action_mask"][0] == 0
    state, reward, _, _, info = env.step(np.int64(0))
    np.testing.assert_array_equal(state, np.ones(5, np.float32))
    assert (reward, info["reason"]) == (0.0, "outside the bounds")


def test_a_failed_step_is_raised() -> None:
    """What could not be evaluated is no observation."""
    controller = Controller()
    controller.failing = {(0, 1)}
    env = environment(controller)
    env.reset(seed=0)
    with pytest.raises(RemoteError, match="told to fail"):
        env.step(np.int64(0))


def test_a_vector_is_its_lanes() -> None:
    """Three lanes at once give what three single environments give, lane by lane, across the end of an episode."""
    vector = VectorDesignEnv(Controller(), SPACE, run="gym", lanes=3, episode=4)
    single = [environment(episode=4, lane=lane) for lane in range(3)]
    starts = [Design.from_vector((100.0, 20.0 + 10 * i, 400.0, 20.0, 6.5)) for i in range(3)]
    try:
        vector.reset(seed=3)
        begun, _ = vector.reset(seed=3)
        assert begun.shape == (3, 5)
        same, _ = VectorDesignEnv(Controller(), SPACE, run="gym", lanes=3).reset(seed=3)
        np.testing.assert_array_equal(begun, same)
        vector.reset(options={"design": starts[0]})
        for env in single:
            env.reset(options={"design": starts[0]})
        for i in range(4):
            actions = np.array([i, i + 3, i + 6])
            states, rewards, terminated, truncated, infos = vector.step(actions)
            alone = [env.step(action) for env, action in zip(single, actions, strict=True)]
            np.testing.assert_array_equal(states, [it[0] for it in alone])
            np.testing.assert_array_equal(rewards, [it[1] for it in alone])
            np.testing.assert_array_equal(infos["uniformity"], [it[4]["uniformity"] for it in alone])
            assert not terminated.any()
            assert truncated.tolist() == [it[3] for it in alone]
        _, rewards, _, truncated, _ = vector.step(np.zeros(3, np.int64))  # begins the next episode in all lanes
        assert not truncated.any()
        assert not rewards.any()
    finally:
        vector.close()


def test_stable_baselines3s_dqn_runs_on_it() -> None:
    """600 steps of its DQN: it learns something (the weights move) and every observation lies in the space."""
    from stable_baselines3 import DQN

    model = DQN("MlpPolicy", environment(episode=20), learning_starts=100, seed=1, device="cpu")
    before = [parameter.detach().clone() for parameter in model.q_net.parameters()]
    model.learn(600)
    after = list(model.q_net.parameters())
    assert model.num_timesteps == 600
    assert any(not bool((a == b).all()) for a, b in zip(before, after, strict=True))
    assert np.abs(model.replay_buffer.observations[:600]).max() <= 1.0
