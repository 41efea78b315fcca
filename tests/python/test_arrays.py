"""DeviceArray: construction, shapes, copies, rows, and exchange with NumPy in both directions."""

from __future__ import annotations

import gc

import numpy as np
import pytest

import novaphy
from novaphy import DeviceArray, nova

NUMPY = tuple(int(part) for part in np.__version__.split(".")[:2])

SHAPES = [
    ("float32", (5,), np.float32),
    ("int32", (5,), np.int32),
    ("uint32", (5,), np.uint32),
    ("uint8", (5,), np.uint8),
    ("uint64", (5,), np.uint64),
    ("vec2", (5, 2), np.float32),
    ("vec3", (5, 3), np.float32),
    ("vec4", (5, 4), np.float32),
    ("quat", (5, 4), np.float32),
    ("transform", (5, 7), np.float32),
    ("spatial_vector", (5, 6), np.float32),
    ("mat22", (5, 2, 2), np.float32),
    ("mat33", (5, 3, 3), np.float32),
    ("vec2i", (5, 2), np.int32),
    ("vec3i", (5, 3), np.int32),
    ("vec4i", (5, 4), np.int32),
]


@pytest.mark.parametrize(("name", "shape", "scalar"), SHAPES)
def test_every_dtype_has_its_numpy_shape_and_round_trips(name, shape, scalar):
    dtype = getattr(novaphy, name)
    values = np.arange(np.prod(shape), dtype=scalar).reshape(shape)
    array = DeviceArray(values, dtype=dtype)
    assert array.shape == shape and array.ndim == len(shape) and len(array) == 5
    assert array.dtype is dtype and array.scalar_dtype.numpy == scalar
    assert array.size == values.size and array.nbytes == values.nbytes
    assert array.strides == values.strides and array.is_contiguous
    assert str(array.device) == "cpu" and array.ptr != 0
    assert array.numpy().dtype == scalar
    np.testing.assert_array_equal(array.numpy(), values)
    assert DeviceArray.zeros(5, dtype).shape == shape
    assert DeviceArray.zeros(shape, dtype).shape == shape
    assert DeviceArray.empty(shape, name).shape == shape
    assert repr(array).startswith("DeviceArray([")
    assert repr(array).endswith(f"], shape={shape}, dtype={name}, device='cpu')")


def test_a_dtype_is_guessed_from_the_data():
    assert DeviceArray([1.0, 2.5]).dtype is novaphy.float32
    assert DeviceArray([1, 2]).dtype is novaphy.int32
    assert DeviceArray([True, False]).dtype is novaphy.uint8
    assert DeviceArray(np.uint64([1])).dtype is novaphy.uint64
    table = DeviceArray(np.zeros((4, 5), np.float32))
    assert table.dtype is novaphy.float32 and table.shape == (4, 5) and len(table) == 4
    assert DeviceArray(3.0).shape == (1,)
    assert DeviceArray((1, 2, 3), dtype=novaphy.vec3).shape == (1, 3)


def test_dtypes_are_described():
    assert novaphy.vec3.name == "vec3" and novaphy.vec3.shape == (3,)
    assert novaphy.mat33.shape == (3, 3) and novaphy.mat33.itemsize == 36
    assert novaphy.vec3i.scalar is novaphy.int32
    assert repr(novaphy.transform) == "novaphy.transform"


def test_full_fill_and_zero():
    array = DeviceArray.full(3, (1, 2, 3), novaphy.vec3)
    np.testing.assert_array_equal(array.numpy(), [[1, 2, 3]] * 3)
    assert array.fill_(4.0) is array
    np.testing.assert_array_equal(array.numpy(), np.full((3, 3), 4))
    assert array.zero_() is array
    assert not array.numpy().any()
    with pytest.raises(ValueError, match="fill_"):
        array.fill_((1.0, 2.0))


def test_the_version_rises_with_every_write_and_not_with_reads():
    array = DeviceArray.zeros(3)
    versions = [array.version]
    for write in (
        lambda: array.fill_(1.0),
        lambda: array.zero_(),
        lambda: array.assign([1, 2, 3]),
        lambda: array.__setitem__(0, 5.0),
        lambda: array.copy_from(DeviceArray([3.0, 2.0, 1.0])),
    ):
        write()
        versions.append(array.version)
    assert all(a < b for a, b in zip(versions, versions[1:]))
    array.numpy(), array.numpy(copy=False), array[0], np.asarray(array), array.clone()
    assert array.version == versions[-1]


def test_assign_takes_the_same_number_of_values_in_the_same_or_a_flat_shape():
    array = DeviceArray.zeros(1, novaphy.vec3)
    array.assign((1, 2, 3))
    np.testing.assert_array_equal(array.numpy(), [[1, 2, 3]])
    array.assign([[4, 5, 6]])
    array.assign(np.float32([7, 8, 9]))
    np.testing.assert_array_equal(array.numpy(), [[7, 8, 9]])
    two = DeviceArray.zeros(2, novaphy.vec3)
    two.assign(np.arange(6, dtype=np.float32))
    np.testing.assert_array_equal(two.numpy(), [[0, 1, 2], [3, 4, 5]])
    two.assign(DeviceArray(np.arange(6, dtype=np.float32)))
    for bad in ([1, 2], np.zeros((3, 2), np.float32), np.zeros((2, 4), np.float32), 1.0, []):
        with pytest.raises(ValueError, match=r"assign: expected shape \(2, 3\), got"):
            two.assign(bad)
    np.testing.assert_array_equal(two.numpy(), [[0, 1, 2], [3, 4, 5]])


def test_numbers_of_more_bits_are_rounded():
    array = DeviceArray.zeros(3)
    wide = np.array([0.1, 0.2, 1 / 3])
    for source in (wide, wide.tolist(), wide[:, None].T):
        array.zero_()
        array.assign(source)
        np.testing.assert_array_equal(array.numpy(), wide.astype(np.float32))
    assert DeviceArray(wide).dtype is novaphy.float32
    array[0:2] = np.float64([0.7, 0.9])
    np.testing.assert_array_equal(array[0:2], np.float32([0.7, 0.9]))
    array[0] = np.float64(0.3)
    assert array[0] == np.float32(0.3)
    array.fill_(np.array(0.1))
    assert array[2] == np.float32(0.1)


def test_arrays_of_other_types_are_converted():
    array = DeviceArray.zeros(2)
    array.assign(np.float16([0.5, 2]))
    array.assign(np.int16([-3, 7]))
    np.testing.assert_array_equal(array.numpy(), [-3, 7])
    array.assign(np.int64([1, 2**25 + 1]))
    np.testing.assert_array_equal(array.numpy(), [1, 2**25])
    with pytest.raises(TypeError, match="complex"):
        array.assign(np.array([1j, 2]))
    whole = DeviceArray.zeros(2, novaphy.int32)
    whole.assign(np.int64([1, -2]))
    np.testing.assert_array_equal(whole.numpy(), [1, -2])
    with pytest.raises(ValueError, match="expected values of int32"):
        whole.assign([1, 2**31])
    with pytest.raises(TypeError, match="expected int32, got float64"):
        whole.assign([1.5, 2])
    with pytest.raises(TypeError):
        whole.assign(np.float32([1, 2]))
    with pytest.raises((TypeError, ValueError)):
        array.assign(["a", "b"])
    with pytest.raises(ValueError):
        array.assign([[1, 2], [3]])
    np.testing.assert_array_equal(whole.numpy(), [1, -2])


def test_rows_are_read_and_written():
    array = DeviceArray(np.arange(12, dtype=np.float32).reshape(4, 3), dtype=novaphy.vec3)
    np.testing.assert_array_equal(array[1], [3, 4, 5])
    np.testing.assert_array_equal(array[-1], [9, 10, 11])
    np.testing.assert_array_equal(array[1:3], [[3, 4, 5], [6, 7, 8]])
    np.testing.assert_array_equal(array[::-2], [[9, 10, 11], [3, 4, 5]])
    row = array[0]
    row[:] = -1
    np.testing.assert_array_equal(array[0], [0, 1, 2])
    array[0] = (7, 8, 9)
    array[-1] = 0.5
    array[1:3] = [[1, 1, 1], [2, 2, 2]]
    np.testing.assert_array_equal(array.numpy(), [[7, 8, 9], [1, 1, 1], [2, 2, 2], [0.5, 0.5, 0.5]])
    assert [float(row[0]) for row in array] == [7, 1, 2, 0.5]
    for bad in (4, -5):
        with pytest.raises(IndexError, match="expected a row of 4"):
            array[bad]
        with pytest.raises(IndexError):
            array[bad] = 0
    for bad in ("a", 1.0, (0, 1), None, [0, 1]):
        with pytest.raises(TypeError):
            array[bad]
    with pytest.raises(ValueError):
        array[0] = (1, 2)
    scalar = DeviceArray([1.0, 2.0])[1]
    assert scalar == 2.0 and isinstance(scalar, np.float32)


def test_clone_and_to_copy():
    array = DeviceArray([1.0, 2.0])
    for copy in (array.clone(), array.to("cpu"), DeviceArray(array)):
        copy.fill_(5.0)
        np.testing.assert_array_equal(array.numpy(), [1, 2])
    with pytest.raises(novaphy.Error, match="cuda"):
        array.to("cuda:63")  # more GPUs than a machine has


def test_bad_shapes_and_dtypes_are_named():
    for shape, dtype, what in [
        ((2, 4), novaphy.vec3, "vec3"),
        ((), novaphy.float32, "shape"),
        (-1, novaphy.float32, "shape"),
        ((2, 2, 2), novaphy.float32, "shape"),
        ((2, 3), novaphy.uint8, "width"),
    ]:
        with pytest.raises(ValueError, match=what):
            DeviceArray.zeros(shape, dtype)
    with pytest.raises(ValueError, match="there is no vec5"):
        DeviceArray.zeros(2, "vec5")
    with pytest.raises(TypeError, match="float64"):
        DeviceArray.zeros(2, np.float64)
    with pytest.raises(TypeError):
        DeviceArray.zeros(2, object())
    with pytest.raises(ValueError, match="data: expected shape"):
        DeviceArray(np.zeros((2, 4), np.float32), dtype=novaphy.vec3)
    assert DeviceArray.zeros(2, np.float32).dtype is novaphy.float32


# ---------------------------------------------------------------------------- NumPy


def test_numpy_copies_unless_asked_not_to():
    array = DeviceArray([1.0, 2.0])
    copy = array.numpy()
    copy[0] = 9
    alias = array.numpy(copy=False)
    assert array[0] == 1 and not alias.flags.writeable
    array.fill_(3.0)
    np.testing.assert_array_equal(alias, [3, 3])
    with pytest.raises(ValueError):
        alias[0] = 1
    writable = array.numpy(copy=False, writable=True)
    writable[1] = 8
    np.testing.assert_array_equal(array.numpy(), [3, 8])
    assert alias.ctypes.data == array.ptr


def test_the_array_protocols_share_memory_read_only():
    array = DeviceArray(np.arange(6, dtype=np.float32).reshape(2, 3), dtype=novaphy.vec3)
    interface = array.__array_interface__
    assert interface["version"] == 3 and interface["shape"] == (2, 3)
    assert interface["data"] == (array.ptr, True) and interface["typestr"] == "<f4"
    alias = np.asarray(array)
    assert not alias.flags.writeable and alias.ctypes.data == array.ptr
    copied = np.array(array)
    copied[:] = 0
    np.testing.assert_array_equal(array.numpy(), [[0, 1, 2], [3, 4, 5]])
    assert array.__array__(np.float64).dtype == np.float64
    assert array.__array__(copy=False).ctypes.data == array.ptr
    assert array.__array__(None, copy=True).ctypes.data != array.ptr
    assert float(np.sum(array)) == 15.0
    with pytest.raises(AttributeError):
        _ = array.__cuda_array_interface__
    assert not hasattr(array, "__cuda_array_interface__")


def test_dlpack_to_numpy_shares_memory_read_only():
    array = DeviceArray(np.arange(6, dtype=np.float32).reshape(2, 3), dtype=novaphy.vec3)
    assert array.__dlpack_device__() == (1, 0)
    shared = np.from_dlpack(array)
    assert shared.ctypes.data == array.ptr and shared.shape == (2, 3)
    assert not shared.flags.writeable
    array.fill_(2.0)
    assert (shared == 2).all()
    if NUMPY >= (2, 1):
        copied = np.from_dlpack(array, copy=True)
        assert copied.ctypes.data != array.ptr


def test_dlpack_capsules_are_versioned_when_asked_for():
    array = DeviceArray([1.0])
    assert '"dltensor"' in repr(array.__dlpack__())
    assert '"dltensor_versioned"' in repr(array.__dlpack__(max_version=(1, 0)))
    assert '"dltensor"' in repr(array.__dlpack__(max_version=(0, 8)))
    with pytest.raises(BufferError):
        array.__dlpack__(dl_device=(2, 0))
    with pytest.raises(ValueError, match="stream"):
        array.__dlpack__(stream=1)


@pytest.mark.parametrize("scalar", [np.float32, np.int32, np.uint32, np.uint64, np.uint8])
def test_dlpack_from_numpy_shares_memory(scalar):
    values = np.arange(6, dtype=scalar)
    array = DeviceArray.from_dlpack(values)
    assert array.ptr == values.ctypes.data and array.shape == (6,)
    values[0] = 7
    assert array[0] == 7
    array[1] = 9
    assert values[1] == 9


def test_from_dlpack_takes_element_types_and_refuses_what_it_cannot_share():
    values = np.zeros((4, 3), np.float32)
    assert DeviceArray.from_dlpack(values, novaphy.vec3).dtype is novaphy.vec3
    assert DeviceArray.from_dlpack(values).shape == (4, 3)
    with pytest.raises(ValueError, match="packed"):
        DeviceArray.from_dlpack(values[:, :2])
    with pytest.raises(TypeError, match="from_dlpack"):
        DeviceArray.from_dlpack(np.zeros(3))
    with pytest.raises(TypeError, match="__dlpack__"):
        DeviceArray.from_dlpack([1, 2])
    with pytest.raises(ValueError):
        DeviceArray.from_dlpack(values, novaphy.vec2)
    read_only = np.zeros(3, np.float32)
    read_only.flags.writeable = False
    with pytest.raises((BufferError, TypeError)):
        DeviceArray.from_dlpack(read_only)


class WithoutFlags:
    """Knows version 1 of DLPack and answers in the older form, as JAX does."""

    def __init__(self, array):
        self.array = array

    def __dlpack__(self, **version):
        return self.array.__dlpack__()


def test_memory_whose_producer_cannot_say_that_it_may_be_written_is_copied_or_refused():
    immutable = WithoutFlags(DeviceArray([1.0, 2.0]))
    for take in (DeviceArray.from_dlpack, nova.from_dlpack):
        with pytest.raises(BufferError, match="does not say whether the memory may be written"):
            take(immutable)
        mine = take(immutable, copy=True)
        mine.fill_(5.0)
        assert mine.numpy().tolist() == [5.0, 5.0]
    assert immutable.array.numpy().tolist() == [1.0, 2.0]


def test_a_jax_array_stays_as_it_is():
    jnp = pytest.importorskip("jax.numpy")
    immutable = jnp.ones((2, 3))
    with pytest.raises(BufferError, match="copy=True"):
        nova.from_dlpack(immutable)
    nova.from_dlpack(immutable, copy=True).fill_(5.0)
    assert immutable.tolist() == [[1.0] * 3] * 2


def test_a_copy_of_own_or_foreign_memory_is_apart_from_it():
    own, foreign = DeviceArray([1.0]), np.float32([1.0])
    for source in (own, foreign):
        DeviceArray.from_dlpack(source, copy=True)[0] = 2.0
        nova.from_dlpack(source, copy=True).fill_(2.0)
        assert source[0] == 1.0


def test_exports_and_imports_keep_memory_alive():
    array = DeviceArray(np.arange(1000, dtype=np.float32))
    exports = [
        array.numpy(copy=False),
        np.asarray(array),
        np.from_dlpack(array),
        array.numpy(copy=False)[10:20],
    ]
    del array
    gc.collect()
    blocks = [DeviceArray(np.zeros(1000, np.float32)) for _ in range(8)]
    for export in exports[:3]:
        np.testing.assert_array_equal(export, np.arange(1000))
    np.testing.assert_array_equal(exports[3], np.arange(10, 20))
    del blocks

    values = np.arange(1000, dtype=np.float32)
    imported = DeviceArray.from_dlpack(values)
    del values
    gc.collect()
    reused = [np.zeros(1000, np.float32) for _ in range(8)]  # the memory, had it been freed
    np.testing.assert_array_equal(imported.numpy(), np.arange(1000))
    del reused


def test_an_export_outlives_its_model():
    builder = novaphy.ModelBuilder()
    builder.add_particles(np.full((100, 3), 2.0), np.zeros((100, 3)), [1.0] * 100)
    model = builder.finalize()
    state = model.state()
    alias, fields = state.particle_q.numpy(copy=False), model.particle_mass
    del model, state, builder
    gc.collect()
    assert (alias == 2).all() and (fields.numpy() == 1).all()


def test_empty_arrays_work():
    array = DeviceArray.zeros(0, novaphy.vec3)
    assert array.shape == (0, 3) and len(array) == 0 and array.nbytes == 0
    for values in (array.numpy(), array.numpy(copy=False), np.asarray(array), array[:]):
        assert values.shape == (0, 3)
    array.assign(np.zeros((0, 3), np.float32))
    array.fill_(1.0).zero_()
    assert array.clone().shape == (0, 3)
    with pytest.raises(IndexError):
        array[0]
