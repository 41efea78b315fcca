"""Contacts of bodies in a Contacts: the forward bits, gradients, paths, what is refused."""

from __future__ import annotations

import numpy as np
import pytest

import novaphy
from novaphy import diff, nova, solvers
from novaphy.testing import assert_same_bits

# Steps of 0.01 s, of which one at a time is taken.
pytestmark = pytest.mark.filterwarnings("ignore:DiffSemiImplicitSolver. dt")

DT = 1 / 960
SURFACE = novaphy.ShapeConfig(ke=1e4, kd=300.0, kf=500.0, mu=0.5)
IDENTITY = (0.0, 0.0, 0.0, 1.0)
TURNED = tuple(np.float32([0.1, -0.2, 0.3, 0.9]) / np.linalg.norm([0.1, -0.2, 0.3, 0.9]))
LYING = (0.0, float(np.sqrt(0.5)), 0.0, float(np.sqrt(0.5)))
NEARLY_UP = (0.02, 0.01, 0.3, np.sqrt(1 - 0.0905))
AT_REST = (0.0,) * 6


def add_shape(builder, body, shape, cfg):
    if shape == "box":
        builder.add_shape_box(body, hx=0.1, hy=0.1, hz=0.1, cfg=cfg)
    elif shape == "sphere":
        builder.add_shape_sphere(body, radius=0.1, cfg=cfg)
    elif shape == "hull":
        corners = [[x, y, z] for x in (-0.05, 0.07) for y in (-0.06, 0.05) for z in (-0.1, 0.1)]
        builder.add_shape_convex_hull(body, vertices=np.float32(corners), cfg=cfg)
    else:
        half = 0.05 if shape == "short capsule" else 0.15
        builder.add_shape_capsule(body, radius=0.06, half_height=half, cfg=cfg)


def make_model(*bodies, ground=True, gravity=(0, 0, -9.81), surface=SURFACE):
    """Bodies of one shape each: (shape, pose, twist)."""
    builder = novaphy.ModelBuilder(gravity=gravity)
    if ground:
        builder.add_ground_plane(cfg=surface)
    for shape, pose, twist in bodies:
        body = builder.add_body(xform=pose, mass=1.0)
        builder.body_qd[body] = twist
        add_shape(builder, body, shape, surface)
    return builder.finalize(requires_grad=True)


def diff_solver(model, smoothing=0.1, **config):
    law = {"friction_law": "huber", "friction_smoothing": smoothing} if smoothing else {}
    return solvers.DiffSemiImplicitSolver(
        model, solvers.DiffSolverConfig(**law, **config, contact_gradient="code")
    )


def weighted(state, count):
    """Of all columns of all bodies, so that none can hide."""
    weights = np.cos(np.arange(13 * count, dtype=np.float32)).reshape(count, 13)
    return nova.sum(
        diff.state_body_q_tensor(state) * nova.tensor(weights[:, :7].copy())
    ) + nova.sum(diff.state_body_qd_tensor(state) * nova.tensor(weights[:, 7:].copy()))


class Step:
    """One step of a model with its contacts, `again` found in every evaluation or only once."""

    def __init__(self, model, again, smoothing=0.1, dt=1 / 100):
        self.model, self.again, self.dt = model, again, dt
        self.pipeline = novaphy.CollisionPipeline(model)
        self.solver = diff_solver(model, smoothing)
        self.state = model.state()
        self.contacts = self.find()

    def find(self):
        contacts = self.pipeline.contacts()
        self.pipeline.collide(self.state, contacts)
        return contacts

    def leaves(self):
        return [
            getattr(diff, f"state_{name}_tensor")(self.state, requires_grad=True)
            for name in ("body_q", "body_qd", "body_f")
        ]

    def __call__(self, *_):
        after = self.model.state()
        contacts = self.find() if self.again else self.contacts
        self.solver.step(self.state, after, None, contacts, self.dt)
        return weighted(after, self.model.body_count)


ON_PLANE = {  # none near a kink
    "a box on a corner, sliding": ("box", (0, 0, 0.13, *TURNED), (0.7, 0.3, -0.4, 0.5, -0.3, 0.2)),
    "a box deep in the ground": (
        "box",
        (0.1, 0.2, 0.085, *NEARLY_UP),
        (0.2, 0.1, -0.2, 0.3, 0.1, -0.4),
    ),
    "a rolling sphere": ("sphere", (0, 0, 0.09, *TURNED), (0.5, 0.2, -0.3, 0.3, 0.4, 1.0)),
    "a leaning capsule": (
        "capsule",
        (0, 0, 0.1, 0, np.sin(0.6), 0, np.cos(0.6)),
        (0.5, 0.2, -0.3, 0.3, 0.4, 1.0),
    ),
    "a box that sinks without slip or spin": (
        "box",
        (0, 0, 0.095, *IDENTITY),
        (0, 0, -0.1, 0, 0, 0),
    ),
}
TWO_BODIES = {
    "a box on a box": [
        ("box", (0, 0, 0.3, *IDENTITY), (0.1, 0.2, 0.1, 0.3, 0.2, -0.1)),
        ("box", (0.03, 0.05, 0.49, *NEARLY_UP), (-0.3, 0.1, -0.4, 0, 0, 0.5)),
    ],
    "a hull on a box": [
        ("box", (0, 0, 0.3, *IDENTITY), (0.1, 0.2, 0.1, 0.3, 0.2, -0.1)),
        ("hull", (0.0, -0.02, 0.493, *NEARLY_UP), (-0.3, 0.1, -0.4, 0, 0, 0.5)),
    ],
    "a box on a corner on a box": [
        ("box", (0, 0, 0.3, *NEARLY_UP), (0.1, 0.2, 0.1, 0.3, 0.2, -0.1)),
        ("box", (0.01, 0.02, 0.55, 0.35, -0.3, 0.1, 0.8820), (-0.3, 0.1, -0.4, 0, 0, 0.5)),
    ],
    "edges of two boxes": [
        ("box", (0, 0, 0.3, 0, np.sin(np.pi / 8), 0, np.cos(np.pi / 8)), AT_REST),
        (
            "box",
            (0.02, 0.01, 0.57, np.sin(np.pi / 8), 0.02, 0.03, 0.9232),
            (-0.3, 0.1, -0.4, 0, 0, 0.5),
        ),
    ],
    "a sphere on a box": [
        ("box", (0, 0, 0.3, *TURNED), (0.1, 0.2, 0.1, 0.3, 0.2, -0.1)),
        ("sphere", (0.02, 0.03, 0.48, *IDENTITY), (-0.3, 0.1, -0.4, 1.0, 0, 0.5)),
    ],
    "a sphere at an edge of a box": [
        ("box", (0, 0, 0.3, *IDENTITY), (0.1, 0.2, 0.1, 0.3, 0.2, -0.1)),
        ("sphere", (0.16, 0.03, 0.46, *TURNED), (-0.3, 0.1, -0.4, 1.0, 0, 0.5)),
    ],
    "a sphere at a corner of a box": [
        ("box", (0, 0, 0.3, *IDENTITY), (0.1, 0.2, 0.1, 0.3, 0.2, -0.1)),
        ("sphere", (0.15, 0.16, 0.45, *TURNED), (-0.3, 0.1, -0.4, 1.0, 0, 0.5)),
    ],
    "two spheres": [
        ("sphere", (0, 0, 0.5, *IDENTITY), (0.1, 0.2, 0.1, 0.3, 0.2, -0.1)),
        ("sphere", (0.15, 0.08, 0.58, *TURNED), (-0.4, 0.1, 0.2, 1.0, 0, 0.5)),
    ],
    "a sphere beside a capsule": [
        ("capsule", (0, 0, 0.5, *IDENTITY), (0.1, 0.2, 0.1, 0.3, 0.2, -0.1)),
        ("sphere", (0.15, 0.01, 0.52, *TURNED), (-0.4, 0.1, 0.2, 1.0, 0, 0.5)),
    ],
    "a sphere at the end of a capsule": [
        ("capsule", (0, 0, 0.5, *IDENTITY), (0.1, 0.2, 0.1, 0.3, 0.2, -0.1)),
        ("sphere", (0.06, 0.02, 0.79, *TURNED), (-0.4, 0.1, -0.2, 1.0, 0, 0.5)),
    ],
    "two capsules that cross": [
        ("capsule", (0, 0, 0.5, *IDENTITY), (0.1, 0.2, 0.1, 0.3, 0.2, -0.1)),
        ("capsule", (0.11, 0.01, 0.52, 0.6, 0.1, 0.1, 0.7874), (-0.4, 0.1, 0.2, 1.0, 0, 0.5)),
    ],
    "the end of a capsule on another": [
        ("capsule", (0, 0, 0.5, *IDENTITY), (0.1, 0.2, 0.1, 0.3, 0.2, -0.1)),
        (
            "capsule",
            (0.245, 0.03, 0.52, 0, np.sin(0.7), 0, np.cos(0.7)),
            (-0.4, 0.1, 0.2, 1.0, 0, 0.5),
        ),
    ],
    "the end of a capsule on a box": [
        ("box", (0, 0, 0.3, *NEARLY_UP), (0.1, 0.2, 0.1, 0.3, 0.2, -0.1)),
        ("capsule", (0.02, 0.01, 0.58, 0.2, 0.1, 0, 0.9747), (-0.4, 0.1, -0.3, 1.0, 0, 0.5)),
    ],
    "a capsule flat on a box": [
        ("box", (0, 0, 0.3, *IDENTITY), (0.1, 0.2, 0.1, 0.3, 0.2, -0.1)),
        ("short capsule", (0.01, 0.02, 0.45, *LYING), (-0.4, 0.1, -0.3, 0.1, 0.2, 0.5)),
    ],
    "a capsule across an edge of a box": [
        ("box", (0, 0, 0.3, *IDENTITY), (0.1, 0.2, 0.1, 0.3, 0.2, -0.1)),
        (
            "capsule",
            (0.13, 0.01, 0.43, 0, np.sin(3 * np.pi / 8), 0, np.cos(3 * np.pi / 8)),
            (-0.4, 0.1, -0.3, 1.0, 0, 0.5),
        ),
    ],
}


def turned(q, angle):
    """The unit quaternion after a small rotation of the world."""
    x, y, z, w = q
    a, b, c = 0.5 * np.asarray(angle)
    turn = (
        a * w + b * z - c * y,
        b * w + c * x - a * z,
        c * w + a * y - b * x,
        -a * x - b * y - c * z,
    )
    q = np.add(q, turn)
    return q / np.linalg.norm(q)


def along_unit_quaternions(step, size=1e-3):
    """Of every pose and velocity: the derivative, and the differences ahead and behind, {24, 3}.

    Along unit quaternions: the search finds points of bodies, which others would stretch.
    """
    q, qd, _ = step.leaves()
    with nova.Tape() as tape:
        tape.backward(step())
    of_q, of_qd = (x.grad.numpy().astype(float) for x in (q, qd))
    start, twist = step.state.body_q.numpy().astype(float), step.state.body_qd.numpy()
    middle, rows = step().item(), []
    for body in range(step.model.body_count):
        for k in range(12):
            d = np.eye(12)[k] * size
            values = []
            for sign in (1, -1):
                pose, motion = start.copy(), twist.copy()
                pose[body, :3] += sign * d[:3]
                pose[body, 3:] = turned(pose[body, 3:], sign * d[3:6])
                motion[body] += np.float32(sign * d[6:])
                step.state.body_q = np.float32(pose)
                step.state.body_qd = motion
                values.append(step().item())
            moved = np.concatenate([d[:3], turned(start[body][3:], d[3:6]) - start[body][3:]])
            got = of_q[body] @ moved + of_qd[body] @ d[6:]
            rows.append((got, values[0] - middle, middle - values[1]))
    return np.array(rows) / size


@pytest.mark.parametrize("name", ON_PLANE)
def test_on_a_plane_the_gradient_is_that_of_contacts_found_anew(name):
    step = Step(make_model(ON_PLANE[name]), again=True)
    assert step.contacts.rigid_contact_count.numpy()[0] > 0
    got, ahead, behind = along_unit_quaternions(step).T
    np.testing.assert_allclose(got, (ahead + behind) / 2, rtol=2e-2, atol=2e-2)


@pytest.mark.parametrize("name", TWO_BODIES)
def test_of_two_bodies_the_gradient_is_that_of_contacts_found_anew(name):
    step = Step(make_model(*TWO_BODIES[name], ground=False), again=True)
    labels = diff.rigid_contact_gradient_labels(step.model, step.state, step.contacts)
    assert labels and set(labels) == {"exact"}
    got, ahead, behind = along_unit_quaternions(step).T
    largest = np.abs(ahead + behind).max() / 2
    np.testing.assert_allclose(got, (ahead + behind) / 2, rtol=2e-3, atol=1e-3 * largest)


COINCIDING = {
    "a capsule flat over edges of a box": (
        ("box", ((0, 0, 0.5), IDENTITY), AT_REST),
        ("capsule", ((0.01, 0.02, 0.65), LYING), (0.1, 0.2, -0.3, 0.1, 0.2, 0.3)),
    ),
    "equal boxes": (
        ("box", ((0, 0, 0.5), IDENTITY), AT_REST),
        ("box", ((0, 0, 0.69), IDENTITY), (0.1, 0.2, -0.3, 0.1, 0.2, 0.3)),
    ),
    "boxes that lie turned on each other": (
        ("box", ((0, 0, 0.5), IDENTITY), AT_REST),
        (
            "box",
            ((0.02, -0.03, 0.69), (0.0, 0.0, float(np.sin(0.3)), float(np.cos(0.3)))),
            (0.1, 0.2, -0.3, 0.1, 0.2, 0.3),
        ),
    ),
    "equal capsules": (
        ("capsule", ((0, 0, 0.5), LYING), AT_REST),
        ("capsule", ((0, 0, 0.61), LYING), (0.1, 0.2, -0.3, 0.1, 0.2, 0.3)),
    ),
}


@pytest.mark.parametrize("name", COINCIDING)
def test_where_features_coincide_the_contacts_are_held(name):
    """The gradient is that of fixed points and normals, and the labels say so."""
    model = make_model(*COINCIDING[name], ground=False)
    held, anew = Step(model, again=False), Step(model, again=True)
    labels = diff.rigid_contact_gradient_labels(model, anew.state, anew.contacts)
    assert labels and set(labels) == {"frozen"}
    _, ahead, behind = along_unit_quaternions(held, 1e-4).T
    got = along_unit_quaternions(anew, 1e-4).T[0]
    largest = np.abs(ahead + behind).max() / 2
    np.testing.assert_allclose(got, (ahead + behind) / 2, rtol=2e-2, atol=1e-2 * largest)


@pytest.mark.parametrize("name", ["a box on a box", "a sphere on a box", "two spheres"])
def test_contacts_that_a_rollout_is_given_once_are_held(name):
    """Forward they stay what they are, and so they do in the gradient."""
    model = make_model(*TWO_BODIES[name], ground=False)
    pipeline = novaphy.CollisionPipeline(model)
    contacts = pipeline.contacts()
    pipeline.collide(model.state(), contacts)
    solver = diff_solver(model)
    trajectory = diff.Trajectory(model, 3)
    leaves = [
        getattr(diff, f"state_{n}_tensor")(trajectory[0], requires_grad=True)
        for n in ("body_q", "body_qd")
    ]

    def run(*_):
        solver.rollout(trajectory, None, contacts, 1 / 200)
        return weighted(trajectory[3], 2)

    found = nova.gradcheck(run, leaves, epsilon=1e-3, rtol=2e-2, atol=2e-3)
    assert found.ok, found.worst
    assert found.dot_product_error < 1e-4


def depths(step):
    """The signed distances of the surfaces in the rows of a step."""
    q = step.state.body_q.numpy().astype(float)
    found = []
    for row in step.contacts.rigid_contacts():
        ends = [rotation(q[b, 3:]) @ row[f"point{b}"] + q[b, :3] for b in range(2)]
        found.append((ends[1] - ends[0]) @ row["normal"] - row["margin0"] - row["margin1"])
    return np.array(found)


def random_pose(random, position):
    q = random.normal(size=4)
    return (*position, *(q / np.linalg.norm(q)))


@pytest.mark.parametrize(
    "pair",
    [
        ("sphere", "sphere"),
        ("sphere", "capsule"),
        ("sphere", "box"),
        ("capsule", "capsule"),
        ("capsule", "box"),
        ("box", "box"),
    ],
    ids="-".join,
)
def test_in_random_overlaps_the_gradient_is_that_of_contacts_found_anew(pair):
    random = np.random.default_rng(7)
    compared = states = 0
    while states < 15:
        away = random.normal(size=3)
        away *= random.uniform(0.12, 0.25) / np.linalg.norm(away)
        model = make_model(
            (pair[0], random_pose(random, (0, 0, 1)), random.normal(size=6) * 0.3),
            (
                pair[1],
                random_pose(random, away + np.float64([0, 0, 1])),
                random.normal(size=6) * 0.3,
            ),
            ground=False,
            gravity=(0, 0, 0),
        )
        step = Step(model, again=True)
        depth = depths(step)
        # Neither apart, nor about to touch with another row, which differences would feel.
        if not len(depth) or not -0.04 < depth.min() < -2e-3 or np.abs(depth).min() < 1e-3:
            continue
        states += 1
        labels = diff.rigid_contact_gradient_labels(step.model, step.state, step.contacts)
        assert len(labels) == len(depth)
        if any(label == "frozen" for label, d in zip(labels, depth, strict=True) if d < 0):
            continue
        got, ahead, behind = along_unit_quaternions(step, 3e-4).T
        largest = np.abs(got).max()
        smooth = np.abs(ahead - behind) < 2e-2 * largest + 2e-3
        compared += smooth.sum()
        error = np.abs(got - (ahead + behind) / 2)[smooth].max()
        assert error < 2e-2 * largest + 2e-3, (labels, depth)
    assert compared > 0.9 * states * 24  # kinks and frozen rows are few


def test_rows_without_a_closed_form_are_labelled_frozen():
    builder = novaphy.ModelBuilder()
    for x in (0.0, 2.0):
        below = builder.add_body(xform=(x, 0, -0.3, *IDENTITY))
        builder.add_shape_box(below, hx=0.3, hy=0.3, hz=0.3)
        turn = IDENTITY if x == 0.0 else NEARLY_UP  # the cylinder stands on its base
        body = builder.add_body(xform=(x, 0, 0.1, *turn))
        if x == 0.0:
            builder.add_shape_cylinder(body, radius=0.1, half_height=0.1)
        else:
            builder.add_shape_box(body, hx=0.1, hy=0.1, hz=0.1)
    model = builder.finalize()
    state = model.state()
    pipeline = novaphy.CollisionPipeline(model)
    contacts = pipeline.contacts()
    pipeline.collide(state, contacts)
    labels = diff.rigid_contact_gradient_labels(model, state, contacts)
    of_box = contacts.rigid_contacts()["shape1"] == 3
    assert of_box.any() and not of_box.all()
    assert labels == ["exact" if b else "frozen" for b in of_box]
    other = novaphy.ModelBuilder().finalize()
    with pytest.raises(ValueError, match="state: expected a state of the model"):
        diff.rigid_contact_gradient_labels(model, other.state(), contacts)


# The step of the differences for the values of each array of the model.
MODEL = {
    "body_mass": 1e-2,
    "body_inertia": 3e-4,
    "body_com": 1e-3,
    "gravity": 1e-1,
    "shape_material_ke": 50.0,
    "shape_material_kd": 3.0,
    "shape_material_kf": 5.0,
    "shape_material_mu": 1e-2,
}


@pytest.mark.parametrize("again", [True, False], ids=["found anew", "as they are"])
@pytest.mark.parametrize("array", MODEL)
@pytest.mark.parametrize("name", ["a box on a box", "a sphere beside a capsule", "two spheres"])
def test_gradients_with_respect_to_the_model_equal_the_differences(name, array, again):
    model = make_model(*TWO_BODIES[name], ground=False)
    step = Step(model, again)
    values = getattr(model, array).numpy()
    getattr(model, array).requires_grad = True
    with nova.Tape() as tape:
        tape.backward(step())
    gradient = getattr(model, array).grad.numpy().reshape(-1).astype(float)
    directions = np.eye(values.size, dtype=np.float32).reshape(-1, *values.shape)
    if array == "body_inertia":  # is symmetric
        directions = directions + directions.transpose(0, 1, 3, 2)
        gradient = (gradient.reshape(values.shape) * directions).reshape(values.size, -1).sum(1)
    differences = []
    for direction in directions:
        ends = []
        for sign in (1, -1):
            setattr(model, array, values + np.float32(sign * MODEL[array]) * direction)
            ends.append(step().item())
        differences.append((ends[0] - ends[1]) / (2 * MODEL[array]))
    setattr(model, array, values)
    largest = np.abs(differences).max()
    assert largest > 0 or array in ("shape_material_kf", "shape_material_mu")  # one of them acts
    np.testing.assert_allclose(
        gradient, differences, rtol=2e-2, atol=1e-2 * largest + 4e-7 / MODEL[array]
    )


@pytest.mark.parametrize(
    "array", ["shape_transform", "shape_scale", "shape_margin", "shape_gap", "shape_material_ka"]
)
def test_arrays_that_no_gradient_reaches_refuse_one(array):
    step = Step(make_model(*TWO_BODIES["two spheres"], ground=False), again=False)
    step()
    getattr(step.model, array).requires_grad = True
    with nova.Tape(), pytest.raises(NotImplementedError, match=f"model.{array}: expected req"):
        step()


@pytest.mark.parametrize("smoothing", [0.0, 0.1])
def test_at_rest_the_gradient_is_finite_and_friction_is_part_of_it(smoothing):
    model = make_model(("box", (0, 0, 0.097, *IDENTITY), AT_REST))
    step = Step(model, again=True, smoothing=smoothing, dt=1e-3)
    step.solver = diff_solver(model, smoothing, angular_damping=0.0)
    step.leaves()
    after = model.state()
    with nova.Tape() as tape:
        step.solver.step(step.state, after, None, step.find(), 1e-3)
        speed = diff.state_body_qd_tensor(after) * nova.tensor(np.float32([[1, 0, 0, 0, 0, 0]]))
        tape.backward(nova.sum(speed))
    gradient = step.state.body_qd.grad.numpy()[0]
    assert np.isfinite(step.state.body_q.grad.numpy()).all()
    limit = 0.5 * 1e4 * 0.003
    slope = min(500.0, 2 * limit / smoothing) if smoothing else 500.0
    mass = float(model.body_mass.numpy()[0])
    assert gradient[0] == pytest.approx(1 - 4 * slope * 1e-3 / mass, rel=1e-2)


SCENES = {
    "a die": lambda: make_model(("box", (0, 0, 0.3, *IDENTITY), (1, 0, 0, 1, 5, 2))),
    "two boxes that meet": lambda: make_model(
        ("box", (0, 0, 0.1, *IDENTITY), (1.0, 0, 0, 0, 0, 0)),
        ("box", (0.35, 0.03, 0.2, *TURNED), (-1.0, 0, 0, 1.0, 0, 2.0)),
    ),
    "a sphere on a capsule on the ground": lambda: make_model(
        ("capsule", (0, 0, 0.06, 0, np.sqrt(0.5), 0, np.sqrt(0.5)), AT_REST),
        ("sphere", (0.03, 0.01, 0.25, *IDENTITY), (0, 0, -1.0, 1.0, 2.0, 0)),
    ),
}


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("smoothing", [0.0, 0.1])
def test_a_rollout_has_the_bits_of_the_forward_solver(name, smoothing):
    model = SCENES[name]()
    steps = 300
    law = {"friction_law": "huber", "friction_smoothing": smoothing} if smoothing else {}
    forward, same = diff.Trajectory(model, steps), diff.Trajectory(model, steps)
    solvers.SolverSemiImplicit(model, **law).rollout(
        forward, None, None, DT, pipeline=novaphy.CollisionPipeline(model)
    )
    diff_solver(model, smoothing).rollout(
        same, None, None, DT, pipeline=novaphy.CollisionPipeline(model)
    )
    assert_same_bits(same.body_q.numpy(), forward.body_q.numpy())
    assert_same_bits(same.body_qd.numpy(), forward.body_qd.numpy())
    # And of a loop of steps.
    step = Step(model, again=True, smoothing=smoothing)
    state, after = model.state(), model.state()
    for t in range(steps):
        step.state = state
        step.solver.step(state, after, None, step.find(), DT)
        state, after = after, state
        if t == 40:
            assert_same_bits(state.body_q.numpy(), forward[t + 1].body_q.numpy())
    assert_same_bits(state.body_q.numpy(), forward[steps].body_q.numpy())
    assert (forward[steps].body_q.numpy() != forward[0].body_q.numpy()).any()


@pytest.mark.parametrize("name", SCENES)
def test_a_step_leaves_the_forces_of_its_contacts(name):
    """In rigid_contact_force, on a tape and without, with the bits of the forward solver."""
    model = SCENES[name]()
    pipeline = novaphy.CollisionPipeline(model)
    forward, solver = solvers.SolverSemiImplicit(model), diff_solver(model, 0.0)
    state, after = model.state(), model.state()
    contacts = pipeline.contacts()
    acted = False
    for _ in range(220):
        pipeline.collide(state, contacts)
        forward.step(state, after, None, contacts, DT)
        forces = contacts.rigid_contact_force.numpy()
        acted = acted or forces.any()
        contacts.rigid_contact_force.assign(np.zeros_like(forces))
        solver.step(state, model.state(), None, contacts, DT)
        assert_same_bits(contacts.rigid_contact_force.numpy(), forces)
        state, after = after, state
    assert acted
    with nova.Tape():
        contacts = pipeline.contacts()
        pipeline.collide(state, contacts)
        solver.step(state, after, None, contacts, DT)
        on_tape = contacts.rigid_contact_force.numpy()
    forward.step(state, after, None, contacts, DT)
    assert_same_bits(contacts.rigid_contact_force.numpy(), on_tape)


class Meeting:
    """Two boxes that meet over the ground."""

    steps = 240

    def __init__(self, interval=1):
        self.model = SCENES["two boxes that meet"]()
        self.pipeline = novaphy.CollisionPipeline(self.model)
        self.solver = diff_solver(self.model)
        self.trajectory = diff.Trajectory(self.model, self.steps, checkpoint=interval)
        self.pushes = nova.tensor(np.full((self.steps, 2, 6), 0.1, np.float32), requires_grad=True)
        self.mu = diff.model_shape_material_mu_tensor(self.model, requires_grad=True)

    def run(self):
        with nova.Tape() as tape:
            self.solver.rollout(
                self.trajectory,
                None,
                None,
                DT,
                pipeline=self.pipeline,
                body_forces=self.pushes,
            )
            loss = weighted(self.trajectory[self.steps], 2)
            tape.backward(loss)
            # Copies, so that a replay can be read.
            seen = [
                x.grad * 1.0
                for x in (
                    diff.state_body_q_tensor(self.trajectory[0]),
                    diff.state_body_qd_tensor(self.trajectory[0]),
                    self.mu,
                    self.pushes,
                )
            ]
            tape.zero()
        return [loss, *seen]


def test_all_paths_have_the_same_bits():
    expected = [x.numpy() for x in Meeting().run()]
    assert all(np.isfinite(x).all() and x.any() for x in expected)
    for interval in (7, Meeting.steps):
        for got, want in zip(Meeting(interval).run(), expected, strict=True):
            assert_same_bits(got.numpy(), want)
    before = novaphy.num_threads()
    captured = Meeting()
    with nova.ScopedCapture() as capture:
        results = captured.run()
    try:
        for threads in (1, 2, 7):
            novaphy.set_num_threads(threads)
            for got, want in zip(Meeting().run(), expected, strict=True):
                assert_same_bits(got.numpy(), want)
            capture.graph.launch()
            for got, want in zip(results, expected, strict=True):
                assert_same_bits(got.numpy(), want)
    finally:
        novaphy.set_num_threads(before)


# Without a damper the force does not jump at the touch, so that a rollout has a derivative.
ELASTIC = novaphy.ShapeConfig(ke=1e4, kd=0.0, kf=500.0, mu=0.5)


def spheres(offset=0.0, speed=1.0, surface=ELASTIC):
    return make_model(
        ("sphere", (0, 0, 1, *IDENTITY), (speed, 0, 0, 0, 0, 0)),
        ("sphere", (0.25, offset, 1, *IDENTITY), AT_REST),
        ground=False,
        gravity=(0, 0, 0),
        surface=surface,
    )


def end_of_collision(model):
    trajectory = diff.Trajectory(model, 250)
    diff_solver(model).rollout(
        trajectory, None, None, DT, pipeline=novaphy.CollisionPipeline(model)
    )
    return trajectory


def test_two_spheres_collide_with_the_gradient_of_the_differences():
    speed, step = 1.02, 1e-3  # between two speeds at which the touch moves to another substep
    with nova.Tape() as tape:
        trajectory = end_of_collision(spheres(speed=speed))
        x = diff.state_body_q_tensor(trajectory[250]) * nova.tensor(
            np.float32([[0] * 7, [1] + [0] * 6])
        )
        tape.backward(nova.sum(x))
    gradient = trajectory[0].body_qd.grad.numpy()[0, 0]
    ends = [
        end_of_collision(spheres(speed=speed + e))[250].body_q.numpy()[1, 0] for e in (step, -step)
    ]
    assert gradient == pytest.approx((ends[0] - ends[1]) / (2 * step), rel=1e-2)


def test_two_bodies_keep_their_momentum():
    model = spheres(offset=0.08, surface=SURFACE)
    end = end_of_collision(model)[250]
    mass = model.body_mass.numpy()[:, None]
    start, v = model.body_qd.numpy(), end.body_qd.numpy()
    assert np.abs(v[1, :3]).max() > 0.1  # the bodies did collide
    np.testing.assert_allclose((mass * v[:, :3]).sum(0), (mass * start[:, :3]).sum(0), atol=2e-6)


def test_what_is_not_covered_is_named():
    model = make_model(("box", (0, 0, 0.1, *IDENTITY), AT_REST))
    pipeline = novaphy.CollisionPipeline(model)
    contacts = pipeline.contacts()
    state, after = model.state(), model.state()
    trajectory = diff.Trajectory(model, 2)
    solver = diff_solver(model)
    with pytest.raises(ValueError, match=r"1 pair\(s\) of shapes of the model may meet"):
        solver.step(state, after, None, None, DT)
    with pytest.raises(ValueError, match="enable_rigid_contacts = false"):
        solver.rollout(trajectory, None, None, DT)
    with pytest.raises(ValueError, match="besides pipeline"):
        solver.rollout(trajectory, None, contacts, DT, pipeline=pipeline)
    static = diff_solver(model, enable_static_contacts=True)
    for given in ({"pipeline": pipeline}, {}):
        with pytest.raises(ValueError, match="enable_static_contacts is true"):
            static.rollout(trajectory, None, None if given else contacts, DT, **given)
    with pytest.raises(ValueError, match=r"body_forces: expected float32 \{1, 6\}"):
        solver.rollout(trajectory, None, contacts, DT, body_forces=nova.zeros((1, 3)))
    with pytest.raises(ValueError, match=r"body_forces: expected \{1, 6\} or \{2, 1, 6\}"):
        solver.rollout(trajectory, None, contacts, DT, body_forces=nova.zeros((3, 1, 6)))
    few = novaphy.CollisionPipeline(model, rigid_contact_max=2)
    with pytest.raises(novaphy.Error, match="2 rows"):
        solver.rollout(trajectory, None, None, DT, pipeline=few)
    diff_solver(model, enable_rigid_contacts=False).rollout(trajectory, None, None, DT)
    assert trajectory[2].body_q.numpy()[0, 2] < 0.1


CLOTH = {"ke": 1e3, "kd": 5.0, "kf": 20.0, "mu": 0.5}


def particle_and_body(shape, height, speed, fixed=False, spin=(0.0, 0.0, 0.0), material=CLOTH):
    """A particle that falls on a shape of a body, without gravity."""
    builder = novaphy.ModelBuilder(gravity=(0, 0, 0))
    cfg = novaphy.ShapeConfig(**material)
    if not fixed:
        body = builder.add_body(xform=(0.0, 0.0, 1.0, *TURNED), mass=1.0)
        builder.body_qd[body] = (0, 0, 0, *spin)
    pose = (0, 0, 1.0, *TURNED) if fixed else (0, 0, 0, *IDENTITY)
    add = getattr(builder, f"add_shape_{shape[0]}")
    add(-1 if fixed else body, xform=pose, cfg=cfg, **shape[1])
    builder.add_particle((0.02, 0.03, height), (0.1, 0.2, -speed), 0.5, radius=0.05)
    model = builder.finalize(requires_grad=True)
    for name, value in material.items():
        setattr(model, f"soft_contact_{name}", value)
    return model


SHAPES = [
    ("box", {"hx": 0.1, "hy": 0.12, "hz": 0.1}),
    ("sphere", {"radius": 0.1}),
    ("capsule", {"radius": 0.08, "half_height": 0.1}),
    ("cylinder", {"radius": 0.09, "half_height": 0.1}),
    ("cone", {"radius": 0.12, "half_height": 0.1}),
    ("ellipsoid", {"rx": 0.12, "ry": 0.09, "rz": 0.1}),
]


@pytest.mark.parametrize("friction", [True, False])
@pytest.mark.parametrize("shape", SHAPES, ids=[s[0] for s in SHAPES])
def test_a_particle_and_a_body_exchange_their_momentum(shape, friction):
    model = particle_and_body(shape, 1.4, 2.0, material=CLOTH | ({} if friction else {"mu": 0.0}))
    trajectory = diff.Trajectory(model, 300)
    solvers.SolverSemiImplicit(model, angular_damping=0.0).rollout(
        trajectory, None, None, DT, pipeline=novaphy.CollisionPipeline(model)
    )
    m, m_p = float(model.body_mass.numpy()[0]), 0.5
    inertia = model.body_inertia.numpy()[0].astype(float)

    def momenta(state):
        q, qd = state.body_q.numpy()[0].astype(float), state.body_qd.numpy()[0].astype(float)
        x, v = (getattr(state, a).numpy()[0].astype(float) for a in ("particle_q", "particle_qd"))
        turn = rotation(q[3:])
        spin = turn @ inertia @ turn.T @ qd[3:]
        center = q[:3] + turn @ model.body_com.numpy()[0]
        linear = m * qd[:3] + m_p * v
        return linear, spin + m * np.cross(center, qd[:3]) + m_p * np.cross(x, v)

    before, after = momenta(trajectory[0]), momenta(trajectory[300])
    assert np.abs(trajectory[300].body_qd.numpy()).max() > 0.05
    np.testing.assert_allclose(after[0], before[0], atol=3e-6)
    if not friction:  # friction acts on the surface of the shape, a radius away from the particle
        np.testing.assert_allclose(after[1], before[1], atol=1e-5)


def rotation(q):
    x, y, z, w = q
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


@pytest.mark.parametrize("shape", SHAPES, ids=[s[0] for s in SHAPES])
def test_a_very_heavy_body_is_like_the_world(shape):
    ends = []
    for fixed in (True, False):
        model = particle_and_body(shape, 1.3, 2.0, fixed)
        if not fixed:
            model.body_mass = np.float32([1e9])
            model.body_inertia = np.float32([np.eye(3) * 1e9])
        trajectory = diff.Trajectory(model, 200)
        solvers.SolverSemiImplicit(model).rollout(
            trajectory, None, None, DT, pipeline=novaphy.CollisionPipeline(model)
        )
        ends.append(trajectory[200].particle_q.numpy())
    np.testing.assert_allclose(ends[1], ends[0], atol=2e-5)


@pytest.mark.parametrize("shape", SHAPES, ids=[s[0] for s in SHAPES])
def test_contacts_of_particles_with_bodies_have_the_bits_and_derivatives(shape):
    model = particle_and_body(shape, 1.12, 1.0, spin=(0.5, -0.3, 1.0))
    pipeline = novaphy.CollisionPipeline(model)
    forward, same = diff.Trajectory(model, 100), diff.Trajectory(model, 100)
    solvers.SolverSemiImplicit(model).rollout(forward, None, None, DT, pipeline=pipeline)
    solver = diff_solver(model, 0.0)
    solver.rollout(same, None, None, DT, pipeline=pipeline)
    for name in ("particle_q", "particle_qd", "body_q", "body_qd"):
        assert_same_bits(getattr(same, name).numpy(), getattr(forward, name).numpy())
    state = model.state()
    contacts = pipeline.contacts()
    pipeline.collide(state, contacts)
    names = ("particle_q", "particle_qd", "body_q", "body_qd")

    def step(*_):
        after = model.state()
        state.clear_forces()
        solver.step(state, after, None, contacts, 1 / 100)
        x, v = (getattr(diff, f"state_{n}_tensor")(after) for n in ("particle_q", "particle_qd"))
        weights = nova.tensor(np.float32([[0.3, -0.5, 0.8]]))
        return weighted(after, 1) + nova.sum(x * weights) + nova.sum(v * weights)

    leaves = [getattr(diff, f"state_{n}_tensor")(state, requires_grad=True) for n in names]
    found = nova.gradcheck(step, leaves, epsilon=1e-3, rtol=2e-2, atol=2e-3)
    assert found.ok, found.worst
    assert found.dot_product_error < 1e-4


@pytest.mark.parametrize("shape", SHAPES, ids=[s[0] for s in SHAPES])
def test_checkpoints_find_the_contacts_of_particles_with_bodies_again(shape):
    """A step that is run once more finds its contacts anew: the bits of no checkpoints."""
    steps, names = 60, ("particle_q", "particle_qd", "body_q", "body_qd")

    def gradients(interval):
        model = particle_and_body(shape, 1.13, 1.0, spin=(0.5, -0.3, 1.0))
        trajectory = diff.Trajectory(model, steps, checkpoint=interval)
        with nova.Tape() as tape:
            diff_solver(model).rollout(
                trajectory, None, None, DT, pipeline=novaphy.CollisionPipeline(model)
            )
            end = trajectory[steps]
            tape.backward(weighted(end, 1) + nova.sum(diff.state_particle_q_tensor(end)))
        return [getattr(trajectory[0], name).grad.numpy() for name in names]

    expected = gradients(1)
    assert all(np.isfinite(x).all() and x.any() for x in expected)
    for interval in (7, steps):
        for got, want in zip(gradients(interval), expected, strict=True):
            assert_same_bits(got, want)


def surfaces(mu):
    return novaphy.ShapeConfig(ke=1e4, kd=0.0, kf=500.0, mu=mu)


@pytest.mark.parametrize("mu", [0.0, 0.5])
@pytest.mark.parametrize("law", [None, "newton18"])
def test_the_angular_momentum_changes_by_what_acts_at_two_points(mu, law):
    """Newton's force and counterforce act at the two surfaces, which are a depth apart."""
    model = make_model(
        ("box", (0, 0, 1, *IDENTITY), (1.0, 0, 0, 0, 0, 0)),
        ("box", (0.28, 0.06, 1.03, *TURNED), (-1.0, 0, 0, 1.0, 0, 2.0)),
        ground=False,
        gravity=(0, 0, 0),
        surface=surfaces(mu),
    )
    pipeline = novaphy.CollisionPipeline(model)
    chosen = {} if law is None else {"friction_law": law}
    solver = solvers.SolverSemiImplicit(model, angular_damping=0.0, **chosen)
    contacts, state, after = pipeline.contacts(), model.state(), model.state()
    mass = model.body_mass.numpy().astype(float)
    inertia = model.body_inertia.numpy().astype(float)[0, 0, 0]  # the same about any axis of a cube

    def angular(at):
        q, qd = at.body_q.numpy().astype(float), at.body_qd.numpy().astype(float)
        orbital = np.cross(q[:, :3], mass[:, None] * qd[:, :3])
        return (orbital + inertia * qd[:, 3:]).sum(0)

    start, moments, touched = angular(state), np.zeros(3), 0
    for _ in range(200):
        pipeline.collide(state, contacts)
        solver.step(state, after, None, contacts, DT)
        q = state.body_q.numpy().astype(float)
        for row in contacts.rigid_contacts():
            f = row["force"].astype(float)
            ends = [
                rotation(q[b, 3:]) @ row[f"point{b}"].astype(float) + q[b, :3] for b in range(2)
            ]
            moments += DT * np.cross(ends[1] - ends[0], f) * (law is not None)
            touched += bool(f.any())
        state, after = after, state
    assert touched > 20
    np.testing.assert_allclose(angular(state) - start, moments, atol=2e-5)
    assert np.abs(angular(state) - start).max() < (1.0 if mu and law else 2e-5)


def test_ten_aligned_cubes_stand_for_ten_seconds():
    cfg = novaphy.ShapeConfig(ke=2e5, kd=300.0, kf=200.0, mu=0.5)
    builder = novaphy.ModelBuilder()
    builder.add_ground_plane(cfg=cfg)
    for k in range(10):
        body = builder.add_body(xform=(0, 0, 0.1 + 0.2 * k, *IDENTITY))
        builder.add_shape_box(body, hx=0.1, hy=0.1, hz=0.1, cfg=cfg)
    model = builder.finalize()
    assert np.allclose(model.body_mass.numpy(), 8.0)
    pipeline = novaphy.CollisionPipeline(model, contacts_per_pair=4)
    contacts, state, after = pipeline.contacts(), model.state(), model.state()
    solver = solvers.SolverSemiImplicit(model)
    for _ in range(9600):
        pipeline.collide(state, contacts)
        solver.step(state, after, None, contacts, DT)
        state, after = after, state
    q = state.body_q.numpy()
    assert np.abs(q[:, :2]).max() < 1e-5 and np.abs(state.body_qd.numpy()).max() < 1e-4
    # Each interface of four points carries the weight above it.
    sunk = np.cumsum([(10 - k) * 8.0 * 9.81 / (4 * 2e5) for k in range(10)])
    np.testing.assert_allclose(q[:, 2], 0.1 + 0.2 * np.arange(10) - sunk, atol=2e-5)
