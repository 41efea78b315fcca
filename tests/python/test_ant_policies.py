"""The demos of the Ant as a user starts them, the files they read, and their gradients."""

from __future__ import annotations

import io
import re
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

import novaphy

pytestmark = [
    pytest.mark.skipif(not novaphy.has_io(), reason="built with NOVAPHY_WITH_IO=OFF"),
    pytest.mark.skipif(not novaphy.has_diff(), reason="built with NOVAPHY_WITH_DIFF=OFF"),
]
DEMOS = Path(__file__).parents[2] / "python" / "demos" / "diff"
GAIT = "periodic_ant_natural_gait.npz"
POLICIES = DEMOS.parent / "data" / "ant" / "rl_policies"


def start(name: str, *flags: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, str(DEMOS / name), *flags], capture_output=True, text=True, timeout=300
    )


@pytest.fixture
def demos(monkeypatch):
    monkeypatch.syspath_prepend(str(DEMOS))


def walk(*flags: str) -> subprocess.CompletedProcess[str]:
    return start("demo_diffsim_ant_walk.py", *flags)


def test_the_trained_ant_walks():
    done = walk("--headless", "100")
    assert done.returncode == 0 and done.stdout.rstrip().endswith("ok"), done.stdout + done.stderr
    assert float(done.stdout.split("frames: ")[1].split(" m,")[0]) > 5.0


def test_tuning_changes_the_eight_biases_only_and_its_file_plays(tmp_path):
    path = str(tmp_path / "tuned.npz")
    done = walk("--train", "2", "--train-horizon", "8", "--save-policy", path, "--headless", "20")
    assert done.returncode == 0 and "frozen: contact creation" in done.stdout, done.stderr
    assert "friction tangents" in done.stdout
    with np.load(POLICIES / "ant_walker.npz") as before, np.load(path) as after:
        assert sorted(before.files) == sorted(after.files)
        same = [k for k in before.files if before[k].tobytes() == after[k].tobytes()]
        assert sorted(set(before.files) - set(same)) == ["meta", "mu.bias"]
        assert np.all(before["mu.bias"] != after["mu.bias"])
    done = walk("--policy", path, "--headless", "20")
    assert done.returncode == 0, done.stdout + done.stderr


def test_all_weights_are_tuned_by_the_exact_gradient_and_only_where_the_actor_looks(tmp_path):
    path = str(tmp_path / "all.npz")
    flags = ["--gradient", "exact", "--train-weights", "all", "--train-horizon", "2"]
    done = walk("--train", "1", *flags, "--save-policy", path, "--headless", "20")
    assert done.returncode == 0 and "observations across the refresh included" in done.stdout
    before, after = map(float, done.stdout.split(": loss ")[1].split("\n")[0].split(" -> "))
    assert after < before - 0.01, done.stdout
    with np.load(POLICIES / "ant_walker.npz") as old, np.load(path) as new:
        assert sorted(old.files) == sorted(new.files)
        for name in set(old.files) - {"meta"}:
            changed = old[name] != new[name]
            if name == "latent_pi.0.weight":  # entries 27 to 110 of an observation are 0
                assert not changed[:, 27:].any() and not new[name][:, 27:].any()
                changed = changed[:, :27]
            assert changed.mean() > 0.9, name


def throw(tuning) -> None:
    """Let the starts be in flight for two frames: nothing touches."""
    ants = tuning.worlds(tuning.starts_count, seed=3, noise=0.1)
    q, qd = ants.q, ants.qd
    q[:, 2] += 0.5
    qd[:, :3] += np.random.default_rng(0).normal(size=(len(q), 3))
    tuning.starts = q, qd
    tuning.last = np.tanh(tuning.means(ants.observations(), tuning.values))


@pytest.mark.parametrize("gradient", ["exact", "frozen"])
def test_the_gradient_by_all_weights_is_that_of_differences_in_random_directions(
    demos, monkeypatch, gradient
):
    flags = ("--train-weights", "all", "--train-horizon", "2", "--gradient", gradient)
    _, _, tuning = tuning_of(monkeypatch, *flags)
    throw(tuning)
    records = tuning.record(tuning.values)
    ways = tuning.directions()
    ad = ways @ tuning.gradient(tuning.values, records)
    eps = 2e-5  # a larger step switches units of the hidden layers on and off
    if gradient == "exact":
        assert tuning.label().startswith("exact of the code (100 of 100 steps are, 0 have contacts")
        losses = tuning.losses(tuning.values + eps * np.concatenate([ways, -ways]))
        ends = losses.reshape(2, -1)
    else:
        ends = [
            [tuning.replay(records, tuning.values + s * eps * way) for way in ways]
            for s in (1.0, -1.0)
        ]
    fd = np.subtract(*ends) / (2.0 * eps)
    assert np.abs(ad - fd).max() <= 1e-2 * np.abs(fd).max(), (ad, fd)


def test_terms_lead_from_the_frozen_gradient_to_the_exact_one(demos, monkeypatch):
    _, _, tuning = tuning_of(monkeypatch, "--train-horizon", "2")
    throw(tuning)
    found = {}
    for kind in ("frozen", "exact"):
        for terms in ((), ("observations",), ("dynamics",), ("dynamics", "observations")):
            tuning.kind, tuning.terms = kind, terms
            tuning.frames = tuning.make_frames(tuning.starts_count)
            found[kind, terms] = tuning.gradient(tuning.values)
    for seen in ((), ("observations",)):
        exact = found["exact", seen]
        # In flight "frozen" with "dynamics" lacks one small term: the rotation of a small rotation.
        off = [
            np.abs(found["frozen", (*more, *seen)] - exact).max() for more in ((), ("dynamics",))
        ]
        assert off[1] < 0.02 * np.abs(exact).max() < 0.08 * np.abs(exact).max() < off[0]


def test_flags_and_files_that_are_wrong_are_named(tmp_path):
    good = dict(np.load(POLICIES / "ant_walker.npz"))
    cases = {
        "shape": ({**good, "mu.bias": np.zeros(7, np.float32)}, "mu.bias: expected (8,), got (7,)"),
        "nan": ({**good, "mu.bias": np.full(8, np.nan, np.float32)}, "expected finite numbers"),
        "missing": ({k: v for k, v in good.items() if k != "mu.bias"}, "it misses mu.bias"),
        "pickle": ({**good, "mu.bias": np.array([{}])}, "without pickled"),
        "other": ({**good, "meta": np.array('{"ant": "gym"}')}, "a policy of the Ant 'dva'"),
    }
    for name, (arrays, message) in cases.items():
        path = tmp_path / f"{name}.npz"
        np.savez(path, **arrays)
        done = walk("--policy", str(path), "--headless", "1")
        assert done.returncode == 1 and message in done.stderr, (name, done.stderr)
    done = walk("--train", "1", "--train-horizon", "5000", "--headless", "0")
    assert done.returncode == 2 and "--train-horizon: expected 1 to 400" in done.stderr
    done = walk("--train", "1", "--segment", "0", "--headless", "0")
    assert done.returncode == 2 and "--segment: expected a number" in done.stderr
    done = walk("--train", "1", "--starts", "2001", "--headless", "0")
    assert done.returncode == 2 and "--starts: expected at most 2000" in done.stderr
    for flag, message in (("--policy", "no-such.npz"), ("--save-policy", "no-such/x.npz")):
        done = walk(flag, str(tmp_path / message), "--headless", "1")
        assert done.returncode != 0 and message in done.stderr and "Traceback" not in done.stderr


def tuning_of(monkeypatch, *flags: str):
    import demo_diffsim_ant_walk as demo

    monkeypatch.setattr(sys, "argv", ["demo", "--headless", "0", *flags])
    actor, _ = demo.load_actor(demo.POLICY, "dva")
    return demo, actor, demo.Tuning(actor, demo.arguments())


@pytest.mark.parametrize(
    ("frames", "segment", "terms"),
    [("2", "8", ()), ("5", "2", ()), ("2", "8", ("sticking", "dynamics"))],
)
def test_the_frozen_gradient_is_that_of_its_linearised_replay(
    demos, monkeypatch, frames, segment, terms
):
    flags = ("--train-horizon", frames, "--segment", segment)
    _, _, tuning = tuning_of(monkeypatch, *flags)
    tuning.terms = terms
    tuning.frames = tuning.make_frames(tuning.starts_count * tuning.segments())
    records = tuning.record(tuning.values)
    gradient = tuning.gradient(tuning.values, records)
    for k in range(8):
        step = 1e-4 * np.eye(8)[k]
        ends = [tuning.replay(records, tuning.values + s * step) for s in (1.0, -1.0)]
        assert gradient[k] == pytest.approx((ends[0] - ends[1]) / 2e-4, rel=1e-3, abs=1e-6)


@pytest.mark.parametrize(
    ("gradient", "frames", "least"), [("frozen", 1, 0.9), ("exact", 1, 0.99), ("exact", 4, 0.95)]
)
def test_gradients_point_where_differences_of_real_rollouts_do(
    demos, monkeypatch, gradient, frames, least
):
    """The median of five starts: a frozen gradient depends on the contacts of its start."""
    cosines = []
    for seed in range(1, 6):
        flags = ("--gradient", gradient, "--train-horizon", str(frames), "--seed", str(seed))
        _, _, tuning = tuning_of(monkeypatch, *flags)
        ad, ways = tuning.gradient(tuning.values), tuning.directions()
        moves = np.concatenate([ways, -ways])
        fd, finer = (
            np.subtract(*tuning.losses(tuning.values + e * moves).reshape(2, 8)) / (2.0 * e)
            for e in (3e-3, 1e-3)
        )
        # elsewhere the loss jumps between the points
        settled = np.abs(fd - finer) <= 0.2 * np.abs(fd).max()
        if settled.sum() >= 6:
            ad, fd = ad[settled], fd[settled]
            cosines.append(ad @ fd / (np.linalg.norm(ad) * np.linalg.norm(fd)))
    assert len(cosines) >= 3 and np.median(cosines) >= least, cosines


def test_segments_begin_where_the_rollout_of_the_actor_passes(demos, monkeypatch):
    _, _, tuning = tuning_of(monkeypatch, "--train-horizon", "6", "--segment", "2")
    q, qd, last, first = tuning.begin(tuning.values)
    assert len(q) == 3 * tuning.starts_count
    ants = tuning.worlds(tuning.starts_count)
    ants.set_state(*tuning.starts)
    for k in range(5):
        if k % 2 == 0:
            rows = slice(k // 2 * tuning.starts_count, (k // 2 + 1) * tuning.starts_count)
            np.testing.assert_array_equal(q[rows], ants.q)
            np.testing.assert_array_equal(qd[rows], ants.qd)
            np.testing.assert_array_equal(first[rows], tuning.starts[0])
        a = np.tanh(tuning.means(ants.observations(), tuning.values))
        ants.step(a)
        if k == 3:
            np.testing.assert_allclose(last[2 * tuning.starts_count :], a)


def test_an_ant_that_changed_walks_less_and_tuning_is_judged_on_its_whole_way(
    demos, monkeypatch, capsys
):
    flags = ("--adapt", "--train-horizon", "40", "--segment", "4")
    demo, actor, tuning = tuning_of(monkeypatch, *flags)
    changed = tuning.frames.ants
    assert np.all(changed.varied["friction"] == 0.5) and np.all(changed.varied["gear"][:, 0] == 0.7)
    assert changed.model.body_mass.numpy()[0] == pytest.approx(1.2 * 96.776, rel=1e-4)
    before, after, kept = tuning.train()
    assert after < before if kept else after == before
    moved = tuning.values != actor["mu.bias"].numpy()
    assert kept == moved.any()
    monkeypatch.setattr(demo, "HELD_OUT", (778,))
    monkeypatch.setattr(demo, "HELD_OUT_FRAMES", 20)
    demo.report_adaptation(actor, actor, tuning, demo.arguments())
    told = capsys.readouterr().out
    assert told.count(" tuned: 0% of the loss is back") + told.count(" tuned: -0% of") == 2, told
    for line in told.splitlines()[1:]:
        nominal, lost, same = (
            float(x.split()[0]) for x in re.split(r"(?:: |, )(?=-?\d)", line)[1:4]
        )
        assert nominal != lost and lost == same, line


def test_exact_derivatives_of_a_frame_point_where_differences_of_the_solver_do(demos):
    from ant_gradients import frame_jacobians, make_frames

    from novaphy.envs import AntWorlds

    rng = np.random.default_rng(1)
    base = AntWorlds(3)
    for _ in range(12):
        base.step(rng.uniform(-0.5, 0.5, (3, 8)))
    q, qd, a = base.q, base.qd, rng.uniform(-0.5, 0.5, (3, 8))
    eps, columns = 2e-3, []
    for k in range(8):
        ends = []
        for sign in (1.0, -1.0):
            base.set_state(q, qd)
            base.step(a + sign * eps * np.eye(8)[k])
            ends.append(np.concatenate([base.q[:, 7:], base.qd[:, 6:]], axis=1).astype(float))
        columns.append((ends[0] - ends[1]) / (2.0 * eps))
    fd = np.stack(columns, axis=-1)
    rows = [*range(6, 14), *range(20, 28)]
    _, by_action = frame_jacobians(make_frames(AntWorlds(3), "exact"), q, qd, a)
    ad = by_action[:, rows]
    for world in range(3):
        cosine = (ad[world] * fd[world]).sum()
        cosine /= np.linalg.norm(ad[world]) * np.linalg.norm(fd[world])
        assert cosine > 0.97, (world, cosine)


def test_an_actor_of_stable_baselines_gives_its_actions(tmp_path, demos):
    torch = pytest.importorskip("torch")
    from ant_common import act, actor_shapes, load_actor

    torch.manual_seed(0)
    state = {f"actor.{k}": 0.1 * torch.randn(*shape) for k, shape in actor_shapes().items()}
    torch.save(state, tmp_path / "policy.pth")
    path = tmp_path / "sac.zip"
    with zipfile.ZipFile(path, "w") as archive:
        archive.write(tmp_path / "policy.pth", "policy.pth")
    done = start("convert_sb3_ant.py", str(path), str(tmp_path / "sac.npz"))
    assert done.returncode == 0, done.stderr
    actor, meta = load_actor(tmp_path / "sac.npz", "gym")
    assert meta["ant"] == "gym"
    x = torch.randn(5, 111)
    layer = torch.nn.functional.linear
    h = torch.relu(layer(x, state["actor.latent_pi.0.weight"], state["actor.latent_pi.0.bias"]))
    h = torch.relu(layer(h, state["actor.latent_pi.2.weight"], state["actor.latent_pi.2.bias"]))
    expected = torch.tanh(layer(h, state["actor.mu.weight"], state["actor.mu.bias"])).numpy()
    np.testing.assert_allclose(act(actor, x.numpy()), expected, atol=1e-5)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("policy.pth", b"cos\nsystem\n(S'true'\ntR.")
    done = start("convert_sb3_ant.py", str(path), str(tmp_path / "bad.npz"))
    assert done.returncode == 1 and "expected tensors only" in done.stderr


def test_training_writes_the_same_file_from_the_same_seed(tmp_path):
    flags = [
        "--worlds",
        "8",
        "--frames",
        "4",
        "--minibatch",
        "16",
        "--epochs",
        "1",
        "--steps",
        "64",
    ]
    files = []
    for name in ("a", "b"):
        folder = tmp_path / name
        folder.mkdir()
        out = str(folder / "walker.npz")
        done = start("train_ant_ppo.py", *flags, "--evaluate", "0", "--out", out)
        assert done.returncode == 0, done.stderr
        files.append(dict(np.load(out)))
    for key in files[0]:
        if key != "meta":
            np.testing.assert_array_equal(files[0][key], files[1][key])
    assert np.all(files[0]["latent_pi.0.weight"][:, 27:] == 0.0)


def scratch(*flags: str) -> subprocess.CompletedProcess[str]:
    return start("demo_diffsim_ant_from_scratch.py", *flags)


@pytest.mark.slow
@pytest.mark.parametrize("gradient", ["frozen", "exact"])
def test_an_ant_learns_from_zero_and_its_file_plays(tmp_path, gradient):
    path = str(tmp_path / "led.npz")
    flags = ["--stages", "24", "--gradient", gradient, "--repeat", "0.5"]
    done = scratch(*flags, "--headless", "20", "--out", path)
    assert done.returncode == 0, done.stdout + done.stderr
    told = next(line for line in done.stdout.splitlines() if line.startswith("stage 24"))
    before, after = map(float, told.split("loss ")[1].split(",")[0].split(" -> "))
    assert after < 0.9 * before, told
    if gradient == "frozen":
        first = Path(path).read_bytes()
        scratch(*flags, "--headless", "0", "--out", path)
        with np.load(path) as now, np.load(io.BytesIO(first)) as before:
            assert now["weights"].tobytes() == before["weights"].tobytes()
    again = scratch("--load", path, "--headless", "20")
    assert again.returncode == 0, again.stderr
    assert (
        again.stdout.splitlines()[-1].split("frames, ")[1]
        == (done.stdout.splitlines()[-1].split("frames, ")[1])
    )


def test_files_of_the_first_actor_that_are_wrong_are_named(tmp_path):
    path = tmp_path / "bad.npz"
    np.savez(path, weights=np.zeros((8, 9), np.float32), meta=np.array('{"ant": "dva"}'))
    done = scratch("--load", str(path), "--headless", "1")
    assert done.returncode == 1 and "weights: expected (8, 10), got (8, 9)" in done.stderr
    np.savez(path, weights=np.zeros((8, 10), np.float32), meta=np.array('{"ant": "dva"}'))
    done = scratch("--load", str(path), "--headless", "1")
    assert done.returncode == 1 and "expected features" in done.stderr
    features = np.array('{"ant": "dva", "features": 5, "period": 14}')
    np.savez(path, weights=np.zeros((8, 10), np.float32), meta=features)
    done = scratch("--load", str(path), "--headless", "1")
    assert done.returncode == 1 and "expected features" in done.stderr
    np.savez(path, weights=np.full((8, 10), np.nan, np.float32), meta=np.array('{"ant": "dva"}'))
    done = scratch("--load", str(path), "--headless", "1")
    assert done.returncode == 1 and "weights: expected finite numbers" in done.stderr
    np.savez(path, weights=np.array([{}]), meta=np.array('{"ant": "dva"}'))
    done = scratch("--load", str(path), "--headless", "1")
    assert done.returncode == 1 and "without pickled" in done.stderr
    np.savez(path, meta=np.array('{"ant": "dva"}'))
    done = scratch("--load", str(path), "--headless", "1")
    assert done.returncode == 1 and "it misses weights" in done.stderr
    done = scratch("--load", str(POLICIES / GAIT), "--ant", "gym", "--headless", "1")
    assert done.returncode == 1 and "expected a policy of the Ant 'gym'" in done.stderr
    for flags, message in (
        (("--robustness", "4"), "--robustness: expected"),
        (("--variants", "-1"), "--variants: expected"),
    ):
        done = scratch("--load", str(POLICIES / GAIT), *flags)
        assert done.returncode == 2 and message in done.stderr, done.stderr
    for flags, message in (
        (("--repeat", "nan"), "--repeat: expected a number > 0"),
        (("--seconds", "-1"), "--seconds: expected a number > 0"),
        (("--out", str(path.parent / "none" / "x.npz")), "--out: the folder of"),
    ):
        done = scratch(*flags, "--headless", "1")
        assert done.returncode == 2 and message in done.stderr, done.stderr
    done = scratch("--stages", "run", "--headless", "1")
    assert done.returncode == 2 and "--stages: expected names of stand" in done.stderr


@pytest.mark.parametrize("trot", [1.0, 0.0])
def test_the_loss_of_the_first_actor_has_the_derivatives_that_it_says(demos, trot):
    import demo_diffsim_ant_from_scratch as demo

    rng = np.random.default_rng(5)
    q = rng.normal(size=(1, 15))
    q[:, 3:7] /= np.linalg.norm(q[:, 3:7])
    qd, a = rng.normal(size=(1, 14)), rng.uniform(-1.0, 1.0, (1, 8))
    frame = np.array([3])

    def loss(q, qd, a):
        return demo.residuals(q, qd, a, 0.0 * a, frame, trot=trot)

    _, by_state, by_action = loss(q, qd, a)
    actor = demo.Actor()
    by_feature = actor.feature_jacobian(q)
    from demo_diffsim_ant_walk import moved

    for k in range(28):
        e = 1e-5 * np.eye(28)[k][None]
        ends = [loss(moved(q, s * e[:, :14]), qd + s * e[:, 14:], a)[0] for s in (1.0, -1.0)]
        # The slip's derivatives are with respect to rates only. The dependence on poses is left
        # out.
        rows = np.arange(40) if k >= 14 else np.delete(np.arange(40), np.s_[30:38])
        fd = (ends[0] - ends[1]) / 2e-5
        np.testing.assert_allclose(fd[:, rows], by_state[:, rows, k], atol=1e-5)
        seen = [
            actor.features(moved(q, s * e[:, :14]), qd + s * e[:, 14:], frame) for s in (1.0, -1.0)
        ]
        np.testing.assert_allclose((seen[0] - seen[1]) / 2e-5, by_feature[..., k], atol=1e-6)
    for k in range(8):
        e = 1e-5 * np.eye(8)[k][None]
        ends = [loss(q, qd, a + s * e)[0] for s in (1.0, -1.0)]
        np.testing.assert_allclose((ends[0] - ends[1]) / 2e-5, by_action[:, :, k], atol=1e-6)


def test_who_stands_has_the_stance_of_the_trot(demos):
    from ant_objective import PERIOD, reference, residuals

    frames = np.arange(2 * PERIOD) / 2.0
    pose, rate = reference(frames, 0.0)
    np.testing.assert_array_equal(pose, np.broadcast_to(pose[0], pose.shape))
    np.testing.assert_array_equal(rate, 0.0 * rate)
    assert np.abs(reference(frames)[0] - pose).max() > 0.1
    # At rest on its feet in this pose, all residuals are 0 except those of the contacts' slip.
    q = np.zeros((1, 15))
    q[:, 2], q[:, 6], q[:, 7:] = 0.65, 1.0, pose[0]
    r, _, _ = residuals(q, np.zeros((1, 14)), *np.zeros((2, 1, 8)), np.array([5]), trot=0.0)
    np.testing.assert_allclose(np.delete(r, np.s_[14:18]), 0.0, atol=1e-12)


def test_the_loss_of_the_first_actor_sees_the_feet_where_they_are(demos):
    from ant_objective import foot_motion

    from novaphy.envs import AntWorlds, feet

    ants, rng = AntWorlds(3), np.random.default_rng(0)
    for _ in range(10):
        ants.step(rng.uniform(-0.6, 0.6, (3, 8)))
    _, height, speed = feet(ants.state, 3)
    found = foot_motion(ants.q.astype(float), ants.qd.astype(float))
    np.testing.assert_allclose(found[0], height, atol=1e-4)
    np.testing.assert_allclose(found[2], speed[..., :2], atol=1e-3)
    assert np.abs(speed).max() > 0.5


def test_worlds_that_differ_are_drawn_from_their_seeds(demos):
    from ant_robustness import FRICTION, IMPULSE, MASS, SLOPE, Disturbances

    from novaphy.envs import AntWorlds

    ants, one = AntWorlds(40), AntWorlds(1)
    many, alone = Disturbances(ants, np.arange(40)), Disturbances(one, [7])
    for name, rows in many.changes.items():
        assert rows[7] == alone.changes[name][0]
        np.testing.assert_array_equal(ants.varied[name], np.float32(rows))
    for name, (low, high) in (("friction", FRICTION), ("mass", MASS)):
        assert low <= many.changes[name].min() < low + 0.1 * (high - low)
        assert high >= many.changes[name].max() > high - 0.1 * (high - low)
    gravity = ants.model.gravity.numpy().reshape(-1, 3)
    np.testing.assert_allclose(np.arccos(-gravity[:, 2] / 9.81), np.radians(SLOPE), atol=2e-3)
    pushes = np.stack([many.push(k) for k in range(600)])
    np.testing.assert_array_equal(pushes[:, 7], [alone.push(k)[0] for k in range(600)])
    sizes = np.linalg.norm(pushes, axis=2)
    assert np.all((sizes > 0).sum(axis=0) == 10) and np.all(pushes[..., 2] == 0.0)
    np.testing.assert_allclose(sizes[sizes > 0] / 20.0, IMPULSE, rtol=1e-5)
    assert np.abs(pushes.sum(axis=(0, 1))).max() < 0.2 * sizes.sum()


def test_training_in_worlds_that_differ_takes_the_mean_of_their_losses(demos):
    import demo_diffsim_ant_from_scratch as demo

    actor = demo.load(str(demo.GAIT), "dva")
    weights = np.stack([actor.weights, 0.9 * actor.weights])
    both = demo.Trainer(actor, "frozen", "dva", candidates=2, variants=2)
    first = demo.Trainer(actor, "frozen", "dva", candidates=2, variants=1)
    losses, kept = both.rollouts(weights, 12)
    of_first, alone = first.rollouts(weights, 12)
    np.testing.assert_array_equal(kept[0][:, :, 0], alone[0][:, :, 0])
    assert kept[0].shape == (12, 2, 2, 15) and np.any(kept[0][:, :, 0] != kept[0][:, :, 1])
    first.disturbed = demo.Disturbances(first.search, [demo.TRAINED_ON + 1] * 2)
    of_second, _ = first.rollouts(weights, 12)
    np.testing.assert_allclose(losses, 0.5 * (of_first + of_second), rtol=1e-6)
    q, qd, a = (x[:, 0] for x in kept)
    for (g, matrix), (other, _) in zip(
        both.gradients(q[:, 0], qd[:, 0], a[:, 0], 0),
        both.gradients(q[:, 1], qd[:, 1], a[:, 1], 1),
        strict=True,
    ):
        assert np.abs(g - other).max() > 1e-3 * np.abs(g).max()
        np.testing.assert_allclose(matrix, matrix.T, atol=1e-6 * np.abs(matrix).max())


def told_of(path: Path) -> tuple[subprocess.CompletedProcess[str], list[str], float]:
    done = scratch("--load", str(path), "--headless", "600")
    told = done.stdout.splitlines()
    return done, told, float(told[-1].split("frames, ")[1].split(" m,")[0])


def test_the_last_stage_finds_what_nothing_lacks(demos):
    """On a gait whose slip is the distance of the weights from some that are known."""
    from ant_polish import CANDIDATES, FLOORS, excess, polish

    rng = np.random.default_rng(4)
    good = 0.05 * rng.normal(size=(8, 10))

    def gait(weights: np.ndarray) -> dict[str, np.ndarray]:
        n = len(weights) * len(FLOORS)
        off = np.repeat(np.linalg.norm(weights - good, axis=(1, 2)), len(FLOORS))
        like = {"tilt": 2.0, "drift": 0.1, "distance": 3.0, "clearance": 0.05, "lowest": 0.0}
        return {
            **{name: np.full(n, value) for name, value in like.items()},
            "slip": off, "excess": np.full(n, -0.1), "touchdowns": np.ones((n, 4)),
            "upright": np.ones(n, bool),
        }  # fmt: skip

    zero = np.zeros((8, 10))
    first = excess(gait(zero[None]), 1.3)
    assert first.shape == (len(FLOORS),) and np.all(first > 0.2)
    found, lacks = polish(gait, zero, 1.3, 1, 400)
    assert lacks[-1] == 0.0 and len(lacks) < 400
    assert np.linalg.norm(found - good) <= 0.12
    again, _ = polish(gait, zero, 1.3, 1, 400)
    np.testing.assert_array_equal(found, again)
    np.testing.assert_array_equal(found, np.float32(found))
    broken = gait(np.zeros((CANDIDATES, 8, 10)))
    broken["upright"][3] = False
    broken["slip"][4] = np.nan
    lack = excess(broken, 1.3)
    assert lack[3] > 20.0 and lack[4] == 1e3


def test_the_ant_that_learned_from_zero_walks_for_half_a_minute():
    done, told, way = told_of(POLICIES / GAIT)
    assert done.returncode == 0 and told[-1].endswith("ok"), done.stdout
    assert sum(line.startswith("  reached: ") for line in told) == 11, done.stdout
    assert way > 6.0


def test_the_ant_that_sees_its_heading_withstands_pushes_slopes_and_other_floors(demos):
    import demo_diffsim_ant_from_scratch as demo

    done, told, way = told_of(POLICIES / "periodic_ant_heading.npz")
    assert way > 4.0 and any(line.startswith("  reached: upright") for line in told), done.stdout
    actor, ants = (
        demo.load(str(POLICIES / "periodic_ant_heading.npz"), "dva"),
        demo.make_worlds(20, "dva"),
    )
    push = demo.Disturbances(ants, np.arange(20)).push
    assert demo.validate(actor, ants, range(600), push=push)["upright"].mean() >= 0.95
