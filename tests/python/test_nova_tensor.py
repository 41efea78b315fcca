"""nova.Tensor: creation, values, arithmetic with gradients, exchange with NumPy."""

from __future__ import annotations

import gc
import math
from types import SimpleNamespace

import numpy as np
import pytest

import novaphy
from novaphy import DeviceArray, nova


def test_tensors_are_made_from_numbers_lists_and_arrays():
    assert nova.tensor(2.5).shape == (1,) and nova.tensor(2.5).item() == 2.5
    assert nova.tensor([1, 2]).dtype is nova.int32 and nova.tensor([1.0]).dtype is nova.float32
    assert nova.tensor([True]).dtype is nova.uint8
    assert nova.tensor([1, 2], dtype=nova.float32).dtype is nova.float32
    assert nova.tensor(np.zeros((2, 3), np.float32)).shape == (2, 3)
    assert nova.from_numpy(np.int32([1])).dtype is nova.int32
    assert nova.zeros((2, 2)).tolist() == [[0, 0], [0, 0]] and nova.ones(2).tolist() == [1, 1]
    assert nova.full(2, 3, dtype=nova.int32).tolist() == [3, 3] and nova.empty(0).size == 0
    assert nova.arange(3).tolist() == [0, 1, 2] and nova.arange(1, 7, 2).tolist() == [1, 3, 5]
    like = nova.zeros_like(nova.tensor([[1, 2]]))
    assert like.shape == (1, 2) and like.dtype is nova.int32
    assert nova.float32 is novaphy.float32


@pytest.mark.parametrize(
    ("value", "dtype"),
    [
        (1.5, nova.int32),
        (2**31, nova.int32),
        (np.nan, nova.int32),
        (-1, nova.uint8),
        (256, nova.uint8),
    ],
)
def test_integers_are_filled_with_what_they_can_hold_only(value, dtype):
    with pytest.raises(ValueError, match=r"value: expected a whole number from .* got"):
        nova.full(2, value, dtype=dtype)
    assert nova.full(1, 2**24 + 1, dtype=nova.int32).tolist() == [2**24 + 1]


def test_bad_data_is_refused():
    for data in (np.uint32([1]), np.array(["a"]), np.array([1j])):
        with pytest.raises(TypeError):
            nova.tensor(data)
    for dtype in (novaphy.vec3, novaphy.uint64, "float64", float):
        with pytest.raises((TypeError, ValueError)):
            nova.tensor([1.0], dtype=dtype)
    with pytest.raises(ValueError):
        nova.tensor([[1, 2], [3]])
    with pytest.raises(ValueError, match="float32"):
        nova.tensor([1, 2], requires_grad=True)
    with pytest.raises(ValueError):
        nova.zeros(-1)
    with pytest.raises(TypeError):
        nova.zeros("a")


def test_float64_is_rounded_where_no_gradient_is_asked():
    wide = np.array([0.1, 1 / 3, 1e300])
    with np.errstate(over="ignore"):
        expected = wide.astype(np.float32)
        for tensor in (nova.tensor(wide), nova.from_numpy(wide), nova.tensor(wide.tolist())):
            assert tensor.dtype is nova.float32
            np.testing.assert_array_equal(tensor.numpy(), expected)
    for make in (nova.tensor, nova.from_numpy):
        with pytest.raises(TypeError, match=r"requires_grad=True.*array of float64.*astype"):
            make(wide[:2], requires_grad=True)
    parameter = nova.tensor(wide[:2].tolist(), requires_grad=True)
    parameter.assign(wide[1::-1])
    np.testing.assert_array_equal(parameter.numpy(), expected[1::-1])


def test_a_tensor_is_described():
    t = nova.tensor([[1.0, 2, 3], [4, 5, 6]], requires_grad=True)
    assert (t.shape, t.ndim, t.size, len(t)) == ((2, 3), 2, 6, 2)
    assert (t.itemsize, t.nbytes, t.strides) == (4, 24, (12, 4))
    assert t.data_ptr and t.is_contiguous and t.is_leaf and not t.is_external
    assert str(t.device) == "cpu" and t.requires_grad
    assert repr(t).endswith("shape=(2, 3), dtype=float32, device='cpu', requires_grad=True)")
    with pytest.raises(ValueError, match="item"):
        t.item()
    np.testing.assert_array_equal(t[1], [4, 5, 6])
    np.testing.assert_array_equal(t[0:1], [[1, 2, 3]])
    with pytest.raises(IndexError):
        t[2]
    with pytest.raises(TypeError):
        t[0] = 1


def test_reshape_looks_at_the_same_memory():
    t = nova.tensor([1.0, 2, 3, 4, 5, 6])
    for r in (t.reshape(2, 3), t.reshape((2, 3)), t.reshape(-1, 3), t.reshape([2, -1])):
        assert r.shape == (2, 3) and r.data_ptr == t.data_ptr
    t.fill_(9.0)
    assert r.tolist() == [[9] * 3] * 2
    for bad in ((4, 2), (-1, 4), (-1, -1)):
        with pytest.raises(ValueError):
            t.reshape(*bad)
    with pytest.raises(TypeError):
        t.reshape("a")


@pytest.mark.parametrize(
    "shape",
    [(2**62 + 1, 4), (2**33, 2**33), (2**61,), (2**32, 2**31, 0), (0, 2**62, 2)],
)
def test_a_shape_whose_bytes_overflow_is_refused(shape):
    for make in (nova.ones, nova.zeros, nova.tensor([]).reshape):
        with pytest.raises(ValueError, match="shape: .* is too large"):
            make(shape)


def test_a_free_size_beside_sizes_that_overflow_is_refused():
    with pytest.raises(ValueError, match="shape: .* is too large"):
        nova.tensor([1.0, 2.0]).reshape(2**62, 2**62, -1)


def test_a_kernel_refuses_rows_wider_than_it_can_count():
    wide = nova.zeros((0, 2**32 + 3))
    assert wide.shape == (0, 2**32 + 3)
    with pytest.raises(ValueError, match=r"less than 2\^31 values, got shape \{0, 4294967299\}"):
        nova.sum_rows(wide)


def test_values_are_copied_and_filled():
    t = nova.zeros((2, 2))
    version = t.version
    assert t.copy_(nova.ones((2, 2))) is t and t.tolist() == [[1, 1], [1, 1]]
    t.assign([[1, 2], [3, 4]])
    t.assign(np.float32([1, 2, 3, 4]))
    t.assign(nova.tensor([[5.0, 6], [7, 8]]))
    assert t.version > version and t.tolist() == [[5, 6], [7, 8]]
    assert t.zero_() is t and t.fill_(2) is t
    copy, cut = t.clone(), t.detach()
    t.zero_()
    assert copy.tolist() == cut.tolist() == [[2, 2], [2, 2]]
    with pytest.raises(ValueError):
        t.assign([1, 2, 3])
    with pytest.raises(ValueError):
        t.copy_(nova.zeros(3))
    with pytest.raises(TypeError):
        t.assign(np.array([["a", "b"], ["c", "d"]]))
    assert nova.tensor([1, 2]).zero_().tolist() == [0, 0]
    with pytest.raises(novaphy.Error, match="cuda"):
        t.to("cuda:63")  # more GPUs than a machine has


def test_the_same_array_gives_the_same_tensor():
    array = DeviceArray.zeros(3, novaphy.vec3)
    view = nova.from_device_array(array)
    assert view is nova.from_device_array(array) and view.shape == (3, 3)
    assert view.data_ptr == array.ptr and not view.requires_grad
    view.fill_(2.0)
    assert (array.numpy() == 2).all()
    array.fill_(3.0)
    assert (view.numpy() == 3).all() and view.version == array.version
    assert nova.from_device_array(array, requires_grad=True).requires_grad
    assert nova.from_device_array(array).requires_grad
    del array
    gc.collect()
    assert (view.numpy() == 3).all()


def test_numpy_and_dlpack_share_memory_both_ways():
    t = nova.tensor([[1.0, 2], [3, 4]], requires_grad=True)
    for alias in (np.asarray(t), np.from_dlpack(t), t.numpy(copy=False)):
        assert alias.ctypes.data == t.data_ptr and not alias.flags.writeable
    assert t.numpy(copy=False, writable=True).flags.writeable
    assert t.numpy().ctypes.data != t.data_ptr
    values = np.zeros((2, 3), np.float32)
    shared = nova.from_dlpack(values)
    assert shared.data_ptr == values.ctypes.data and shared.is_external
    shared.fill_(4.0)
    assert (values == 4).all()
    values[0, 0] = 1
    assert shared[0][0] == 1
    assert nova.from_dlpack(t) is t
    assert nova.from_dlpack(DeviceArray([1.0])).shape == (1,)
    del values
    gc.collect()
    assert shared[1][2] == 4
    raw = np.arange(4, dtype=np.float32)
    outside = nova.external(raw.ctypes.data, (4,), nova.float32, "cpu", raw)
    del raw
    gc.collect()
    assert outside.tolist() == [0, 1, 2, 3]


def test_numpy_leaves_arithmetic_with_a_tensor_to_the_tensor():
    t = nova.tensor([1.0, 2.0])
    assert isinstance(np.float32(2) * t, nova.Tensor) and (np.float64(2) * t).tolist() == [2, 4]
    assert (t + np.float32(1)).tolist() == [2, 3] and (1 - t).tolist() == [0, -1]
    with pytest.raises(TypeError):
        _ = t + np.ones(2, np.float32)
    with pytest.raises(TypeError):
        _ = np.ones(2, np.float32) * t
    with pytest.raises(TypeError):
        _ = t + "a"


UNARY = {
    "neg": (lambda x: -x, lambda x: -1),
    "abs": (abs, lambda x: math.copysign(1, x)),
    "sqrt": (math.sqrt, lambda x: 0.5 / math.sqrt(x)),
    "exp": (math.exp, math.exp),
    "log": (math.log, lambda x: 1 / x),
    "sin": (math.sin, math.cos),
    "cos": (math.cos, lambda x: -math.sin(x)),
    "tanh": (math.tanh, lambda x: 1 - math.tanh(x) ** 2),
}


@pytest.mark.parametrize("name", UNARY)
def test_functions_of_one_tensor_and_their_derivatives(name):
    values = [0.5, 1.25, 2.0] if name in ("sqrt", "log") else [-1.5, 0.25, 2.0]
    function, derivative = UNARY[name]
    x = nova.tensor(values, requires_grad=True)
    with nova.Tape() as tape:
        y = getattr(nova, name)(x)
        tape.backward(nova.sum(y))
    np.testing.assert_allclose(y.numpy(), [function(v) for v in values], rtol=1e-6)
    np.testing.assert_allclose(x.grad.numpy(), [derivative(v) for v in values], rtol=1e-5)


def test_operators_and_functions_agree():
    a, b = nova.tensor([1.0, -2, 3]), nova.tensor([4.0, 5, -6])
    for operator, function, expected in [
        (a + b, nova.add(a, b), [5, 3, -3]),
        (a - b, nova.sub(a, b), [-3, -7, 9]),
        (a * b, nova.mul(a, b), [4, -10, -18]),
        (a / b, nova.div(a, b), [0.25, -0.4, -0.5]),
        (-a, nova.neg(a), [-1, 2, -3]),
        (abs(a), nova.abs(a), [1, 2, 3]),
        (a + 1, nova.add(a, 1), [2, -1, 4]),
        (2 - a, nova.sub(2, a), [1, 4, -1]),
        (a * 2, nova.mul(a, 2), [2, -4, 6]),
        (6 / a, nova.div(6, a), [6, -3, 2]),
        (a / 2, nova.div(a, 2), [0.5, -1, 1.5]),
        (nova.minimum(a, b), nova.min(a, b), [1, -2, -6]),
        (nova.maximum(a, b), nova.max(a, b), [4, 5, 3]),
    ]:
        np.testing.assert_allclose(operator.numpy(), np.float32(expected), rtol=1e-6)
        assert operator.tolist() == function.tolist()
    assert nova.clamp(a, -1, 2).tolist() == [1, -1, 2]
    assert nova.where(nova.tensor([1, 0, 1]), a, b).tolist() == [1, 5, 3]
    assert nova.sum(a).tolist() == [2] and nova.mean(a).item() == pytest.approx(2 / 3)
    assert nova.dot(a, b).item() == -24 and nova.norm(nova.tensor([3.0, 4])).item() == 5
    assert nova.sum_rows(nova.tensor([[1.0, 2], [3, 4]])).tolist() == [[4, 6]]
    assert (a * nova.tensor([2.0])).tolist() == [2, -4, 6]


def test_shapes_and_dtypes_of_operands_are_checked():
    a = nova.tensor([1.0, 2, 3])
    with pytest.raises(ValueError, match="add"):
        _ = a + nova.tensor([1.0, 2])
    with pytest.raises(TypeError, match="float32"):
        nova.sqrt(nova.tensor([1, 2]))
    with pytest.raises(ValueError, match="clamp"):
        nova.clamp(a, 1, 0)
    with pytest.raises(TypeError):
        nova.sqrt("a")
    with pytest.raises(ValueError):
        nova.sum_rows(a)


def test_gradients_through_a_formula_equal_those_by_hand():
    x = nova.tensor([0.3, 0.7], requires_grad=True)
    y = nova.tensor([1.1, -0.4], requires_grad=True)
    with nova.Tape() as tape:
        loss = nova.sum(nova.sin(x * y) + x / 2 - 3 * y)
        tape.backward(loss)
    xs, ys = x.numpy(), y.numpy()
    np.testing.assert_allclose(x.grad.numpy(), ys * np.cos(xs * ys) + 0.5, rtol=1e-6)
    np.testing.assert_allclose(y.grad.numpy(), xs * np.cos(xs * ys) - 3, rtol=1e-6)
    assert nova.gradcheck(lambda a, b: nova.sum(nova.sin(a * b)), [x, y])


def test_gradient_of_a_tensor_without_one_is_none():
    t = nova.tensor([1.0])
    assert t.grad is None and nova.tensor([1]).grad is None
    t.requires_grad = True
    assert t.grad.tolist() == [0]
    with pytest.raises(ValueError, match="float32"):
        nova.tensor([1]).requires_grad = True


def test_gradcheck_finds_a_wrong_gradient():
    x = nova.tensor([1.0, 2.0])

    def wrong(t):
        y = nova.tensor((t.numpy() ** 2).sum())
        if (tape := wrong.tape) is not None:
            tape.record_custom("wrong", [t], [y], lambda g: [t.detach()])
        return y

    wrong.tape = None
    result = nova.gradcheck(lambda t: nova.sum(t * t), [x])
    assert result and result.ok and result.max_rel_error < 1e-2 and "worst" in repr(result)
    assert x.tolist() == [1, 2]
    with pytest.raises(TypeError, match="Tensor"):
        nova.gradcheck(lambda t: 3.0, [x])
    with pytest.raises(ZeroDivisionError):
        nova.gradcheck(lambda t: 1 / 0, [x])


def test_gradcheck_leaves_its_inputs_as_they_were():
    x = nova.tensor([1.0, 2.0], requires_grad=True)
    y = nova.tensor([3.0])
    with nova.Tape() as tape:
        tape.backward(nova.sum(x * x))
    calls = []

    def breaks(a, b):
        calls.append(None)
        if len(calls) == 3:
            raise ArithmeticError
        return nova.sum(a * a) * b

    with pytest.raises(ArithmeticError):
        nova.gradcheck(breaks, [x, y])
    assert nova.gradcheck(lambda a, b: nova.sum(a * a) * b, [x, y])
    assert x.tolist() == [1, 2] and x.grad.tolist() == [2, 4] and x.requires_grad
    assert y.tolist() == [3] and not y.requires_grad
    with pytest.raises(ValueError, match="epsilon: expected a finite number > 0, got 0"):
        nova.gradcheck(lambda a: nova.sum(a), [x], epsilon=0.0)
    with pytest.raises(ValueError, match=r"inputs\[1\]: expected each input once"):
        nova.gradcheck(lambda a, b: nova.sum(a * b), [x, x])


def described(values, **changes):
    """An object whose memory is that of a NumPy array, described as CUDA memory is."""
    interface = {
        "shape": values.shape,
        "typestr": values.dtype.str,
        "data": (values.ctypes.data, False),
        "strides": values.strides,
        "version": 3,
        "stream": 1,
    }
    return SimpleNamespace(__cuda_array_interface__=interface | changes, memory=values)


def test_memory_that_an_array_interface_describes_is_shared():
    for values in (
        np.arange(6, dtype=np.float32).reshape(2, 3),
        np.arange(4, dtype=np.int32),
        np.zeros((0, 3), np.float32),
        np.arange(8, dtype=np.float32).reshape(4, 2)[:, :1][:1],  # strides of one row do not count
    ):
        tensor = nova.from_cuda_array_interface(described(values), device="cpu")
        assert tensor.shape == values.shape
        values += 1
        np.testing.assert_array_equal(tensor.numpy(), values)


def test_an_array_interface_that_cannot_be_shared_is_refused():
    values = np.arange(6, dtype=np.float32).reshape(2, 3)
    read_only = (values.ctypes.data, True)
    for error, match, obj in (
        (TypeError, "expected an object with __cuda_array_interface__, got list", [1, 2]),
        (TypeError, "expected float32 or int32, got <f8", described(values.astype(np.float64))),
        (ValueError, "expected packed rows, got strides", described(values.T)),
        (ValueError, "expected version 2 or 3 .*, got 1", described(values, version=1)),
        (ValueError, "expected no mask", described(values, mask=described(values))),
        (ValueError, "default stream .None or 1., got stream 2", described(values, stream=2)),
        (BufferError, "read-only", described(values, data=read_only)),
    ):
        with pytest.raises(error, match=match):
            nova.from_cuda_array_interface(obj, device="cpu")
