"""pickle, copy and deepcopy: the values come again, on memory of their own."""

from __future__ import annotations

import copy
import pickle
import subprocess
import sys

import numpy as np
import pytest

import novaphy
from novaphy.testing import assert_same_bits, assert_same_state

diff = pytest.importorskip("novaphy.diff")
nova = pytest.importorskip("novaphy.nova")

COPIES = {
    "pickle": lambda objects: pickle.loads(pickle.dumps(objects)),
    "deepcopy": copy.deepcopy,
}
SETTINGS = {"enable_springs": True, "enable_static_contacts": True}


@pytest.fixture(params=COPIES)
def again(request):
    return COPIES[request.param]


def spring_model() -> novaphy.Model:
    builder = novaphy.ModelBuilder(up_axis="y")
    builder.add_particles([(0, 0.05, 0), (0.5, 0.2, 0)], [(1, 0, 0), (0, 0, 1)], [1.0, 2.0])
    builder.add_spring(0, 1, 100.0, 1.0)
    builder.add_ground_plane(label="floor")
    a = builder.add_shape_sphere(-1, radius=0.5)
    builder.add_shape_collision_filter_pair(0, a)
    model = builder.finalize(requires_grad=True)
    model.soft_contact_ke = 3.0e4
    return model


def run(model, state, steps: int = 20):
    config = novaphy.solvers.DiffSolverConfig(**SETTINGS)
    solver = novaphy.solvers.DiffSemiImplicitSolver(model, config)
    other = model.state()
    for _ in range(steps):
        state.clear_forces()
        solver.step(state, other, None, None, 1e-3)
        state, other = other, state
    return state


def test_a_model_and_its_state_come_again_and_lead_to_the_same_bits(again):
    model = spring_model()
    state = run(model, model.state())
    model2, state2, control2 = again((model, state, model.control()))
    assert model2 is not model and repr(model2) == repr(model)
    assert model2.shape_label == ["floor", model.shape_label[1]]
    assert model2.shape_collision_filter_pairs == {(0, 1)} and model2.up_axis == 1
    assert model2.soft_contact_ke == 3.0e4 and model2.requires_grad and state2.requires_grad
    assert control2.particle_tri_activation.shape == (0,)
    for name in ("particle_q", "particle_inv_mass", "shape_transform", "gravity"):
        assert_same_bits(getattr(model2, name), getattr(model, name))
    assert_same_state(state2, state)
    assert_same_state(run(model2, state2), run(model, state))


def test_copies_share_no_memory(again):
    model = spring_model()
    state = model.state()
    model2, state2 = again((model, state))
    model2.particle_mass[0], state2.particle_q[0] = 5.0, (9, 9, 9)
    assert model.particle_mass[0] == 1.0 and state.particle_q[0][0] == 0.0


def test_a_state_of_another_model_still_does_not_fit(again):
    state = again(spring_model().state())
    model = spring_model()
    solver = novaphy.solvers.DiffSemiImplicitSolver(
        model, novaphy.solvers.DiffSolverConfig(**SETTINGS)
    )
    with pytest.raises(ValueError, match="state_in"):
        solver.step(state, model.state(), None, None, 1e-3)


def test_a_state_reaches_another_process(tmp_path):
    model = spring_model()
    (tmp_path / "objects").write_bytes(pickle.dumps((model, model.state())))
    code = f"""
import pickle
import novaphy
novaphy.ModelBuilder().finalize()  # a model of this process, which the other one must not meet
model, state = pickle.load(open({str(tmp_path / "objects")!r}, "rb"))
other = model.state()
novaphy.solvers.SolverSemiImplicit(model).step(state, other, None, None, 1e-3)
print(other.particle_q.numpy().tobytes().hex())
"""
    out = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120
    )
    state, other = model.state(), model.state()
    novaphy.solvers.SolverSemiImplicit(model).step(state, other, None, None, 1e-3)
    assert out.stdout.strip() == other.particle_q.numpy().tobytes().hex()


@pytest.mark.parametrize(
    ("dtype", "values"),
    [
        (novaphy.vec3, np.arange(6, dtype=np.float32).reshape(2, 3)),
        (novaphy.float32, np.arange(6, dtype=np.float32).reshape(2, 3)),
        (novaphy.int32, np.arange(3, dtype=np.int32)),
        (novaphy.mat33, np.zeros((0, 3, 3), np.float32)),
    ],
)
def test_arrays_come_again(again, dtype, values):
    array = novaphy.DeviceArray(values, dtype)
    copied = again(array)
    assert repr(copied) == repr(array) and copied.dtype.name == dtype.name
    assert_same_bits(copied, array)
    assert copied.ptr != array.ptr or not values.size


def test_settings_come_again(again):
    cfg = again(novaphy.ShapeConfig(ke=7.0, gap=0.5, is_visible=False))
    assert (cfg.ke, cfg.gap, cfg.is_visible, cfg.mu) == (7.0, 0.5, False, 1.0)
    config = again(novaphy.solvers.DiffSolverConfig(enable_springs=True, static_contact_margin=0.5))
    assert config.enable_springs and config.static_contact_margin == 0.5 and config.strict


def test_tensors_come_again(again):
    x = again(nova.tensor([[1.0, 2.0], [3.0, 4.0]], requires_grad=True))
    assert x.shape == (2, 2) and x.requires_grad and x.numpy().tolist() == [[1, 2], [3, 4]]
    i, none = again((nova.tensor([1, 2]), nova.zeros((0, 3))))
    assert i.dtype == nova.int32 and not i.requires_grad and none.shape == (0, 3)


def test_a_recorded_tensor_is_refused_because_its_copy_would_carry_no_gradient(again):
    x = nova.tensor([1.0, 2.0], requires_grad=True)
    with nova.Tape():
        y = x * x
        with pytest.raises(novaphy.Error, match=r"recorded operation; take t.detach\(\)"):
            again(y)
        assert again(y.detach()).numpy().tolist() == [1.0, 4.0]


def test_reprs_say_what_there_is():
    model = spring_model()
    assert repr(model) == (
        "Model(particle_count=2, shape_count=2, spring_count=1, world_count=1, device='cpu', "
        "requires_grad=True)"
    )
    assert repr(model.state(requires_grad=False)) == (
        "SimState(particle_count=2, shape_count=2, spring_count=1, world_count=1, device='cpu')"
    )
