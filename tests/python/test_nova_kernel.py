"""Kernels from traced Python functions, with their gradients."""

from __future__ import annotations

import gc
import re

import numpy as np
import pytest

import novaphy
from novaphy import diff, nova

F32, I32 = nova.float32, nova.int32


def make(fn, sources=(("x", F32),), outputs=1, name="test"):
    """A kernel of one source unless said otherwise."""
    return nova.make_indexed_kernel(name, list(sources), outputs, fn)


def test_a_kernel_computes_each_row_and_its_gradient():
    kernel = make(
        lambda c: tuple(c.f32("x", k) * c.f32("scale") + c.param(0) for k in range(3)),
        [("x", F32, 3), ("scale", F32, 1, "uniform")],
        3,
        "affine",
    )
    x = nova.tensor(np.arange(6, dtype=np.float32).reshape(2, 3), requires_grad=True)
    scale = nova.tensor([2.0], requires_grad=True)
    with nova.Tape() as tape:
        (y,) = kernel(2, [x, scale], params=[1.0])
        tape.backward(nova.sum(y))
    np.testing.assert_array_equal(y.numpy(), x.numpy() * 2 + 1)
    np.testing.assert_array_equal(x.grad.numpy(), np.full((2, 3), 2))
    assert scale.grad.item() == 15 and tape.op_names()[0] == "affine"
    assert kernel.name == "affine" and "affine" in kernel.source()
    assert repr(kernel) == "IndexedKernel('affine')"


def test_a_kernel_shows_its_c_text_and_its_program():
    kernel = make(lambda c: c.f32("x") * 0.5, name="half")
    text = kernel.source()
    assert text == kernel.source("c") and text.startswith("// half\n")
    assert "x: f32{1}, own row" in text and "* 0.5f;" in text
    assert kernel.source(form="program").startswith("program half")
    with pytest.raises(ValueError, match="source"):
        kernel.source("ptx")


def test_kernel_info_tells_how_each_kernel_runs():
    kernel = make(lambda c: c.f32("x") * 0.125, name="an_eighth")
    assert "an_eighth" not in [info.name for info in nova.kernel_info()]
    x = nova.tensor([1.0, 2.0])
    kernel(2, [x])
    (mine,) = [info for info in nova.kernel_info() if info.name == "an_eighth"]
    assert mine.how == "interpreter" and mine.hash == kernel.hash and mine.device == "cpu"
    assert (mine.isa, mine.lanes) in {("baseline", 4), ("avx2", 8), ("avx512", 16)}
    assert "an_eighth" in repr(mine) and "interpreter" in repr(mine)
    nova.tanh(x)
    (tanh,) = [info for info in nova.kernel_info() if info.name == "tanh"]
    native = novaphy.build_info()["NOVAPHY_WITH_NATIVE_KERNELS"]
    assert tanh.how == ("native" if native else "interpreter") and tanh.isa == mine.isa


def test_the_engine_programs_are_listed_by_hash():
    nova.tanh(nova.tensor([1.0]))
    (tanh,) = [info for info in nova.kernel_info() if info.name == "tanh"]
    programs = diff.engine_programs()
    assert programs[tanh.hash].startswith("program tanh\n")
    assert any(text.startswith("program step_particles.adjoint\n") for text in programs.values())


def test_equal_computations_have_equal_hashes():
    one = make(lambda c: c.f32("x") * 2 + 1)
    two = make(lambda c: c.f32(0) * np.float32(2) + 1.0, name="other")
    three = make(lambda c: c.f32("x") * 3 + 1)
    assert one.hash == two.hash != three.hash and 0 <= one.hash < 2**64


def test_several_outputs_have_names_and_shapes():
    kernel = make(
        lambda c: (c.f32("x"), -c.f32("x"), c.f32("x") ** 2), outputs=[("a", 1), ("b", 2)]
    )
    a, b = kernel(2, [nova.tensor([3.0, 4.0])])
    assert a.tolist() == [3, 4] and b.tolist() == [[-3, 9], [-4, 16]]


def test_select_takes_a_side_and_sends_the_gradient_there():
    kernel = make(lambda c: nova.select(c.f32("x") > 0.0, nova.log(c.f32("x")), 0.0))
    x = nova.tensor([-1.0, 0.0, 2.0], requires_grad=True)
    with nova.Tape() as tape:
        (y,) = kernel(3, [x])
        tape.backward(nova.sum(y))
    np.testing.assert_allclose(y.numpy(), [0, 0, np.log(2)], rtol=1e-6)
    assert x.grad.tolist() == [0, 0, 0.5]


def test_indexed_sources_gather_and_their_gradients_add_up():
    kernel = make(
        lambda c: c.f32("point", c.i32("edge", 0), 0) - c.f32("point", c.i32("edge", 1), 0),
        [("edge", I32, 2), ("point", F32, 1, "indexed")],
    )
    points = nova.tensor([1.0, 5.0, 7.0], requires_grad=True)
    edges = nova.tensor([[1, 0], [2, 1], [2, 0]])
    with nova.Tape() as tape:
        (d,) = kernel(3, [edges, points])
        tape.backward(nova.sum(d * d))
    assert d.tolist() == [4, 2, 6]
    np.testing.assert_allclose(points.grad.numpy(), [-8 - 12, 8 - 4, 4 + 12])


def test_a_sum_over_an_extent():
    kernel = nova.make_reduce_kernel(
        "sum",
        [("x", F32), ("w", F32, 1, "reduced")],
        1,
        lambda c: c.f32("x") * c.f32("w") + nova.to_real(c.reduce_index()),
        init=lambda c: c.param(0),
        epilogue=lambda c, sums: sums[0] * 2.0,
    )
    x = nova.tensor([1.0, 2.0], requires_grad=True)
    w = nova.tensor([3.0, 4.0, 5.0], requires_grad=True)
    with nova.Tape() as tape:
        (y,) = kernel(2, [x, w], params=[10.0], extent=3)
        tape.backward(nova.sum(y))
    assert y.tolist() == [2 * (10 + 12 + 3), 2 * (10 + 24 + 3)]
    assert x.grad.tolist() == [24, 24] and w.grad.tolist() == [6, 6, 6]
    assert kernel(2, [x, w], params=[0.0], extent=1)[0].tolist() == [6, 12]
    with pytest.raises(ValueError, match="w"):
        kernel(2, [x, w], params=[0.0], extent=4)


def test_a_sum_over_the_rows_of_an_incidence():
    table = nova.tensor([1, 0, 1, -1, 1])
    incidence = nova.make_incidence(table, 3)
    assert incidence.rows == 3 and incidence.offsets.tolist() == [0, 1, 4, 4]
    assert incidence.items.tolist()[:4] == [1, 0, 2, 4]
    kernel = nova.make_reduce_kernel("rows", [("v", F32, 1, "csr_row")], 1, lambda c: c.f32("v"))
    v = nova.tensor([1.0, 2, 4, 8, 16], requires_grad=True)
    with nova.Tape() as tape:
        (y,) = kernel(3, [v], csr=incidence)
        tape.backward(nova.sum(y * y))
    assert y.tolist() == [2, 21, 0] and v.grad.tolist() == [42, 4, 42, 0, 42]
    with pytest.raises(ValueError, match="csr"):
        kernel(3, [v])
    with pytest.raises(IndexError):
        nova.make_incidence(nova.tensor([0, 3]), 3)
    with pytest.raises(TypeError, match="int32"):
        nova.make_incidence(nova.tensor([0.0]), 3)


def test_an_incidence_is_rebuilt_in_place_and_inside_of_a_capture():
    table, v = nova.tensor([1, 0, 1]), nova.tensor([1.0, 2, 4])
    rows = nova.make_incidence(table, 2)
    total = nova.make_reduce_kernel("rows", [("v", F32, 1, "csr_row")], 1, lambda c: c.f32("v"))
    with nova.ScopedCapture() as capture:
        rows.rebuild()
        (y,) = total(2, [v], csr=rows)
    for slots, expected in (([0, 0, -1], [3, 0]), ([-1, 1, 0], [4, 2])):
        table.copy_(nova.tensor(slots))
        capture.graph.launch()
        assert y.tolist() == expected
    table.copy_(nova.tensor([0, 2, 1]))
    with pytest.raises(IndexError, match="slot 1 holds row 2 of 2 rows"):
        rows.rebuild()


def test_a_launch_reads_how_many_of_its_rows_are_active():
    square = make(lambda c: c.f32("x") * c.f32("x"), [("x", F32)], 1)
    x, count = nova.tensor([1.0, 2, 3, 4], requires_grad=True), nova.tensor([2])
    with nova.Tape() as tape:
        (y,) = square(4, [x], active=count)
        tape.backward(nova.sum(y))
    assert y.tolist() == [1, 4, 0, 0] and x.grad.tolist() == [2, 4, 0, 0]
    with pytest.raises(ValueError, match=re.escape("active: expected {1} int32, got {2} int32")):
        square(4, [x], active=nova.tensor([1, 2]))


def test_numbers_of_integers_and_truth_values():
    def fn(c):
        i = c.index()
        even = (i & 1) == 0
        big = (i >= 2) & ~(i == 3) | (i < 1)
        return (
            nova.select(even, 1.0, -1.0),
            nova.to_real(nova.select(big, i * 10 + 1, -i)),
            nova.to_real(nova.max(i, 2) + nova.min(3, i) - (i << 1) + (i >> 1) + (i ^ 1) + (i | 4)),
            nova.to_real(nova.idiv(i + 7, 3) + nova.imod(i + 7, 3) * 100 + (1 + i) * (5 - i)),
        )

    (y,) = make(fn, [("x", F32)], 4)(5, [nova.zeros(5)])
    rows = range(5)
    values = y.numpy()
    assert values[:, 0].tolist() == [1, -1, 1, -1, 1]
    assert values[:, 1].tolist() == [1, -1, 21, -3, 41]
    expected = [max(i, 2) + min(3, i) - (i << 1) + (i >> 1) + (i ^ 1) + (i | 4) for i in rows]
    assert values[:, 2].tolist() == expected
    expected = [(i + 7) // 3 + (i + 7) % 3 * 100 + (1 + i) * (5 - i) for i in rows]
    assert values[:, 3].tolist() == expected


REAL = {
    "sqrt": (nova.sqrt, np.sqrt),
    "exp": (nova.exp, np.exp),
    "log": (nova.log, np.log),
    "sin": (nova.sin, np.sin),
    "cos": (nova.cos, np.cos),
    "tan": (nova.tan, np.tan),
    "tanh": (nova.tanh, np.tanh),
    "asin": (nova.asin, np.arcsin),
    "acos": (nova.acos, np.arccos),
    "rsqrt": (nova.rsqrt, lambda x: 1 / np.sqrt(x)),
    "floor": (nova.floor, np.floor),
    "sign": (nova.sign, np.sign),
    "abs": (abs, np.abs),
    "atan2": (lambda x: nova.atan2(x, 0.5), lambda x: np.arctan2(x, 0.5)),
    "pow": (lambda x: x**1.5, lambda x: x**1.5),
    "square": (lambda x: x**2, lambda x: x**2),
    "inverse cube": (lambda x: x**-3, lambda x: x**-3.0),
    "zeroth": (lambda x: x**0, lambda x: x**0),
    "base": (lambda x: 2**x, lambda x: 2**x),
    "fma": (lambda x: nova.fma(x, 2, 1), lambda x: 2 * x + 1),
    "clamp": (lambda x: nova.clamp(x, 0.3, 0.6), lambda x: np.clip(x, 0.3, 0.6)),
    "min": (lambda x: nova.min(x, 0.5), lambda x: np.minimum(x, 0.5)),
    "max": (lambda x: nova.maximum(0.5, x), lambda x: np.maximum(x, 0.5)),
    "mixed": (lambda x: 1 - x / 3 + 2 / x - (+x), lambda x: 1 - x / 3 + 2 / x - x),
}


@pytest.mark.parametrize("name", REAL)
def test_functions_of_traced_values(name):
    function, reference = REAL[name]
    x = np.float32([0.125, 0.4, 0.75, 0.9])
    (y,) = make(lambda c: function(c.f32("x")))(4, [nova.tensor(x)])
    np.testing.assert_allclose(y.numpy(), reference(x.astype(np.float64)), rtol=2e-6, atol=1e-7)


def test_derivatives_can_be_declared():
    kernel = make(
        lambda c: nova.with_derivative(nova.detach(c.f32("x") * c.f32("x")), c.f32("x"), 7.0)
    )
    x = nova.tensor([3.0], requires_grad=True)
    with nova.Tape() as tape:
        (y,) = kernel(1, [x])
        tape.backward(nova.sum(y))
    assert y.item() == 9 and x.grad.item() == 7


@pytest.mark.parametrize(
    "fn",
    [
        lambda c: 1.0 if c.f32("x") > 0 else 0.0,
        lambda c: (c.f32("x") > 0 and c.f32("x") < 1) or 0.0,
        lambda c: 1.0 if 0 < c.f32("x") < 1 else 0.0,
        lambda c: 1.0 if c.f32("x") else 0.0,
        lambda c: 1.0 if not c.index() else 0.0,
        lambda c: max(c.f32("x"), 1.0),
    ],
)
def test_a_python_decision_on_a_traced_value_is_refused_with_advice(fn):
    with pytest.raises(TypeError, match=r"nova\.select"):
        make(fn)


def test_bad_functions_are_refused():
    for fn, error, message in [
        (lambda c: None, TypeError, "expected Real values, got NoneType"),
        (lambda c: "a", TypeError, "expected Real"),
        (lambda c: c.index(), TypeError, "Int"),
        (lambda c: (c.f32("x"), c.f32("x")), ValueError, "returned 2 values, expected 1"),
        (lambda c: (), ValueError, "returned fewer"),
        (lambda c: c.f32("y"), ValueError, "no source 'y'"),
        (lambda c: c.f32(1), IndexError, "source"),
        (lambda c: c.f32(-1), IndexError, "source"),
        (lambda c: c.f32("x", 1), IndexError, "column"),
        (lambda c: c.i32("x"), TypeError, "float32"),
        (lambda c: c.f32("x") + c.index(), TypeError, "unsupported operand"),
        (lambda c: c.f32("x") + "a", TypeError, "unsupported operand"),
        (lambda c: c.reduce_index(), ValueError, "reduce_index"),
        (lambda c: 1 / 0, ZeroDivisionError, "division"),
        (lambda: 1.0, TypeError, "argument"),
    ]:
        with pytest.raises(error, match=message):
            make(fn)
    assert make(lambda c: 3)(2, [nova.zeros(2)])[0].tolist() == [3, 3]


def test_bad_sources_and_outputs_are_refused():
    for sources, outputs, error in [
        ([("x",)], 1, ValueError),
        ([("x", F32, 0)], 1, ValueError),
        ([("x", F32, 1, "sideways")], 1, ValueError),
        ([("x", F32, 1, 3)], 1, TypeError),
        ([("x", novaphy.vec3)], 1, TypeError),
        (["x"], 1, TypeError),
        ([("x", F32, 1, "reduced")], 1, ValueError),
        ([("x", F32)], 0, ValueError),
        ([("x", F32)], [("a",)], (TypeError, ValueError, RuntimeError)),
    ]:
        with pytest.raises(error):
            nova.make_indexed_kernel("bad", sources, outputs, lambda c: 1.0)


def test_widths_are_exact():
    kernel = make(lambda c: c.f32("x", 2), [("x", F32, 3)])
    for bad in (nova.zeros((5, 4)), nova.zeros((4, 3)), nova.zeros(15), nova.zeros((5, 2))):
        with pytest.raises(ValueError, match=r"x: expected \{5, 3\} tightly packed float32, got"):
            kernel(5, [bad])
    with pytest.raises(TypeError, match="expected float32, got int32"):
        kernel(5, [nova.zeros((5, 3), I32)])
    with pytest.raises(ValueError, match="expected 1 inputs, got 2"):
        kernel(5, [nova.zeros((5, 3))] * 2)
    with pytest.raises(TypeError):
        kernel(5, [np.zeros((5, 3), np.float32)])
    with pytest.raises(ValueError, match="dim"):
        kernel(-1, [nova.zeros((0, 3))])
    assert kernel(0, [nova.zeros((0, 3))])[0].shape == (0,)


def test_parameters_are_checked():
    kernel = make(lambda c: c.f32("x") * c.param(0) + nova.to_real(c.param_i32(1)))
    x = nova.ones(2)
    assert kernel(2, [x], (2, 3))[0].tolist() == [5, 5]
    assert kernel(2, [x], [np.float32(2), np.int64(3)])[0].tolist() == [5, 5]
    for params, error in [
        ((2,), ValueError),
        ((2, 3.5), TypeError),
        (("a", 1), TypeError),
        ((1, 2, 3), ValueError),
    ]:
        with pytest.raises(error):
            kernel(2, [x], params)


def test_traced_values_do_not_outlive_the_trace():
    kept = []

    def fn(c):
        kept.extend([c, c.f32("x")])
        return c.f32("x")

    make(fn)
    gc.collect()
    with pytest.raises(novaphy.Error, match="the kernel is made"):
        kept[0].f32("x")
    with pytest.raises((novaphy.Error, TypeError)):
        _ = kept[1] + 1.0
    with pytest.raises((novaphy.Error, TypeError)):
        nova.Real(1.0)


def test_a_failed_trace_leaves_no_trace_behind():
    with pytest.raises(ZeroDivisionError):
        make(lambda c: c.f32("x") / 0 * (1 / 0))
    assert make(lambda c: c.f32("x") + 1)(1, [nova.ones(1)])[0].tolist() == [2]


def test_a_kernel_made_while_another_one_is_traced():
    def outer(c):
        make(lambda inner: inner.f32("x") * 5, name="inner")
        return c.f32("x") * 2

    assert make(outer)(1, [nova.ones(1)])[0].tolist() == [2]


INF, NAN = float("inf"), float("nan")
# The edge cases of docs/coverage.md: x, value, derivative.
EDGES = {
    "sqrt": (nova.sqrt, [(0, 0, 0), (-1, NAN, 0)]),
    "rsqrt": (nova.rsqrt, [(0, INF, 0), (-1, NAN, 0)]),
    "log": (nova.log, [(0, -INF, INF), (-2, NAN, -0.5)]),
    "asin": (nova.asin, [(1, np.pi / 2, 0), (1.5, np.pi / 2, 0), (-1.5, -np.pi / 2, 0)]),
    "acos": (nova.acos, [(1, 0, 0), (1.5, 0, 0), (-1.5, np.pi, 0)]),
    "abs": (nova.abs, [(0, 0, 1)]),
    "sign": (nova.sign, [(0, 1, 0), (-2, -1, 0)]),
    "floor": (nova.floor, [(1, 1, 0), (1.5, 1, 0)]),
    "x ** 2": (lambda x: x**2, [(-3, 9, -6), (0, 0, 0)]),
    "x ** 0.5": (lambda x: x**0.5, [(0, 0, INF), (-1, NAN, NAN)]),
    "pow(x, 2)": (lambda x: nova.pow(x, 2.0 + 0.0 * x), [(0, 0, 0), (-3, 9, NAN)]),
    "pow(x, 2.5)": (lambda x: nova.pow(x, 2.5 + 0.0 * x), [(0, 0, 0), (-1, NAN, NAN)]),
    "select": (lambda x: nova.select(x > 0.0, nova.log(x), x), [(-1, -1, 1), (0, 0, 1)]),
}


@pytest.mark.parametrize("function", EDGES)
def test_functions_at_kinks_and_outside_of_their_domains_are_as_the_table_says(function):
    trace, rows = EDGES[function]
    kernel = nova.make_indexed_kernel("edge", [("x", nova.float32)], 1, lambda c: trace(c.f32("x")))
    x = nova.tensor(np.float32([row[0] for row in rows]), requires_grad=True)
    with nova.Tape() as tape:
        (y,) = kernel(len(rows), [x])
        tape.backward(y, nova.ones(y.shape))
    assert np.allclose(y.numpy().ravel(), [row[1] for row in rows], equal_nan=True)
    assert np.allclose(x.grad.numpy(), [row[2] for row in rows], equal_nan=True)


def test_a_negative_row_reads_0_and_passes_no_gradient():
    kernel = nova.make_indexed_kernel(
        "gather",
        [("row", nova.int32), ("value", nova.float32, 1, "indexed")],
        1,
        lambda c: c.f32("value", c.i32("row"), 0),
    )
    value = nova.tensor([5.0, 7.0], requires_grad=True)
    with nova.Tape() as tape:
        (out,) = kernel(3, [nova.tensor([1, -1, -7]), value])
        tape.backward(nova.sum(out))
    assert out.numpy().ravel().tolist() == [7.0, 0.0, 0.0]
    assert value.grad.numpy().tolist() == [0.0, 1.0]
    with pytest.raises(IndexError, match="row i = 1 reads row 5 of source .value., which has 2"):
        kernel(2, [nova.tensor([-1, 5]), value])[0].numpy()


def test_what_says_over_what_a_kernel_sums_is_given_where_it_does_and_only_there():
    x, u = nova.tensor([1.0, 2.0, 4.0, 8.0]), nova.tensor([3.0])
    table = nova.make_incidence(nova.tensor(np.int32([0, 1, 1, 0])), 2)
    plain = make(lambda c: c.f32("x"), name="plain")
    fixed = nova.make_reduce_kernel("fixed", [("u", F32, 1, "uniform")], 1, lambda c: c.f32("u"))
    csr = nova.make_reduce_kernel("csr", [("x", F32, 1, "csr_row")], 1, lambda c: c.f32("x"))
    assert plain(4, [x])[0].tolist() == x.tolist()
    assert fixed(2, [u], extent=2)[0].tolist() == [6.0, 6.0]
    assert fixed(2, [u], extent=0)[0].tolist() == [0.0, 0.0]
    assert csr(2, [x], csr=table)[0].tolist() == [9.0, 6.0]
    for call, message in (
        (lambda: fixed(2, [u], csr=table), "fixed, csr: expected none, because no source"),
        (lambda: fixed(2, [u], extent=2, csr=table), "fixed, csr: expected none"),
        (lambda: fixed(2, [u]), "fixed, extent: expected the number of items.*got none"),
        (lambda: fixed(2, [u], extent=-3), "fixed, extent: expected the number.*got -3"),
        (lambda: csr(2, [x], csr=table, extent=4), "csr, extent: expected none, because the sum"),
        (lambda: csr(2, [x]), "csr, csr: expected an Incidence of 2 rows, got none"),
        (lambda: csr(3, [x], csr=table), "csr, csr: expected an Incidence of 3 rows, got 2"),
        (
            lambda: plain(4, [x], extent=4),
            "plain, extent: expected none, because the kernel has no",
        ),
        (lambda: plain(4, [x], csr=table), "plain, csr: expected none, because the kernel has no"),
    ):
        with pytest.raises(ValueError, match=message):
            call()
