"""Rows, sums, products and comparisons of nova.Tensor: NumPy's values, gradients, bits, errors."""

from __future__ import annotations

import numpy as np
import pytest

from novaphy import nova
from novaphy.testing import assert_same_bits

RANDOM = np.random.default_rng(26)


def values(*shape):
    return RANDOM.uniform(-2, 2, shape).astype(np.float32)


def weighted(y):
    """A scalar that every value of y reaches with another weight."""
    return nova.sum(y * nova.tensor(np.cos(np.arange(y.size, dtype=np.float32)).reshape(y.shape)))


def gradient(function, *inputs):
    """The gradients of weighted(function(...)), and what the function gave."""
    for x in inputs:
        x.requires_grad = True
        x.zero_grad()
    with nova.Tape() as tape:
        y = function(*inputs)
        tape.backward(weighted(y))
    return y, [x.grad.numpy() for x in inputs]


INDICES = [
    0,
    -1,
    np.int64(2),
    slice(1, 3),
    slice(None, None, 2),
    slice(None, None, -1),
    slice(-2, None, -2),
    slice(3, 1),
    (slice(None), 1),
    (slice(None), slice(None, None, -2)),
    (1, 2),
    (..., 0),
    (-1, ...),
    ...,
    [0, 2, 2, -1],
    [],
    np.array([[0, 1], [3, 3]]),
    np.array([True, False, True, True]),
    ([1, 1], slice(1, None)),
]


@pytest.mark.parametrize("index", INDICES, ids=str)
def test_an_index_reads_what_numpy_reads_and_its_gradient_goes_there(index):
    data = values(4, 3)
    x = nova.tensor(data)
    y, (g,) = gradient(lambda t: t[index], x)
    expected = np.atleast_1d(data[index])
    assert isinstance(y, nova.Tensor) and y.shape == expected.shape
    assert_same_bits(y, expected, "values")
    by_hand = np.zeros_like(data)
    weights = np.cos(np.arange(expected.size, dtype=np.float32)).reshape(data[index].shape)
    np.add.at(by_hand, index, weights)
    assert_same_bits(g, by_hand, "gradient")


def test_an_index_makes_a_copy_also_of_integers():
    x = nova.tensor([[1.0, 2], [3, 4]])
    whole, row = x[:], x[0]
    x.fill_(9.0)
    assert whole.tolist() == [[1, 2], [3, 4]] and row.tolist() == [1, 2]
    table = nova.tensor([[1, 2], [3, -4], [5, 6]])
    assert table[1:, 1].tolist() == [-4, 6] and table[1:].dtype is nova.int32
    assert table[[2, 0]].tolist() == [[5, 6], [1, 2]]
    three = nova.tensor(values(2, 3, 4))
    assert_same_bits(three[1, :, 2], three.numpy()[1, :, 2], "three dimensions")


def test_iteration_gives_rows_with_gradients():
    x = nova.tensor([[1.0, 2], [3, 4], [5, 6]], requires_grad=True)
    with nova.Tape() as tape:
        rows = list(x)
        a, b, _ = x
        loss = nova.sum(rows[0] * rows[2]) + nova.sum(a) - nova.sum(b)
        tape.backward(loss)
    assert len(rows) == 3 and rows[1].tolist() == [3, 4]
    assert x.grad.tolist() == [[6, 7], [-1, -1], [1, 2]]
    assert [v.item() for v in nova.tensor([1.0, 2.0])] == [1, 2]


def test_a_row_that_was_cut_out_no_longer_loses_the_gradient():
    q = nova.tensor([[1.0, 2], [3, 4]], requires_grad=True)
    p = nova.tensor([5.0, 6.0], requires_grad=True)
    with nova.Tape() as tape:
        tape.backward(nova.sum(q[0] * p))
    assert q.grad.tolist() == [[5, 6], [0, 0]] and p.grad.tolist() == [1, 2]


@pytest.mark.parametrize(
    ("index", "error", "match"),
    [
        (4, IndexError, "expected -4 to 3 along axis 0, got 4"),
        ((0, -4), IndexError, "expected -3 to 2 along axis 1, got -4"),
        ((0, 0, 0), IndexError, "at most 2 indices, got 3"),
        ((..., ...), IndexError, "one ... at most, got 2"),
        ([0, 7], IndexError, "expected -4 to 3 along axis 0, got 7 at entry 1"),
        (np.array([True]), IndexError, "one truth value for each of 4 rows"),
        ((slice(None), [0]), IndexError, "a table of rows comes first"),
        (1.5, TypeError, "expected integers, slices, .* got float"),
        (True, TypeError, "got bool"),
        (None, TypeError, "got NoneType"),
        ([0.5], TypeError, "integers or truth values, got float64"),
        (
            np.array([2**64 - 1], np.uint64),
            IndexError,
            "expected -4 to 3 .* got 18446744073709551615",
        ),
        (slice(0, 2, 0), ValueError, "zero"),
    ],
    ids=str,
)
def test_an_index_that_is_none_is_refused(index, error, match):
    with pytest.raises(error, match=match):
        nova.tensor(values(4, 3))[index]


def test_gather_checks_the_index_and_what_became_of_it():
    x = nova.tensor(values(4, 3), requires_grad=True)
    for bad in ([0, 4], [0, -1], [2**30, 0]):
        with pytest.raises(IndexError, match="expected rows 0 to 3 of x, got"):
            nova.gather(x, nova.tensor(bad, dtype=nova.int32))
    with pytest.raises(TypeError, match="gather, index: expected int32, got float32"):
        nova.gather(x, nova.tensor([0.0]))
    index = nova.tensor([1, 1])
    with nova.Tape() as tape:
        y = nova.sum(nova.gather(x, index))
        index.assign([0, 0])
        with pytest.raises(RuntimeError, match="of op 'gather' was modified after recording"):
            tape.backward(y)


BROADCAST = [
    ((4, 3), (3,)),
    ((4, 3), (4, 1)),
    ((4, 3), (1, 3)),
    ((4, 1), (1, 3)),
    ((4, 3), (1,)),
    ((2, 1, 3), (4, 1)),
    ((1, 1), (3,)),
    ((3, 1, 1, 2), (1, 4, 2, 1)),
]


@pytest.mark.parametrize("swapped", [False, True])
@pytest.mark.parametrize("shapes", BROADCAST, ids=str)
def test_operands_are_broadcast_as_in_numpy(shapes, swapped):
    a, b = (values(*s) for s in (shapes[::-1] if swapped else shapes))
    x, y = nova.tensor(a), nova.tensor(b)
    z, (ga, gb) = gradient(lambda s, t: s * t, x, y)
    assert z.shape == (a * b).shape
    assert_same_bits(z, a * b, "values")
    weights = np.cos(np.arange(z.size, dtype=np.float32)).reshape(z.shape).astype(np.float64)

    def reduced(g, shape):
        g = g.sum(axis=tuple(range(g.ndim - len(shape))))
        kept = tuple(d for d, n in enumerate(shape) if n == 1)
        return g.sum(axis=kept, keepdims=True)

    np.testing.assert_allclose(ga, reduced(weights * b, a.shape), rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(gb, reduced(weights * a, b.shape), rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("shape", [(0,), (0, 3), (3, 0)])
def test_nothing_is_broadcast_and_summed_with_a_gradient_of_its_shape(shape):
    x = nova.zeros(shape)
    y, (grad,) = gradient(lambda x: nova.broadcast_to(x, (2, *shape)), x)
    assert y.shape == (2, *shape) and grad.shape == shape
    if shape[0] == 0:
        return
    row = nova.ones((1, 1))
    _, grads = gradient(lambda x, row: x * row, x, row)
    assert grads[1].tolist() == [[0.0]]


def test_shapes_that_do_not_fit_are_refused():
    with pytest.raises(ValueError, match=r"add: shapes \{4, 3\} and \{4\} differ"):
        _ = nova.tensor(values(4, 3)) + nova.tensor(values(4))
    with pytest.raises(ValueError, match=r"cannot be broadcast to \{3\}"):
        nova.broadcast_to(nova.tensor(values(4, 3)), (3,))
    with pytest.raises(ValueError, match="dot: shapes"):
        nova.dot(nova.tensor(values(4, 3)), nova.tensor(values(3)))


@pytest.mark.parametrize("axis", [0, 1, 2, -1, -3])
@pytest.mark.parametrize("keepdims", [False, True])
def test_sums_and_means_over_a_dimension(axis, keepdims):
    data = values(4, 3, 5)
    for name in ("sum", "mean"):
        function = getattr(nova, name)
        y, _ = gradient(lambda t, f=function: f(t, axis=axis, keepdims=keepdims), nova.tensor(data))
        expected = getattr(np, name)(data.astype(np.float64), axis=axis, keepdims=keepdims)
        assert y.shape == expected.shape
        np.testing.assert_allclose(y.numpy(), expected, rtol=1e-5, atol=1e-6)
        x = nova.tensor(data[:2, :2, :2])
        check = nova.gradcheck(
            lambda t, f=function: nova.sum(f(t, axis=axis, keepdims=keepdims) ** 2), [x]
        )
        assert check.ok, check


def test_an_axis_that_is_not_there_is_refused():
    x = nova.tensor(values(4, 3))
    with pytest.raises(IndexError, match=r"sum, axis: expected -2 to 1 for shape \{4, 3\}, got 2"):
        nova.sum(x, axis=2)
    with pytest.raises(ValueError, match="keepdims: expected an axis"):
        nova.sum(x, keepdims=True)
    with pytest.raises(ValueError, match="mean, x: expected at least one value"):
        nova.mean(nova.zeros((0, 3)), axis=0)
    assert nova.sum(nova.zeros((0, 3)), axis=0).tolist() == [0, 0, 0]
    assert nova.sum(nova.tensor([1.0, 2.0]), axis=0).shape == (1,)


@pytest.mark.parametrize("axis", [0, 1, -1])
def test_concat_puts_parts_together_and_takes_gradients_apart(axis):
    shapes = [(2, 3), (2, 3), (2, 3)]
    shapes[1] = (4, 3) if axis == 0 else (2, 5)
    parts = [values(*s) for s in shapes]
    y, gradients = gradient(lambda *t: nova.concat(t, axis=axis), *map(nova.tensor, parts))
    assert_same_bits(y, np.concatenate(parts, axis=axis), "values")
    weights = np.cos(np.arange(y.size, dtype=np.float32)).reshape(y.shape)
    ends = np.cumsum([s[axis] for s in shapes])[:-1]
    for g, expected in zip(gradients, np.split(weights, ends, axis=axis), strict=True):
        assert_same_bits(g, expected, "gradient")


def test_concat_of_many_of_one_and_of_integers():
    many = [nova.tensor([float(k)], requires_grad=True) for k in range(150)]
    with nova.Tape() as tape:
        tape.backward(nova.sum(nova.concat(many) ** 2))
    assert many[149].grad.item() == 298
    assert nova.concat([nova.tensor([1, 2]), nova.tensor([-3])]).tolist() == [1, 2, -3]
    x = nova.tensor([1.0, -0.0])
    assert_same_bits(nova.concat([x]), x, "one")
    y = nova.concat([x, x])
    assert_same_bits(y, np.float32([1, -0.0, 1, -0.0]), "zeros keep their sign")
    for parts, error in (
        ([], ValueError),
        ([x, nova.tensor([1])], ValueError),
        ([x, nova.tensor([[1.0, 2]])], ValueError),
    ):
        with pytest.raises(error, match="concat, parts"):
            nova.concat(parts)


def left_fold(a, b):
    """The matrix product as it is stated: float32, from +0, in ascending k."""
    total = np.zeros((a.shape[0], b.shape[1]), np.float32)
    for k in range(a.shape[1]):
        total = total + a[:, k : k + 1] * b[k : k + 1, :]
    return total


@pytest.mark.parametrize(
    "shapes", [((5, 7), (7, 3)), ((5, 7), (7,)), ((7,), (7, 3)), ((7,), (7,)), ((2, 0), (0, 3))]
)
def test_products_are_left_folds_with_gradients(shapes):
    a, b = values(*shapes[0]), values(*shapes[1])
    y, (ga, gb) = gradient(nova.matmul, nova.tensor(a), nova.tensor(b))
    left, right = np.atleast_2d(a), b if b.ndim == 2 else b[:, None]
    assert y.shape == np.atleast_1d(a @ b).shape
    assert_same_bits(y.numpy().ravel(), left_fold(left, right).ravel(), "values")
    weights = np.cos(np.arange(y.size, dtype=np.float32)).reshape(left.shape[0], right.shape[1])
    assert_same_bits(ga.ravel(), left_fold(weights, right.T).ravel(), "gradient of a")
    assert_same_bits(gb.ravel(), left_fold(left.T, weights).ravel(), "gradient of b")
    exact = left.astype(np.float64) @ right.astype(np.float64)
    np.testing.assert_allclose(y.numpy().ravel(), exact.ravel(), rtol=1e-5, atol=1e-5)


def test_products_of_64_by_64_and_of_a_matrix_with_itself():
    a, b = values(64, 64), values(64, 64)
    np.testing.assert_allclose(
        (nova.tensor(a) @ nova.tensor(b)).numpy(), a.astype(np.float64) @ b, rtol=1e-4, atol=1e-4
    )
    assert nova.gradcheck(lambda t: nova.sum((t @ t) ** 2), [nova.tensor(values(3, 3))]).ok
    with pytest.raises(ValueError, match=r"got \{5, 7\} by \{5, 7\}"):
        _ = nova.tensor(values(5, 7)) @ nova.tensor(values(5, 7))
    with pytest.raises(ValueError, match=r"matmul: expected \{n, k\}"):
        _ = nova.tensor(values(2, 3, 4)) @ nova.tensor(values(4))
    with pytest.raises(TypeError):
        _ = nova.tensor(values(3)) @ values(3)


def test_powers_of_numbers_and_tensors():
    base, exponent = np.float32([0.5, 1.5, 2.0]), np.float32([2.0, -1.0, 0.5])
    x, y = nova.tensor(base), nova.tensor(exponent)
    for z, expected in (
        (x**y, base**exponent),
        (x**3, base**3),
        (x**-0.5, base**-0.5),
        (2**y, 2**exponent),
        (nova.pow(x, 2), base * base),
        (nova.pow(2, y), 2**exponent),
        (x ** nova.tensor([2.0]), base**2),
    ):
        np.testing.assert_allclose(z.numpy(), expected, rtol=4e-7)
    assert_same_bits(nova.tensor([-1.1, 3.3]) ** 2, np.float32([-1.1, 3.3]) ** 2, "squares")
    assert nova.gradcheck(lambda s, t: nova.sum(s**t + s**1.5 + 2**t + s**2), [x, y]).ok


def test_comparisons_are_masks_for_where():
    a, b = np.float32([1, 2, 3, np.nan, -0.0]), np.float32([2, 2, 2, 2, 0.0])
    x, y = nova.tensor(a), nova.tensor(b)
    with np.errstate(invalid="ignore"):
        for z, expected in (
            (x < y, a < b),
            (x <= y, a <= b),
            (x == y, a == b),
            (x != y, a != b),
            (x >= y, a >= b),
            (x > y, a > b),
            (x < 2, a < 2),
            (x > 2, a > 2),
            (x == 2, a == 2),
            (x != 2, a != 2),
            (nova.tensor([[1.0], [2.0]]) < x, np.float32([[1], [2]]) < a),
        ):
            assert z.dtype is nova.float32 and z.tolist() == expected.tolist()
    t = nova.tensor([-1.0, 2.0, 0.0], requires_grad=True)
    with nova.Tape() as tape:
        assert not (t > 0).requires_grad
        z = nova.where(t > 0, t * t, -3 * t)
        tape.backward(nova.sum(z))
    assert z.tolist() == [3, 4, 0] and t.grad.tolist() == [-3, 4, -3]
    assert nova.where(t >= 0, 1, 0).tolist() == [0, 1, 1]
    assert nova.where(nova.tensor([1, 0]), nova.tensor([[1.0], [2.0]]), 5).tolist() == [
        [1, 5],
        [2, 5],
    ]
    assert nova.where(nova.tensor([-0.0, 1e-45]), 1, 0).tolist() == [0, 1]
    assert nova.where(nova.tensor([-(2**31), 0]), 1, 0).tolist() == [1, 0]


def test_equality_with_what_is_no_tensor():
    t = nova.tensor([1.0, 2.0])
    assert (t == None) is False and (t != "a") is True  # noqa: E711
    assert len({t, t, nova.tensor([1.0, 2.0])}) == 2
    for other in (np.ones(2, np.float32), [1.0, 2.0]):
        with pytest.raises(TypeError, match="expected a Tensor or a number"):
            _ = t == other
    with pytest.raises(ValueError, match="no single truth value"):
        bool(t == t)


def test_numbers_and_text_of_tensors():
    t = nova.tensor([2.5])
    assert float(t) == 2.5 and int(t) == 2 and bool(t) and not nova.tensor([0.0])
    assert int(nova.tensor([7])) == 7 and f"{t:.2f}" == "2.50"
    with pytest.raises(ValueError, match=r"expected one value, got shape \{2\}"):
        float(nova.zeros(2))
    assert repr(nova.tensor([[1.0, 2], [3, 4]], requires_grad=True)) == (
        "Tensor([[1., 2.],\n        [3., 4.]], shape=(2, 2), dtype=float32, device='cpu', "
        "requires_grad=True)"
    )
    assert repr(nova.tensor([1, 2])) == "Tensor([1, 2], shape=(2,), dtype=int32, device='cpu')"
    assert f"{t}" == str(t) == "Tensor([2.5], shape=(1,), dtype=float32, device='cpu')"
    assert "..., 997, 998, 999], shape=(1000,)" in repr(nova.arange(1000))
    with nova.ScopedCapture():
        assert repr(t) == "Tensor(shape=(1,), dtype=float32, device='cpu')"
    with pytest.raises(TypeError, match="lower: expected a number, got a Tensor"):
        nova.clamp(t, t, 3)


def everything(x, w, index):
    """One loss through every function of this page."""
    rows = nova.gather(x, index)
    centered = rows - nova.mean(rows, axis=0)
    y = nova.concat([centered @ w, x[1:4, ::-1] ** 3], axis=0)
    y = nova.where(y > 0.25, y, 0.5 * y * y)
    return nova.sum(nova.sum(y, axis=1) * y[:, 0]) + nova.sum(x[-1])


def trained(threads):
    nova.set_num_threads(threads)
    random = np.random.default_rng(3)
    x = nova.tensor(random.normal(size=(3000, 3)).astype(np.float32), requires_grad=True)
    w = nova.tensor(random.normal(size=(3, 3)).astype(np.float32), requires_grad=True)
    index = nova.tensor(random.integers(0, 3000, 5000).astype(np.int32))
    with nova.Tape() as tape:
        loss = everything(x, w, index)
        tape.backward(loss)
    return loss.numpy(), x.grad.numpy(), w.grad.numpy()


def test_the_bits_do_not_depend_on_the_number_of_threads():
    before = nova.num_threads()
    try:
        one = trained(1)
        for threads in (2, 7):
            for value, expected in zip(trained(threads), one, strict=True):
                assert_same_bits(value, expected, f"{threads} threads")
    finally:
        nova.set_num_threads(before)


def test_a_captured_replay_has_the_bits_of_what_runs_at_once():
    def make():
        random = np.random.default_rng(5)
        x = nova.tensor(random.normal(size=(40, 3)).astype(np.float32), requires_grad=True)
        w = nova.tensor(random.normal(size=(3, 3)).astype(np.float32), requires_grad=True)
        return x, w, nova.tensor(random.integers(0, 40, 60).astype(np.int32))

    def iteration(x, w, index):
        with nova.Tape() as tape:
            loss = everything(x, w, index)
            tape.backward(loss)
            for p in (x, w):
                nova.sgd_update_f32(p, 1e-4)
            tape.zero()
        return loss

    eager, captured = make(), make()
    with nova.ScopedCapture() as capture:
        loss = iteration(*captured)
    for _ in range(4):
        expected = iteration(*eager)
        capture.graph.launch()
        assert_same_bits(loss, expected, "loss")
        for a, b in zip(captured[:2], eager[:2], strict=True):
            assert_same_bits(a, b, "parameters")
    captured[2].assign(np.zeros(60, np.int32))
    with pytest.raises(RuntimeError, match="changed|modified|captured"):
        capture.graph.launch()


def test_only_values_that_a_gradient_needs_must_stay():
    x = nova.tensor(values(4, 3), requires_grad=True)
    with nova.Tape() as tape:
        y = nova.sum(nova.concat([x[0], x[[2, 2], 1]]) + nova.sum(x, axis=1)[1])
        x.fill_(0.0)
        tape.backward(y)
    assert x.grad.tolist() == [[1, 1, 1], [5, 5, 5], [0, 2, 0], [0, 0, 0]]


def test_an_overwritten_input_is_refused():
    x = nova.tensor(values(4, 3), requires_grad=True)
    w = nova.tensor(values(3, 3), requires_grad=True)
    with nova.Tape() as tape:
        y = nova.sum(x @ w)
        w.fill_(1.0)
        with pytest.raises(RuntimeError, match="'matmul' was modified after recording"):
            tape.backward(y)


# ------------------------------------------------------------------- words that users look for


def checked(function, *inputs):
    """gradcheck of a weighted sum, with the dot product against forward mode."""
    result = nova.gradcheck(lambda *x: weighted(function(*x)), [nova.tensor(x) for x in inputs])
    assert result.ok and result.has_tangent, result


def test_methods_are_the_functions():
    x = nova.tensor(values(4, 3))
    for name in ("sum", "mean", "max", "min"):
        for options in ({}, {"axis": 1}, {"axis": -2, "keepdims": True}):
            method, function = getattr(x, name)(**options), getattr(nova, name)(x, **options)
            assert_same_bits(method, function.numpy(), name)
    assert_same_bits(x.T, x.numpy().T)


@pytest.mark.parametrize("axis", [None, 0, 1, -1])
@pytest.mark.parametrize("keepdims", [False, True])
@pytest.mark.parametrize("name", ["max", "min"])
def test_extremes_are_those_of_numpy_and_their_gradient_goes_to_one_value(name, axis, keepdims):
    if axis is None and keepdims:
        with pytest.raises(ValueError, match=f"{name}, keepdims"):
            getattr(nova, name)(nova.tensor([1.0]), keepdims=True)
        return
    for shape in ((1, 1, 1), (2, 3, 5), (7, 4, 6)):
        data = RANDOM.permutation(np.arange(np.prod(shape), dtype=np.float32)).reshape(shape)
        x = nova.tensor(data)
        y, (g,) = gradient(lambda t: getattr(nova, name)(t, axis, keepdims), x)
        expected = getattr(np, name)(data, axis=axis, keepdims=keepdims)
        assert_same_bits(y, np.atleast_1d(expected))
        weights = np.cos(np.arange(expected.size, dtype=np.float32))
        weights = weights.reshape(np.shape(getattr(np, name)(data, axis=axis, keepdims=True)))
        is_it = data == getattr(np, name)(data, axis=axis, keepdims=True)
        assert_same_bits(g, np.where(is_it, weights, np.float32(0)))
    equal = nova.tensor([2.0, 2, 2, 1] if name == "max" else [2.0, 2, 2, 3])
    assert gradient(lambda t: getattr(nova, name)(t), equal)[1][0].sum() == 1
    with pytest.raises(ValueError, match=f"{name}, x: expected at least one value"):
        getattr(nova, name)(nova.zeros((2, 0)), axis=1)
    assert_same_bits(
        getattr(nova, name)(equal, equal * 2.0),
        getattr(nova, f"{name}imum")(equal, equal * 2.0).numpy(),
    )


@pytest.mark.parametrize("axes", [None, (0, 1, 2), (2, 0, 1), (-1, 1, 0)])
def test_transpose_is_that_of_numpy(axes):
    data = values(2, 3, 4)
    x = nova.tensor(data)
    y, (g,) = gradient(lambda t: nova.transpose(t, axes), x)
    assert_same_bits(y, np.transpose(data, axes))
    order = range(3)[::-1] if axes is None else axes
    weights = np.cos(np.arange(data.size, dtype=np.float32)).reshape(y.shape)
    assert_same_bits(g, np.transpose(weights, np.argsort([k % 3 for k in order])))
    whole = nova.arange(6).reshape(2, 3)
    assert whole.T.tolist() == [[0, 3], [1, 4], [2, 5]] and whole.T.dtype is nova.int32
    assert nova.tensor([1.0, 2]).T.tolist() == [1, 2] and nova.zeros((0, 3)).T.shape == (3, 0)


def test_transposes_and_stacks_are_recorded_in_a_capture():
    x = nova.tensor(values(3, 2))
    with nova.ScopedCapture() as capture:
        y = nova.stack([x.T @ x, x.T @ x], axis=1) + nova.max(x)
    x.assign(values(3, 2))
    capture.graph.launch()
    product = (x.T @ x).numpy()
    assert_same_bits(y, np.stack([product, product], axis=1) + x.numpy().max())


@pytest.mark.parametrize("axis", [0, 1, 2, -1, -3])
def test_stack_is_that_of_numpy(axis):
    parts = [nova.tensor(values(2, 3)) for _ in range(3)]
    y, gradients = gradient(lambda *p: nova.stack(p, axis), *parts)
    assert_same_bits(y, np.stack([p.numpy() for p in parts], axis))
    weights = np.cos(np.arange(18, dtype=np.float32)).reshape(y.shape)
    for k, g in enumerate(gradients):
        assert_same_bits(g, np.take(weights, k, axis))


def test_what_stack_and_transpose_refuse():
    x = nova.zeros((2, 3))
    with pytest.raises(ValueError, match=r"stack, parts\[1\]: expected the shape of parts\[0\]"):
        nova.stack([x, nova.zeros((3, 2))])
    with pytest.raises(IndexError, match="stack, axis: expected -3 to 2"):
        nova.stack([x], 3)
    with pytest.raises(ValueError, match="at least one"):
        nova.stack([])
    with pytest.raises(ValueError, match="transpose, axes: expected every dimension once"):
        nova.transpose(x, (0, 0))
    with pytest.raises(ValueError, match="transpose, axes: expected 2"):
        nova.transpose(x, (0, 1, 2))


def test_angles_are_those_of_numpy_with_their_gradients():
    x, y = values(40), values(1, 40)[:, ::-1].copy()
    np.testing.assert_allclose(
        nova.atan2(nova.tensor(y), nova.tensor(x)).numpy(), np.arctan2(y, x), rtol=3e-7
    )
    inside = (x / 2.2).astype(np.float32)
    np.testing.assert_allclose(nova.acos(nova.tensor(inside)).numpy(), np.arccos(inside), rtol=3e-7)
    checked(nova.atan2, y, x)
    checked(nova.acos, inside[np.abs(inside) < 0.9])
    edge = nova.tensor([-1.5, 1.0, 0.0])
    assert gradient(nova.acos, edge)[1][0][:2].tolist() == [0, 0]
    origin = nova.zeros(1)
    assert gradient(lambda t: nova.atan2(t, nova.zeros(1)), origin)[1][0].tolist() == [0]


def rotations(n):
    q = RANDOM.normal(size=(n, 4))
    return (q / np.linalg.norm(q, axis=1, keepdims=True)).astype(np.float32)


def matrices(q):
    x, y, z, w = np.asarray(q, np.float64).T
    return np.moveaxis(
        np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
            ]
        ),
        2,
        0,
    )


def test_quaternions_are_rotations():
    a, b, v = rotations(20), rotations(20), values(20, 3)
    product = nova.quat_mul(nova.tensor(a), nova.tensor(b)).numpy()
    np.testing.assert_allclose(matrices(product), matrices(a) @ matrices(b), atol=1e-6)
    rotated = nova.quat_rotate(nova.tensor(a), nova.tensor(v)).numpy()
    np.testing.assert_allclose(rotated, np.einsum("nij,nj->ni", matrices(a), v), atol=2e-6)
    np.testing.assert_allclose(
        nova.cross(nova.tensor(v), nova.tensor(v[::-1].copy())).numpy(),
        np.cross(v, v[::-1]),
        atol=1e-6,
    )
    half = nova.tensor([0.0, 0.0, np.sin(np.pi / 4), np.cos(np.pi / 4)])  # 90 degrees about z
    assert_close = np.testing.assert_allclose
    assert_close(nova.quat_log(half).numpy(), [0, 0, np.pi / 2], atol=1e-6)
    assert_close(nova.quat_rotate(half, nova.tensor([1.0, 0, 0])).numpy(), [0, 1, 0], atol=1e-6)
    checked(nova.cross, values(3, 3), values(3, 3))
    checked(nova.quat_mul, rotations(3), rotations(3))
    checked(nova.quat_rotate, rotations(3), values(3, 3))
    checked(nova.quat_rotate, rotations(1)[0], values(2, 2, 3))  # one quaternion for all


@pytest.mark.parametrize(
    "length", [0.0, 1e-30, 1e-6, 0.03, 0.0599, 0.0601, 0.1999, 0.2001, 1.0, 3.1]
)
def test_exponential_and_logarithm_are_inverse_at_every_angle(length):
    axis = np.array([0.36, -0.48, 0.8])
    r = np.float32(axis * length)
    q = nova.quat_exp(nova.tensor(r))
    s, c = np.sin(length / 2), np.cos(length / 2)
    np.testing.assert_allclose(q.numpy(), [*(axis * s), c], rtol=1e-6, atol=3e-8 * length)
    for same in (q, -q):
        np.testing.assert_allclose(nova.quat_log(same).numpy(), r, rtol=2e-6)

    # The reference: d exp/dr at r is a 4 by 3 matrix, by differences in float64.
    def exact(v):
        a = np.linalg.norm(v) / 2
        return np.array([*(v * 0.5 * np.sinc(a / np.pi)), np.cos(a)])

    step = 1e-6
    columns = [
        (exact(axis * length + e) - exact(axis * length - e)) / (2 * step) for e in step * np.eye(3)
    ]
    for row in range(4):
        x = nova.tensor(r)
        x.requires_grad = True
        with nova.Tape() as tape:
            tape.backward(nova.quat_exp(x)[row])
        np.testing.assert_allclose(x.grad.numpy(), [c[row] for c in columns], atol=1e-6)
    x = nova.tensor(r)
    x.requires_grad = True
    with nova.Tape() as tape:
        tape.backward(nova.sum(nova.quat_log(nova.quat_exp(x)) * nova.tensor([1.0, 2, 3])))
    np.testing.assert_allclose(x.grad.numpy(), [1, 2, 3], rtol=1e-5)  # the identity


def test_rows_that_are_no_vectors_or_quaternions_are_refused():
    q, v = nova.zeros((2, 4)), nova.zeros((2, 3))
    with pytest.raises(ValueError, match="quat_rotate, v: expected a last dimension of 3"):
        nova.quat_rotate(q, q)
    with pytest.raises(ValueError, match="quat_mul, b: expected a last dimension of 4"):
        nova.quat_mul(q, v)
    with pytest.raises(ValueError, match="cross: shapes"):
        nova.cross(v, nova.zeros((3, 3)))
    with pytest.raises(TypeError, match="quat_log, q: expected float32"):
        nova.quat_log(nova.arange(4))
