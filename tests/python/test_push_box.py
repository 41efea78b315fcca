"""The box that a sphere pushes: against NumPy in double, closed forms, and its rollout."""

from __future__ import annotations

import numpy as np
import pytest

import novaphy

pytestmark = pytest.mark.skipif(not novaphy.has_diff(), reason="needs NOVAPHY_WITH_DIFF")

NUMBERS = {
    "mass": 0.5,
    "half_extent": 0.05,
    "pusher_radius": 0.02,
    "ke": 2e3,
    "kd": 5.0,
    "friction": 0.3,
    "dt": 1e-3,
    "softness": 1e-3,
    "friction_velocity": 1e-2,
    "gravity": 9.81,
}
STATES = ("box_x", "box_v", "pusher_x", "pusher_v")
# Far, near, touching and deep; closing, parting and at rest.
CASES = [
    (gap, box_v, pusher_v)
    for gap in (0.2, 4e-3, 2e-4, -1e-3)
    for box_v, pusher_v in ((0.0, 0.0), (0.2, 0.35), (0.3, 0.28), (-0.004, 0.01))
]


def reference(box_x, box_v, pusher_x, pusher_v, n):
    """One step of the law, transcribed in double precision."""

    def softplus(z):
        return np.maximum(z, 0.0) + np.log1p(np.exp(-np.abs(z)))

    s, vs = n["softness"], n["friction_velocity"]
    z = -(box_x - n["half_extent"] - n["pusher_radius"] - pusher_x) / s
    touch = 1.0 / (1.0 + np.exp(-z)) if z > -700 else 0.0
    normal = n["ke"] * s * softplus(z)
    normal += n["kd"] * touch * vs * softplus((pusher_v - box_v) / vs)
    friction = -n["friction"] * n["mass"] * n["gravity"] * np.tanh(box_v / vs)
    v = box_v + n["dt"] * (normal + friction) / n["mass"]
    return box_x + n["dt"] * v, v


def start(gap, box_v, pusher_v):
    """The four states as float32, for a gap between box and pusher."""
    box_x = np.float32(0.55)
    pusher_x = np.float32(0.55 - 0.05 - 0.02 - gap)
    return [float(np.float32(x)) for x in (box_x, box_v, pusher_x, pusher_v)]


def tensors(values, grad=True):
    """Tensors {1} that carry gradients."""
    from novaphy import nova

    return [nova.tensor([v], requires_grad=grad) for v in values]


def rounded():
    """The numbers as float32 has them."""
    return {name: float(np.float32(value)) for name, value in NUMBERS.items()}


def step(states, numbers):
    """One step, the last three numbers by keyword."""
    from novaphy.diff import integrate_push_box_generated

    return integrate_push_box_generated(*states, **numbers)


@pytest.mark.parametrize("case", CASES)
def test_a_step_is_the_law(case):
    values = start(*case)
    x, v = step(tensors(values), NUMBERS)
    expected = reference(*values, rounded())
    assert x.shape == v.shape == (1,)
    assert x.item() == pytest.approx(expected[0], abs=1e-7)
    # The gap is a difference of float32 numbers: 6e-8 m, at ke dt / m = 4 1/s.
    assert v.item() == pytest.approx(expected[1], abs=4e-7, rel=1e-5)


@pytest.mark.parametrize("case", CASES)
def test_every_gradient_is_the_difference_quotient(case):
    from novaphy import nova

    values, numbers = start(*case), rounded()
    states = tensors(values)
    params = dict(zip(numbers, tensors(numbers.values()), strict=True))
    with nova.Tape() as tape:
        x, v = step(states, params)
        loss = nova.sum(3.0 * x + 2.0 * v)
    tape.backward(loss)

    def of(values, numbers):
        x, v = reference(*values, numbers)
        return 3.0 * x + 2.0 * v

    for k, name in enumerate(STATES):
        eps = 1e-6
        ends = []
        for sign in (1.0, -1.0):
            moved = list(values)
            moved[k] += sign * eps
            ends.append(of(moved, numbers))
        fd = (ends[0] - ends[1]) / (2 * eps)
        assert states[k].grad.item() == pytest.approx(fd, rel=3e-4, abs=1e-5), name
    for name, tensor in params.items():
        eps = 1e-4 * numbers[name]
        up, down = (of(values, numbers | {name: numbers[name] + s * eps}) for s in (1.0, -1.0))
        fd = (up - down) / (2 * eps)
        assert tensor.grad.item() == pytest.approx(fd, rel=1e-3, abs=1e-5), name


def test_tangent_and_adjoint_belong_together():
    from novaphy import nova
    from novaphy.diff import integrate_push_box_rollout_generated

    rng = np.random.default_rng(3)
    n = 60
    pusher = np.float32(0.482 + 0.3e-3 * np.arange(n))
    for rollout in (False, True):
        rows = n if rollout else 1
        values = start(-2e-4, 0.1, 0.3)
        states = tensors(values[:2])
        states.append(nova.tensor(pusher[:rows], requires_grad=True))
        states.append(nova.tensor(np.full(rows, 0.3, np.float32), requires_grad=True))
        params = tensors(rounded().values())
        given = dict(zip(NUMBERS, params, strict=True))
        run = integrate_push_box_rollout_generated if rollout else None
        with nova.Tape() as tape:
            x, v = run(*states, **given) if run else step(states, given)
        inputs = states + params
        # In the size of each, so that no product hides the others.
        tangents = [
            nova.tensor(np.float32(rng.normal(size=t.shape) * np.abs(t.numpy()))) for t in inputs
        ]
        seeds = [np.float32(rng.normal(size=x.shape)) for _ in range(2)]
        tx, tv = tape.jvp([x, v], inputs, tangents)
        left = float(np.dot(seeds[0], tx.numpy()) + np.dot(seeds[1], tv.numpy()))
        for out, seed in zip((x, v), seeds, strict=True):
            tape.backward(out, nova.tensor(seed))
        terms = [
            float(np.dot(t.grad.numpy().astype(np.float64), d.numpy()))
            for t, d in zip(inputs, tangents, strict=True)
        ]
        scale = max(abs(t) for t in terms)
        assert sum(terms) == pytest.approx(left, abs=2e-5 * scale)


def test_a_captured_tangent_of_a_rollout_is_that_of_the_inputs_of_the_launch():
    from novaphy import nova
    from novaphy.diff import integrate_push_box_rollout_generated

    states = tensors(start(-2e-4, 0.1, 0.3)[:2])
    pusher = nova.tensor(np.float32(0.482 + 0.3e-3 * np.arange(60)), requires_grad=True)
    speed = nova.tensor(np.full(60, 0.3, np.float32))
    along = nova.tensor(np.ones(60, np.float32))

    def once():
        with nova.Tape() as tape:
            x, _ = integrate_push_box_rollout_generated(*states, pusher, speed, **NUMBERS)
            return tape.jvp([nova.sum(x)], [pusher], [along])[0]

    with nova.ScopedCapture() as capture:
        slope = once()
    for shift in (0.0, 2e-3):
        pusher.assign(pusher.numpy() + np.float32(shift))
        capture.graph.launch()
        assert slope.item() == once().item() > 0


def test_without_contact_it_slides_to_rest_by_friction_alone():
    from novaphy import nova

    states = tensors(start(0.3, 0.4, 0.0))
    first = states[0].item()
    with nova.Tape() as tape:
        x, v = states[0], states[1]
        for _ in range(300):
            x, v = step((x, v, states[2], states[3]), NUMBERS)
    # Coulomb's distance v0^2 / (2 mu g), with friction less than full below 0.01 m/s:
    # the integral of v / tanh(v / v_s) instead of that of v.
    speeds = np.linspace(1e-9, 0.4, 200001)
    rate = 0.3 * 9.81 * np.tanh(speeds / 0.01)
    mid = 0.5 * (speeds[1:] + speeds[:-1])
    distance = float(np.sum(mid / (0.3 * 9.81 * np.tanh(mid / 0.01))) * (speeds[1] - speeds[0]))
    assert rate[-1] > 2.9
    assert x.item() - first == pytest.approx(distance, abs=4e-4)
    assert 0.0 <= v.item() < 1e-9
    tape.backward(x)
    # Without contact the gradients with respect to the pusher and its numbers are exactly 0.
    assert states[2].grad.item() == 0.0
    assert states[3].grad.item() == 0.0
    # dx/dv0 = v0 / (mu g) of the distance above; the steps are half a step short.
    assert states[1].grad.item() == pytest.approx(0.4 / (0.3 * 9.81) - 0.5e-3, rel=2e-4)
    assert states[0].grad.item() == 1.0


def test_pushed_at_constant_speed_the_contact_carries_the_friction():
    speed, dt = 0.2, 1e-3
    values = start(0.0, speed, speed)
    x, v = tensors(values[:2], grad=False)
    for t in range(4000):
        pusher = tensors([values[2] + speed * dt * (t + 1), speed], grad=False)
        before = x.item()
        x, v = step((x, v, *pusher), NUMBERS)
    assert v.item() == pytest.approx(speed, abs=1e-5)
    depth = 0.05 + 0.02 + pusher[0].item() - before
    s, ke, kd, vs = (NUMBERS[k] for k in ("softness", "ke", "kd", "friction_velocity"))
    normal = ke * s * np.log1p(np.exp(depth / s))
    normal += kd / (1.0 + np.exp(-depth / s)) * vs * np.log(2.0)
    assert normal == pytest.approx(0.3 * 0.5 * 9.81 * np.tanh(speed / vs), rel=1e-3)


def test_a_rollout_is_its_steps():
    from novaphy import nova
    from novaphy.diff import integrate_push_box_rollout_generated

    n = 1000
    time = 1e-3 * np.arange(1, n + 1)
    pusher_x = np.float32(0.40 + 0.18 * np.sin(1.2 * time) ** 2)
    pusher_v = np.float32(0.18 * 1.2 * np.sin(2.4 * time))
    gradients = []
    for rollout in (False, True):
        x0, v0 = tensors((0.55, 0.0))
        px, pv = (nova.tensor(p, requires_grad=True) for p in (pusher_x, pusher_v))
        params = dict(zip(NUMBERS, tensors(NUMBERS.values()), strict=True))
        with nova.Tape() as tape:
            if rollout:
                xs, vs = integrate_push_box_rollout_generated(x0, v0, px, pv, **params)
                assert tape.size == 1
                x, v = xs[n - 1 :], vs[n - 1 :]
            else:
                x, v, path = x0, v0, []
                for t in range(n):
                    x, v = step((x, v, px[t : t + 1], pv[t : t + 1]), params)
                    path.append((x.item(), v.item()))
            loss = nova.sum((x - 0.7) * (x - 0.7) + 0.01 * v * v)
        tape.backward(loss)
        if rollout:
            np.testing.assert_array_equal(np.stack([xs.numpy(), vs.numpy()], 1), np.float32(path))
        inputs = [x0, v0, px, pv, *params.values()]
        gradients.append(np.concatenate([t.grad.numpy() for t in inputs]))
    assert path[-1][0] > 0.56
    scale = np.abs(gradients[0]).max()
    np.testing.assert_allclose(gradients[1], gradients[0], rtol=2e-4, atol=1e-6 * scale)
    again = integrate_push_box_rollout_generated(x0, v0, px, pv, **params)
    np.testing.assert_array_equal(again[0].numpy(), xs.numpy())


def test_a_captured_rollout_replays():
    from novaphy import nova
    from novaphy.diff import integrate_push_box_rollout_generated

    x0, v0 = tensors((0.55, 0.0))
    px = nova.tensor(np.float32(np.linspace(0.47, 0.50, 50)), requires_grad=True)
    pv = nova.tensor(np.full(50, 0.6, np.float32))
    with nova.ScopedCapture() as capture, nova.Tape() as tape:
        xs, _ = integrate_push_box_rollout_generated(x0, v0, px, pv, **NUMBERS)
        tape.backward(xs, nova.ones((50,)))
        tape.zero()
        tape.backward(xs, nova.ones((50,)))
    capture.graph.launch()
    first, grad = xs.numpy(), px.grad.numpy()
    assert np.any(grad != 0.0)
    px.assign(px.numpy() + np.float32(1e-3))
    capture.graph.launch()
    moved, _ = integrate_push_box_rollout_generated(x0, v0, px, pv, **NUMBERS)
    np.testing.assert_array_equal(xs.numpy(), moved.numpy())
    assert np.all(moved.numpy() >= first)


def test_the_programs_are_few():
    from novaphy import diff

    texts = [t for t in diff.engine_programs().values() if "integrate_push_box" in t]
    assert 2 <= len(texts) <= 5


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"mass": 0.0}, "mass: expected a finite number > 0, got 0"),
        ({"dt": float("nan")}, "dt: expected a finite number > 0"),
        ({"ke": -1.0}, "ke: expected a finite number >= 0, got -1"),
        ({"softness": 0.0}, "softness: expected a finite number > 0"),
    ],
)
def test_numbers_out_of_their_range_are_named(change, message):
    with pytest.raises(ValueError, match=message):
        step(tensors(start(0.0, 0.0, 0.0)), NUMBERS | change)


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
@pytest.mark.parametrize("name", [*STATES, *NUMBERS])
def test_values_that_are_not_finite_are_named(name, bad):
    from novaphy import nova
    from novaphy.diff import integrate_push_box_rollout_generated

    states, numbers = tensors(start(0.0, 0.0, 0.0)), dict(NUMBERS)
    given = [bad]
    if name in NUMBERS:
        numbers[name] = tensors(given)[0]
        with pytest.raises(ValueError, match=f", {name}: expected a finite number"):
            step(states, numbers | {name: bad})
    else:
        states[STATES.index(name)] = tensors(given)[0]
    with pytest.raises(ValueError, match=f"generated, {name}: expected .*finite number.*, got "):
        step(states, numbers)
    for k in (2, 3):  # the last row of the rollout
        row = states[k].item()
        states[k] = nova.tensor(np.float32([0.1, 0.1, row]))
    with pytest.raises(ValueError, match=f"rollout_generated, {name}: expected .*finite number"):
        integrate_push_box_rollout_generated(*states, **numbers)


def test_tensors_of_numbers_have_the_ranges_of_numbers():
    for name, value in (("mass", 0.0), ("dt", -1e-3), ("friction", -0.1)):
        with pytest.raises(ValueError, match=f"{name}: expected a finite number >=? 0, got"):
            step(tensors(start(0.0, 0.0, 0.0)), NUMBERS | {name: tensors([value])[0]})


def test_a_capture_passes_on_what_is_not_finite_as_it_says():
    from novaphy import nova

    states = tensors(start(0.0, 0.0, 0.0), grad=False)
    with nova.ScopedCapture() as capture:
        x, v = step(states, NUMBERS)
    states[3].assign(np.float32([np.nan]))
    capture.graph.launch()
    assert np.isnan(x.item()) and np.isnan(v.item())


def test_wrong_tensors_are_named():
    from novaphy import nova
    from novaphy.diff import integrate_push_box_rollout_generated

    good = tensors(start(0.0, 0.0, 0.0))
    with pytest.raises(ValueError, match=r"box_v: expected \{1\}, got \{2\}"):
        step([good[0], nova.zeros((2,)), *good[2:]], NUMBERS)
    with pytest.raises(ValueError, match=r"kd: expected \{1\}, got \{1, 1\}"):
        step(good, NUMBERS | {"kd": nova.zeros((1, 1))})
    with pytest.raises(TypeError, match="pusher_x: expected a float32 tensor"):
        step([*good[:2], nova.zeros((1,), nova.int32), good[3]], NUMBERS)
    with pytest.raises(TypeError, match="mass"):
        step(good, NUMBERS | {"mass": "heavy"})
    with pytest.raises(ValueError, match=r"pusher_v: expected \{3\}, got \{1\}"):
        integrate_push_box_rollout_generated(good[0], good[1], nova.zeros((3,)), good[3], **NUMBERS)
    with pytest.raises(ValueError, match="pusher_x: expected {n} with n > 0"):
        integrate_push_box_rollout_generated(
            good[0], good[1], nova.zeros((0,)), nova.zeros((0,)), **NUMBERS
        )
