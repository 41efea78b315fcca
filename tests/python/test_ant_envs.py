"""Batches of Ants: what they see, that worlds do not see each other, resets, Gymnasium."""

from __future__ import annotations

import os

import numpy as np
import pytest

import novaphy

pytestmark = pytest.mark.skipif(not novaphy.has_io(), reason="built with NOVAPHY_WITH_IO=OFF")


def torques(seed: int, worlds: int, frames: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.uniform(-1.0, 1.0, (frames, worlds, 8)).astype(np.float32)


def test_a_world_of_a_batch_has_the_bits_of_one_alone():
    from novaphy.envs import AntWorlds

    many, one = AntWorlds(5, noise=0.1, seed=3), AntWorlds(1)
    one.set_state(many.q[3:4], many.qd[3:4])
    for a in torques(0, 5, 12):
        many.step(a)
        one.step(a[3:4])
    np.testing.assert_array_equal(many.q[3], one.q[0])
    np.testing.assert_array_equal(many.qd[3], one.qd[0])
    assert not np.array_equal(many.q[3], many.q[2])


def test_a_reset_of_some_worlds_leaves_the_others():
    from novaphy.envs import AntWorlds

    ants, same = AntWorlds(3), AntWorlds(3)
    for a in torques(1, 3, 10):
        ants.step(a)
        same.step(a)
    ants.reset([False, True, False])
    assert ants.frame.tolist() == [10, 0, 10]
    assert ants.q[1, 2] == np.float32(0.75) and np.all(ants.qd[1] == 0.0)
    a = torques(2, 3, 1)[0]
    ants.step(a)
    same.step(a)
    np.testing.assert_array_equal(ants.q[[0, 2]], same.q[[0, 2]])
    assert not np.array_equal(ants.q[1], same.q[1])


@pytest.mark.skipif(not novaphy.is_device_available("cuda:0"), reason="no CUDA device")
@pytest.mark.parametrize("substeps", [4, 5])
def test_worlds_on_a_device_have_the_bits_of_the_cpu(substeps):
    from novaphy.envs import AntWorlds

    pair = [AntWorlds(3, noise=0.1, seed=3, substeps=substeps, device=d) for d in ("cpu", "cuda:0")]
    for frame, a in enumerate(torques(5, 3, 12)):
        for ants in pair:
            if frame == 6:
                ants.vary(friction=[0.5, 0.6, 0.7], mass=1.1, slope=0.05)
            if frame == 9:
                ants.reset([True, False, True])
            ants.step(a, push=np.full((3, 3), 50.0) if frame == 3 else None)
        np.testing.assert_array_equal(pair[0].observations(), pair[1].observations())


@pytest.mark.parametrize(
    ("ant", "mass", "gear"), [("dva", 182.176, 200.0), ("gym", 0.91088, 150.0)]
)
def test_both_parameter_sets_have_the_masses_and_torques_of_their_files(ant, mass, gear):
    from novaphy.envs import AntWorlds

    ants = AntWorlds(2, ant=ant)
    assert ants.total_mass == pytest.approx(mass, rel=1e-4)
    forces = ants.joint_forces(np.tile(np.arange(8) / 8.0, (2, 1)))
    order = [2, 3, 4, 5, 6, 7, 0, 1] if ant == "gym" else range(8)
    np.testing.assert_allclose(forces[0, 6:], gear * np.array(order) / 8.0, rtol=1e-6)


def test_observations_are_in_the_order_and_the_axes_of_ant_v3():
    from novaphy.envs import AntWorlds

    ants = AntWorlds(1)
    q, qd = ants.q, np.arange(14, dtype=np.float32)[None] / 10.0
    half = np.sqrt(0.5)
    q[0, 3:7] = 0.0, 0.0, half, half  # a quarter turn about z
    ants.set_state(q, qd)
    seen = ants.observations()[0]
    assert seen[0] == q[0, 2] and np.all(seen[27:] == 0.0)
    np.testing.assert_allclose(seen[1:5], [half, 0.0, 0.0, half], atol=1e-6)
    np.testing.assert_array_equal(seen[5:13], q[0, 7:])
    np.testing.assert_array_equal(seen[13:16], qd[0, :3])
    np.testing.assert_allclose(seen[16:19], [qd[0, 4], -qd[0, 3], qd[0, 5]], atol=1e-6)
    np.testing.assert_array_equal(seen[19:27], qd[0, 6:])


def test_numbers_of_worlds_act():
    """A steep slope and little friction let an Ant slide; a light torso is thrown higher."""
    from novaphy.envs import AntWorlds

    ants = AntWorlds(3)
    ants.vary(friction=[0.75, 0.75, 0.2], slope=[0.0, 0.0, 0.2])
    for _ in range(40):
        ants.step(np.zeros((3, 8)))
    np.testing.assert_array_equal(ants.q[0], ants.q[1])
    assert abs(ants.q[0, 0]) < 1e-3 and ants.q[2, 0] < -0.2
    ants.reset()
    ants.vary(friction=0.75, slope=0.0, torso_mass=[1.0, 0.5, 1.0], gear=[1.0, 1.0, 0.0])
    for _ in range(30):
        ants.step(np.tile([0.0, 0.9, 0.0, -0.9, 0.0, -0.9, 0.0, 0.9], (3, 1)))
    assert ants.q[1, 2] != ants.q[0, 2] != ants.q[2, 2]


def test_bad_input_names_the_argument_and_leaves_the_worlds():
    from novaphy.envs import AntWorlds, check_meta

    ants = AntWorlds(2)
    before = ants.q
    cases = [
        (lambda: AntWorlds(1, ant="horse"), "ant: expected one of dva, gym"),
        (lambda: AntWorlds(0), "num_worlds: expected a number >= 1"),
        (lambda: ants.step(np.zeros((3, 8))), "actions: expected {2, 8}"),
        (lambda: ants.step(np.full((2, 8), np.nan)), "actions: expected finite numbers"),
        (lambda: ants.step(np.zeros((2, 8)), push=np.zeros((1, 3))), "push: expected {2, 3}"),
        (lambda: ants.set_state(np.full((2, 15), np.nan), np.zeros((2, 14))), "q: expected"),
        (lambda: ants.reset([True]), "worlds: expected {2}"),
        (lambda: ants.vary(colour=1.0), "vary: expected names of friction"),
        (lambda: ants.vary(friction=[1.0, 2.0, 3.0]), "friction: expected"),
        (
            lambda: ants.vary(slope=0.1, friction=-0.5),
            "friction: expected finite numbers from 0 to 1000, got",
        ),
        (
            lambda: ants.vary(torso_mass=[1.0, 0.0]),
            "torso_mass: expected finite numbers from 0.001 to 1000, got 0",
        ),
        (lambda: ants.vary(mass=1e20), "mass: expected finite numbers from 0.001 to 1000, got 1"),
        (lambda: ants.vary(gear=np.nan), "gear: expected finite numbers, got nan"),
        (lambda: check_meta("x.npz", {"ant": "gym"}, "dva"), "expected a policy of the Ant 'dva'"),
        (
            lambda: check_meta("x.npz", {"ant": "dva", "asset": "0123456789abcdef"}, "dva"),
            "x.npz: expected a policy of ant_heavy.xml with hash b15f0b97fa5317bc, got one of 0123",
        ),
    ]
    for call, message in cases:
        with pytest.raises(ValueError) as caught:
            call()
        assert message in str(caught.value)
    np.testing.assert_array_equal(ants.q, before)
    assert all(np.all(ants.varied[name] == AntWorlds(1).varied[name][0]) for name in ants.varied)


def test_the_environment_passes_the_checks_of_gymnasium():
    pytest.importorskip("gymnasium")
    from gymnasium.utils.env_checker import check_env

    from novaphy.envs import AntEnv

    env = AntEnv(randomize={"friction": (0.5, 1.2), "mass": (0.9, 1.1)}, substeps=10)
    check_env(env, skip_render_check=True)
    first, _ = env.reset(seed=4)
    second, _ = env.reset(seed=4)
    np.testing.assert_array_equal(first, second)
    for wrong in ({"colour": (0.0, 1.0)}, {"friction": 1.0}, {"mass": (1.2, 0.8)}):
        with pytest.raises(ValueError, match="randomize: expected"):
            AntEnv(randomize=wrong)
    with pytest.raises(
        ValueError, match="mass: expected finite numbers from 0.001 to 1000, got -1"
    ):
        AntEnv(randomize={"mass": (-1.0, 1.0)})


def test_the_old_name_of_an_argument_works_and_warns():
    pytest.importorskip("gymnasium")
    from novaphy.envs import AntEnv, AntVectorEnv

    friction = {"friction": (0.5, 1.2)}
    for make in (AntEnv, lambda **given: AntVectorEnv(2, **given)):
        with pytest.warns(DeprecationWarning, match="randomise is now called randomize"):
            old = make(randomise=friction)
        first, _ = old.reset(seed=4)
        np.testing.assert_array_equal(first, make(randomize=friction).reset(seed=4)[0])
        with pytest.raises(TypeError, match="expected randomize or its old name randomise"):
            make(randomise=friction, randomize=friction)


def test_the_vector_environment_separates_ends_and_begins_again_in_the_same_step():
    pytest.importorskip("gymnasium")
    from novaphy.envs import AntVectorEnv

    env = AntVectorEnv(3, episode=4, noise=0.0, substeps=20)
    env.reset(seed=1)
    q = env.ants.q
    q[1, 2] = 3.0  # too high: terminated
    env.ants.set_state(q, env.ants.qd)
    _, rewards, terminated, truncated, infos = env.step(np.zeros((3, 8), np.float32))
    assert terminated.tolist() == [False, True, False] and not truncated.any()
    assert infos["_final_obs"].tolist() == [False, True, False]
    assert infos["final_obs"][1, 0] > 2.0 and rewards[1] < rewards[0]
    for _ in range(3):
        seen, _, terminated, truncated, infos = env.step(np.zeros((3, 8), np.float32))
    assert truncated.tolist() == [True, False, True] and not terminated.any()
    assert seen[0, 0] == np.float32(0.75)


@pytest.mark.skipif(
    not os.environ.get("NOVAPHY_SLOW_TESTS"), reason="NOVAPHY_SLOW_TESTS is not set"
)
def test_the_algorithms_of_stable_baselines_train_on_it():
    sb3 = pytest.importorskip("stable_baselines3")
    from novaphy.envs import AntEnv

    for method in (sb3.PPO, sb3.SAC):
        method("MlpPolicy", AntEnv(substeps=10)).learn(5_000)
