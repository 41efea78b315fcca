"""novaphy.torch: rollouts and losses as functions of PyTorch."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("novaphy.diff")
torch = pytest.importorskip("torch")

import novaphy.torch  # noqa: E402
from novaphy import diff, nova  # noqa: E402
from novaphy.solvers import DiffSemiImplicitSolver, DiffSolverConfig  # noqa: E402

STEPS, DT = 30, 5e-3


def springs() -> novaphy.Model:
    """Three particles on springs."""
    builder = novaphy.ModelBuilder()
    for x in (0.0, 0.5, 1.0):
        builder.add_particle(pos=(x, 0.0, 0.3), vel=(0.0, 0.0, 0.0), mass=1.0, radius=0.05)
    builder.add_spring(0, 1, ke=50.0, kd=1.0)
    builder.add_spring(1, 2, ke=50.0, kd=1.0)
    return builder.finalize()


def rollout(model: novaphy.Model):
    """The last positions and velocities, as a function of the first velocities."""
    solver = DiffSemiImplicitSolver(model, DiffSolverConfig(enable_springs=True))

    def run(velocity: nova.Tensor) -> tuple[nova.Tensor, nova.Tensor]:
        trajectory = diff.Trajectory(model, STEPS)
        diff.state_particle_qd_tensor(trajectory[0]).copy_(velocity)
        solver.rollout(trajectory, None, None, DT)
        last = trajectory[STEPS]
        return diff.state_particle_q_tensor(last), diff.state_particle_qd_tensor(last)

    return run


def test_a_rollout_trains_a_network_of_pytorch():
    run = novaphy.torch.wrap(rollout(springs()))
    torch.manual_seed(0)
    policy = torch.nn.Linear(3, 9)
    target = torch.tensor([[0.0, 0.0, 0.4], [0.6, 0.0, 0.5], [1.2, 0.0, 0.4]])
    optimizer = torch.optim.Adam(policy.parameters(), lr=0.05)
    losses = []
    for _ in range(25):
        optimizer.zero_grad()
        q, qd = run(policy(torch.ones(3)).reshape(3, 3))
        loss = ((q - target) ** 2).sum() + 0.01 * (qd**2).sum()
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
    assert losses[-1] < 0.5 * losses[0]


def test_gradients_are_those_of_differences():
    run = novaphy.torch.wrap(rollout(springs()))
    velocity = torch.randn(3, 3, generator=torch.Generator().manual_seed(1), requires_grad=True)
    assert torch.autograd.gradcheck(
        run, (velocity,), eps=1e-2, atol=2e-3, rtol=1e-2, nondet_tol=0.0
    )


def test_arrays_go_across_without_a_copy():
    seen = []

    def double(x: nova.Tensor) -> nova.Tensor:
        y = x * 2.0
        seen.extend([x.data_ptr, y.data_ptr])
        return y

    x = torch.arange(6, dtype=torch.float32).reshape(2, 3)
    y = novaphy.torch.wrap(double)(x)
    assert [x.data_ptr(), y.data_ptr()] == seen
    assert not y.requires_grad
    np.testing.assert_array_equal(y.numpy(), 2.0 * x.numpy())
    # A tensor that is not contiguous is copied, and the result is right.
    x.requires_grad_()
    z = novaphy.torch.wrap(double)(x.T)
    z.backward(torch.ones(3, 2))
    np.testing.assert_array_equal(z.detach().numpy(), 2.0 * x.detach().numpy().T)
    np.testing.assert_array_equal(x.grad.numpy(), np.full((2, 3), 2.0, np.float32))


def test_only_what_needs_a_gradient_gets_one_and_twice_is_twice():
    product = novaphy.torch.wrap(lambda a, b: nova.sum(a * b))
    a = torch.tensor([1.0, 2.0], requires_grad=True)
    b = torch.tensor([3.0, 5.0])
    loss = product(a, b)
    loss.backward(retain_graph=True)
    first = a.grad.clone()
    loss.backward()
    np.testing.assert_array_equal(first.numpy(), b.numpy())
    np.testing.assert_array_equal(a.grad.numpy(), 2.0 * b.numpy())
    assert b.grad is None
    with pytest.raises(NotImplementedError, match="expected one derivative"):
        torch.autograd.grad(product(a, b), a, create_graph=True)


def test_a_result_that_no_loss_reads_does_not_count():
    both = novaphy.torch.wrap(lambda a: (a * 2.0, a * a))
    a = torch.tensor([3.0], requires_grad=True)
    first, _ = both(a)
    first.backward()
    assert a.grad.item() == 2.0
    # An argument that no result depends on gets no gradient either.
    b = torch.tensor([1.0], requires_grad=True)
    novaphy.torch.wrap(lambda a, b: a * 3.0)(a, b).backward()
    assert a.grad.item() == 5.0
    assert b.grad is None or b.grad.item() == 0.0


def test_what_was_written_to_since_raises():
    square = novaphy.torch.wrap(lambda a: a * a)
    a = torch.tensor([3.0], requires_grad=True)
    b = a * 1.0
    result = square(b)
    b.add_(1.0)
    with pytest.raises(RuntimeError, match="modified by an inplace operation"):
        result.backward()


def test_wrong_arguments_are_named():
    run = novaphy.torch.wrap(lambda x: x * 2.0)
    with pytest.raises(TypeError, match="argument 0: expected torch.float32, got torch.float64"):
        run(torch.zeros(3, dtype=torch.float64))
    with pytest.raises(TypeError, match="argument 0: expected a torch tensor"):
        run(np.zeros(3, np.float32))
    with pytest.raises(TypeError, match="result 0: expected a nova.Tensor"):
        novaphy.torch.wrap(lambda x: [1.0])(torch.zeros(3))


@pytest.mark.skipif(not novaphy.has_cuda() or not torch.cuda.is_available(), reason="needs a GPU")
def test_on_a_gpu_it_is_the_same():
    x = torch.arange(4, dtype=torch.float32, device="cuda", requires_grad=True)
    novaphy.torch.wrap(lambda a: nova.sum(a * a))(x).backward()
    np.testing.assert_array_equal(x.grad.cpu().numpy(), [0.0, 2.0, 4.0, 6.0])


def test_results_that_do_not_depend_on_the_input_and_inputs_that_are_results():
    mixed = novaphy.torch.wrap(lambda x: (x * x, nova.ones((3,)), x, x.reshape(3, 1)))
    x = torch.tensor([1.0, 2.0, 3.0], requires_grad=True)
    for results, slope in (((0, 1), 2 * x), ((2,), 1 + 0 * x), ((0, 2, 3), 2 * x + 2)):
        x.grad = None
        sum(mixed(x)[k].sum() for k in results).backward()
        np.testing.assert_array_equal(x.grad.numpy(), slope.detach().numpy())
    x.grad = None
    mixed(x)[1].sum().backward()
    assert x.grad is None or (x.grad == 0).all()
    np.testing.assert_array_equal(mixed(x)[2].detach().numpy(), x.detach().numpy())
