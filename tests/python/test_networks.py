"""Layers, activations, densities, random numbers and files of parameters."""

from __future__ import annotations

import math
import os
import subprocess
import sys

import numpy as np
import pytest

import novaphy

nova = pytest.importorskip("novaphy.nova")

EDGES = [
    0.0,
    -0.0,
    1e-8,
    -1e-8,
    0.5,
    -0.5,
    3.0,
    -3.0,
    17.0,
    -17.0,
    88.0,
    -88.0,
    104.0,
    -104.0,
    1e30,
]


def f32(values: object) -> np.ndarray:
    """As float32."""
    return np.asarray(values, np.float32)


def test_softplus_and_relu_are_what_they_should_be():
    rng = np.random.default_rng(0)
    x = f32(np.concatenate([EDGES, rng.normal(size=500) * 10.0, rng.normal(size=500) * 0.1]))
    exact = np.logaddexp(0.0, x.astype(np.float64))
    got = nova.softplus(nova.tensor(x)).numpy().astype(np.float64)
    ulp = np.spacing(f32(np.maximum(exact, 1e-44))).astype(np.float64)
    assert np.max(np.abs(got - exact) / ulp) < 4.0
    np.testing.assert_array_equal(nova.relu(nova.tensor(x)).numpy(), np.maximum(x, 0.0))
    for value in (np.inf, -np.inf, np.nan):
        got = nova.softplus(nova.tensor([value])).item()
        assert math.isnan(got) if math.isnan(value) else got == max(value, 0.0)


def test_their_gradients_are_exact():
    x = nova.tensor(f32(EDGES), requires_grad=True)
    with nova.Tape() as tape:
        tape.backward(nova.softplus(x), nova.ones((len(EDGES),)))
    exact = 1.0 / (1.0 + np.exp(-np.clip(np.array(EDGES), -700, 700)))
    np.testing.assert_allclose(x.grad.numpy(), exact, rtol=5e-7, atol=1e-44)
    y = nova.tensor(f32(EDGES), requires_grad=True)
    with nova.Tape() as tape:
        tape.backward(nova.relu(y), nova.ones((len(EDGES),)))
    np.testing.assert_array_equal(y.grad.numpy(), f32(np.array(EDGES) > 0.0))


def test_they_may_stand_in_kernels():
    kernel = nova.make_indexed_kernel(
        "ramps", [("x", nova.float32)], 2, lambda c: [nova.softplus(c.f32(0)), nova.relu(c.f32(0))]
    )
    x = nova.tensor(f32(EDGES))
    out = kernel(len(EDGES), [x])[0].numpy()
    np.testing.assert_array_equal(out[:, 0], nova.softplus(x).numpy())
    np.testing.assert_array_equal(out[:, 1], nova.relu(x).numpy())


@pytest.mark.parametrize("rows", [None, 1, 7])
def test_a_layer_is_the_product_with_the_transposed_weights(rows: int | None):
    rng = np.random.default_rng(1)
    x = f32(rng.normal(size=(5,) if rows is None else (rows, 5)))
    weight, bias = f32(rng.normal(size=(3, 5))), f32(rng.normal(size=3))
    inputs = [nova.tensor(v, requires_grad=True) for v in (x, weight, bias)]
    with nova.Tape() as tape:
        y = nova.linear(*inputs)
    np.testing.assert_allclose(y.numpy(), x @ weight.T + bias, rtol=1e-5, atol=1e-6)
    # The sums are matmul's, to the bit.
    by_matmul = nova.matmul(nova.tensor(x), nova.tensor(np.ascontiguousarray(weight.T)))
    np.testing.assert_array_equal(y.numpy(), (by_matmul + nova.tensor(bias)).numpy())
    seed = f32(rng.normal(size=y.shape))
    tape.backward(y, nova.tensor(seed))
    g = np.atleast_2d(seed)
    np.testing.assert_allclose(inputs[0].grad.numpy(), seed @ weight, rtol=1e-5, atol=1e-6)
    by_weight = g.T @ np.atleast_2d(x)
    np.testing.assert_allclose(inputs[1].grad.numpy(), by_weight, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(inputs[2].grad.numpy(), g.sum(0), rtol=1e-5, atol=1e-6)
    tangents = [nova.tensor(f32(rng.normal(size=v.shape))) for v in inputs]
    (along,) = tape.jvp([y], inputs, tangents)
    left = float(np.sum(along.numpy() * seed))
    right = sum(
        float(np.sum(v.grad.numpy() * t.numpy())) for v, t in zip(inputs, tangents, strict=True)
    )
    assert left == pytest.approx(right, rel=1e-5)


def serial_product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """In float32, every entry's products added one after the other."""
    total = np.zeros((a.shape[0], b.shape[1]), np.float32)
    for k in range(a.shape[1]):
        total = total + a[:, k : k + 1] * b[k]
    return total


@pytest.mark.parametrize("threads", [1, 3])
@pytest.mark.parametrize(
    "sizes", [(1, 1, 1), (1, 5, 33), (6, 32, 32), (7, 3, 31), (25, 70, 65), (300, 17, 48)]
)
def test_products_and_their_gradients_add_in_the_order_of_the_shared_index(
    sizes: tuple[int, int, int], threads: int
):
    n, k, m = sizes
    rng = np.random.default_rng(n)
    x, w, seed = (f32(rng.normal(size=s)) for s in ((n, k), (m, k), (n, m)))
    before = novaphy.num_threads()
    novaphy.set_num_threads(threads)
    try:
        a, b, c, d = (nova.tensor(v, requires_grad=True) for v in (x, w, x, f32(w.T)))
        with nova.Tape() as tape:
            layer, product = nova.linear(a, b), nova.matmul(c, d)
        tape.backward(layer, nova.tensor(seed))
        tape.backward(product, nova.tensor(seed))
        with nova.ScopedCapture() as capture:
            replayed = nova.linear(nova.tensor(x), nova.tensor(w))
        capture.graph.launch()
    finally:
        novaphy.set_num_threads(before)
    expected = serial_product(x, w.T)
    for got in (layer, product, replayed):
        np.testing.assert_array_equal(got.numpy(), expected)
    for left in (a, c):
        np.testing.assert_array_equal(left.grad.numpy(), serial_product(seed, w))
    np.testing.assert_array_equal(b.grad.numpy(), serial_product(seed.T, x))
    np.testing.assert_array_equal(d.grad.numpy(), serial_product(x.T, seed))


def test_wrong_layers_are_named():
    x = nova.zeros((4, 5))
    with pytest.raises(ValueError, match=r"linear, weight: expected \{m, 5\}.*got \{3, 4\}"):
        nova.linear(x, nova.zeros((3, 4)))
    with pytest.raises(ValueError, match=r"linear, bias: expected \{3\}, got \{4\}"):
        nova.linear(x, nova.zeros((3, 5)), nova.zeros((4,)))


def test_a_network_learns_with_adam():
    rng = np.random.default_rng(2)
    x = f32(rng.uniform(-1, 1, size=(64, 2)))
    y = nova.tensor(f32(np.sin(3 * x[:, :1]) * x[:, 1:]))
    sizes = [(16, 2), (16, 16), (1, 16)]
    weights = [
        nova.tensor(f32(rng.normal(size=s) / np.sqrt(s[1])), requires_grad=True) for s in sizes
    ]
    biases = [nova.zeros((s[0],), requires_grad=True) for s in sizes]
    adam = nova.optim.Adam([*weights, *biases], lr=1e-2)
    losses = []
    for _ in range(500):
        with nova.Tape() as tape:
            h = nova.tensor(x)
            for k in range(2):
                h = nova.softplus(nova.linear(h, weights[k], biases[k]))
            error = nova.linear(h, weights[2], biases[2]) - y
            loss = nova.mean(error * error)
            tape.backward(loss)
        adam.step()
        adam.zero_grad()
        losses.append(loss.item())
    assert losses[-1] < 0.05 * losses[0]


def reference_density(u, mean, log_std, squashed):
    """In double precision."""
    u, mean, log_std = (np.asarray(v, np.float64) for v in (u, mean, log_std))
    terms = -0.5 * ((u - mean) / np.exp(log_std)) ** 2 - log_std - 0.5 * np.log(2 * np.pi)
    if squashed:
        terms = terms - np.log1p(-(np.tanh(u) ** 2))
    return terms.sum(axis=1)


@pytest.mark.parametrize("squashed", [True, False])
def test_the_density_of_a_policy(squashed: bool):
    rng = np.random.default_rng(3)
    u, mean = f32(rng.normal(size=(9, 4)) * 1.5), f32(rng.normal(size=(9, 4)))
    log_std = f32(rng.normal(size=4) * 0.3)
    inputs = [nova.tensor(v, requires_grad=True) for v in (u, mean, log_std)]
    with nova.Tape() as tape:
        density = nova.gaussian_log_density(*inputs, squashed=squashed)
    assert density.shape == (9,)
    expected = reference_density(u, mean, log_std, squashed)
    np.testing.assert_allclose(density.numpy(), expected, rtol=2e-5, atol=2e-5)
    seed = rng.normal(size=9)
    tape.backward(density, nova.tensor(f32(seed)))
    for k, tensor in enumerate(inputs):
        values = [v.astype(np.float64) for v in (u, mean, log_std)]
        for index in np.ndindex(values[k].shape):
            ends = []
            for sign in (1e-5, -1e-5):
                moved = [v.copy() for v in values]
                moved[k][index] += sign
                ends.append(seed @ reference_density(*moved, squashed))
            fd = (ends[0] - ends[1]) / 2e-5
            assert tensor.grad.numpy()[index] == pytest.approx(fd, rel=1e-4, abs=1e-4)


def test_the_density_of_a_saturated_action_is_finite():
    # log(1 - tanh(20)^2) = -38.6. A direct evaluation in float32 would give -inf.
    u = nova.tensor([[20.0]])
    got = nova.gaussian_log_density(u, nova.tensor([[20.0]]), nova.tensor([0.0])).item()
    assert got == pytest.approx(-0.9189385 + 2.0 * (20.0 - math.log(2.0)), rel=1e-6)
    with pytest.raises(ValueError, match="log_std"):
        nova.gaussian_log_density(u, u, nova.zeros((3,)))


# The known answers of Random123: counter and key of zeros, of ones, and of the digits of pi.
KNOWN = [
    ([0] * 4, [0] * 2, [0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8]),
    ([0xFFFFFFFF] * 4, [0xFFFFFFFF] * 2, [0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD]),
    (
        [0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344],
        [0xA4093822, 0x299F31D0],
        [0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1],
    ),
]


@pytest.mark.parametrize(("counter", "key", "words"), KNOWN)
def test_philox_gives_its_known_answers(counter: list, key: list, words: list):
    assert list(nova.philox4x32(counter, key)) == words


def fractions(worlds: int, width: int, seed: int, step: int, stream: int) -> np.ndarray:
    """What random_uniform should give, word by word."""
    rows = np.zeros((worlds, width))
    for w in range(worlds):
        for j in range(width):
            words = nova.philox4x32([j // 4, w, step, stream], [seed & 0xFFFFFFFF, seed >> 32])
            rows[w, j] = (words[j % 4] >> 8) * 2.0**-24
    return rows


def test_random_numbers_are_of_their_place():
    seed = 0x123456789ABCDEF0
    got = nova.random_uniform((5, 11), seed=seed, step=7, stream=3)
    np.testing.assert_array_equal(got.numpy(), f32(fractions(5, 11, seed, 7, 3)))
    # A world has the same numbers however many there are.
    more = nova.random_uniform((9, 11), seed=seed, step=7, stream=3)
    np.testing.assert_array_equal(more.numpy()[:5], got.numpy())
    for other in ({"step": 8}, {"stream": 4}, {"seed": seed + 1}):
        given = {"seed": seed, "step": 7, "stream": 3} | other
        assert np.mean(nova.random_uniform((5, 11), **given).numpy() == got.numpy()) < 0.05
    normal = nova.random_normal((5, 8), seed=seed, step=7, stream=3).numpy().reshape(5, 2, 2, 2)
    u = fractions(5, 8, seed, 7, 3).reshape(5, 2, 2, 2)
    radius = np.sqrt(-2.0 * np.log(u[..., 0] + 2.0**-24))
    pair = np.stack([np.cos(2 * np.pi * u[..., 1]), np.sin(2 * np.pi * u[..., 1])], axis=-1)
    np.testing.assert_allclose(normal, radius[..., None] * pair, rtol=1e-5, atol=2e-6)


def test_random_numbers_are_distributed_as_they_say():
    n = 200_000
    u = nova.random_uniform((n // 8, 8), seed=1).numpy().astype(np.float64).ravel()
    assert u.min() >= 0.0 and u.max() < 1.0
    assert abs(u.mean() - 0.5) < 5 * np.sqrt(1 / 12 / n)
    counts = np.histogram(u, bins=64, range=(0, 1))[0]
    assert np.sum((counts - n / 64) ** 2) / (n / 64) < 63 + 5 * np.sqrt(2 * 63)
    x = nova.random_normal((n // 8, 8), seed=2).numpy().astype(np.float64)
    assert np.all(np.isfinite(x))
    assert abs(x.mean()) < 5 / np.sqrt(n) and abs(x.var() - 1.0) < 5 * np.sqrt(2 / n)
    assert abs(np.mean(x[:, 0] * x[:, 1])) < 5 / np.sqrt(n / 8)
    assert np.mean(np.abs(x) < 1.0) == pytest.approx(0.6827, abs=5e-3)


def test_a_block_of_worlds_draws_the_numbers_of_its_worlds():
    whole = nova.random_normal((12, 5), seed=3, step=2).numpy()
    block = nova.random_normal((4, 5), seed=3, step=2, first_world=8).numpy()
    np.testing.assert_array_equal(block, whole[8:])


def test_a_captured_graph_draws_anew_when_its_step_advances():
    step = nova.tensor([3], nova.int32)
    with nova.ScopedCapture() as capture:
        x = nova.random_normal((6, 5), seed=9, step=step)
    capture.graph.launch()
    np.testing.assert_array_equal(x.numpy(), nova.random_normal((6, 5), seed=9, step=3).numpy())
    step.assign(np.int32([4]))
    capture.graph.launch()
    np.testing.assert_array_equal(x.numpy(), nova.random_normal((6, 5), seed=9, step=4).numpy())


def test_random_numbers_do_not_depend_on_threads():
    code = (
        "import hashlib; from novaphy import nova; "
        "x = nova.random_normal((3000, 7), seed=5, step=2).numpy(); "
        "print(hashlib.sha256(x.tobytes()).hexdigest())"
    )
    found = set()
    for threads in ("1", "2", "7"):
        environ = os.environ | {"NOVAPHY_NUM_THREADS": threads}
        done = subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, env=environ, check=True
        )
        found.add(done.stdout)
    assert len(found) == 1


def test_wrong_draws_are_named():
    with pytest.raises(ValueError, match=r"shape: expected \{worlds, width\} with width > 0"):
        nova.random_uniform((3, 0), seed=1)
    for shape in ((2,), 6, (1, 2, 3), "ab", None):
        with pytest.raises(
            ValueError, match=r"shape: expected \{worlds, width\}, two integers, got"
        ):
            nova.random_uniform(shape, seed=1)
    with pytest.raises(TypeError, match=r"shape\[1\]: expected an integer, got float"):
        nova.random_normal((3, 2.0), seed=1)
    with pytest.raises(ValueError, match="first_world: expected worlds from 0 to 2.31 - 1, got -1"):
        nova.random_normal((3, 2), seed=1, first_world=-1)
    for seed in (-1, 2**64):
        with pytest.raises(ValueError, match=rf"seed: expected an integer from 0 .* got {seed}"):
            nova.random_normal((3, 2), seed=seed)
    with pytest.raises(TypeError, match="seed: expected an integer, got float"):
        nova.random_uniform((3, 2), seed=1.5)
    with pytest.raises(TypeError, match="stream: expected an integer, got str"):
        nova.random_uniform((3, 2), seed=1, stream="a")
    with pytest.raises(TypeError, match="step: expected an int32 tensor"):
        nova.random_uniform((3, 2), seed=1, step=nova.zeros((1,)))


def test_parameters_come_back_from_their_file(tmp_path):
    rng = np.random.default_rng(4)
    made = {name: nova.tensor(f32(rng.normal(size=s))) for name, s in (("w", (3, 2)), ("b", (3,)))}
    path = tmp_path / "policy.npz"
    nova.save_parameters(path, made, {"seed": 7, "ant": "dva"})
    got, meta = nova.load_parameters(path)
    assert meta == {"seed": 7, "ant": "dva"}
    for name, value in made.items():
        np.testing.assert_array_equal(got[name].numpy(), value.numpy())
    like = {"w": nova.zeros((3, 2)), "b": nova.zeros((3,))}
    again, _ = nova.load_parameters(path, like)
    assert again["w"] is like["w"]
    np.testing.assert_array_equal(like["w"].numpy(), made["w"].numpy())
    with pytest.raises(ValueError, match=r"expected b, w, z; it misses z"):
        nova.load_parameters(path, like | {"z": nova.zeros((1,))})
    with pytest.raises(ValueError, match=r"expected b; it has w"):
        nova.load_parameters(path, {"b": nova.zeros((3,))})
    with pytest.raises(ValueError, match=r"w: expected \(2, 3\), got \(3, 2\)"):
        nova.load_parameters(path, {"w": nova.zeros((2, 3)), "b": nova.zeros((3,))})
    np.testing.assert_array_equal(like["b"].numpy(), made["b"].numpy())


def test_bad_files_are_refused(tmp_path):
    path = tmp_path / "bad.npz"
    np.savez(path, w=np.array([{"a": 1}], dtype=object))
    with pytest.raises(ValueError, match="without pickled objects"):
        nova.load_parameters(path)
    np.savez(path, w=f32([1.0, np.nan]))
    with pytest.raises(ValueError, match="w: expected finite numbers"):
        nova.load_parameters(path)
    np.savez(path, w=np.zeros(3))
    with pytest.raises(ValueError, match="w: expected float32, got float64"):
        nova.load_parameters(path)
    path.write_bytes(b"no archive")
    with pytest.raises(ValueError, match="expected an .npz file.*: it does not begin as one"):
        nova.load_parameters(path)
    with pytest.raises(ValueError, match="w: expected finite"):
        nova.save_parameters(path, {"w": nova.tensor([np.inf])})
    assert path.read_bytes() == b"no archive"
    with pytest.raises(FileNotFoundError):
        nova.load_parameters(tmp_path / "none.npz")
    assert novaphy.has_diff()


def test_damaged_archives_are_refused_with_their_name(tmp_path):
    path = tmp_path / "policy.npz"
    nova.save_parameters(path, {"w": nova.ones((2, 3)), "b": nova.tensor([1.0, 2.0])}, {"seed": 7})
    whole = path.read_bytes()
    draw = np.random.default_rng(0)
    cuts = [whole[:k] for k in (0, 20, len(whole) // 2, len(whole) - 5)]
    for _ in range(1000):
        damaged = bytearray(whole)
        for k in draw.integers(len(whole), size=3):
            damaged[k] = draw.integers(256)
        cuts.append(bytes(damaged))
    refused = 0
    for data in cuts:
        path.write_bytes(data)
        try:
            assert nova.load_parameters(path)[0].keys() == {"w", "b"}
        except ValueError as error:
            assert str(path) in str(error)
            refused += 1
    assert refused > 500
    for meta in ("[1]", "{"):
        np.savez(path, w=f32([1.0]), meta=np.array(meta))
        with pytest.raises(ValueError, match=r"policy\.npz, meta: expected"):
            nova.load_parameters(path)


def test_all_is_checked_before_a_tensor_is_written(tmp_path):
    path = tmp_path / "policy.npz"
    nova.save_parameters(path, {"a": nova.ones((2,)), "b": nova.ones((2,))})
    like = {"a": nova.zeros((2,)), "b": nova.zeros((2,), dtype=nova.int32)}
    with pytest.raises(TypeError, match=r"like\['b'\]: expected a float32 tensor, got"):
        nova.load_parameters(path, like)
    with pytest.raises(TypeError, match=r"like\['b'\]: expected a nova\.Tensor, got .*ndarray"):
        nova.load_parameters(path, like | {"b": np.zeros(2, np.float32)})
    assert like["a"].numpy().tolist() == [0, 0]


def test_what_cannot_be_saved_is_named(tmp_path):
    path, one = tmp_path / "policy.npz", nova.ones((1,))
    wrong = [
        (TypeError, r"parameters\['w'\]: expected a nova\.Tensor, got ndarray", {"w": np.ones(1)}),
        (TypeError, "parameters: expected names that are str, got 1", {1: one}),
        (TypeError, "parameters: expected a mapping by name, got list", [one]),
        *(
            (ValueError, f"expected names other than .* got '{name}'", {name: one})
            for name in ("meta", "file", "path", "allow_pickle", "w.npy")
        ),
    ]
    for kind, message, parameters in wrong:
        with pytest.raises(kind, match=message):
            nova.save_parameters(path, parameters)
    for meta in ({"loss": float("nan")}, {"object": object()}):
        with pytest.raises(ValueError, match="meta: expected what JSON can hold"):
            nova.save_parameters(path, {"w": one}, meta)
    assert not path.exists()
    names = ["a/b", "../c", "", "arr_0", "self", "w.0"]
    nova.save_parameters(path, {name: nova.tensor([float(k)]) for k, name in enumerate(names)})
    got, _ = nova.load_parameters(path)
    assert {name: value.item() for name, value in got.items()} == dict(
        zip(names, range(6), strict=True)
    )
