"""Dynamics of fresh random trees against Pinocchio: all joint types, frames and topologies."""

from __future__ import annotations

import numpy as np
import pytest

import novaphy

pin = pytest.importorskip("pinocchio", reason="the oracle of these tests: pip install pin")

HINGES = ("revolute", "prismatic", "d6")
KINDS = (*HINGES, "ball", "fixed")


def turn(rng: np.random.Generator) -> np.ndarray:
    q = rng.normal(size=4)
    return (q / np.linalg.norm(q)).astype(np.float32).astype(float)


def pose(rng: np.random.Generator):
    """A pose for the builder and for Pinocchio, of the same float32 numbers."""
    p, q = rng.normal(size=3).astype(np.float32).astype(float) * 0.3, turn(rng)
    return (p, q), pin.SE3(pin.Quaternion(*q[[3, 0, 1, 2]]).normalized().matrix(), p)


def unit(rng: np.random.Generator) -> np.ndarray:
    axis = rng.normal(size=3)
    return axis / np.linalg.norm(axis)


class Pair:
    """The same random tree in both; joints in depth-first order, which Pinocchio needs."""

    def __init__(self, seed: int, kinds: tuple[str, ...], free: bool) -> None:
        rng = np.random.default_rng(seed)
        b, self.exact = novaphy.ModelBuilder(), pin.Model()
        self.blocks = []  # (kind, coordinate, dof, center of mass in the joint's frame)
        self.places = []  # (joint, pose of the body there), of bodies
        self.coms = []
        links, joints, above = [], [], []
        for k in range(int(rng.integers(6, 12))):
            kind = "free" if k == 0 and free else str(rng.choice(kinds))
            depth = int(rng.integers(0, len(above))) if above else 0
            parent = above[len(above) - 1 - depth] if above else -1
            above = [*above[: len(above) - depth], k] if above else [k]
            half = rng.normal(size=(3, 3)) * 0.15
            inertia = (half @ half.T + 0.02 * np.eye(3)).astype(np.float32).astype(float)
            mass = float(np.float32(rng.uniform(0.3, 2.0)))
            com = (rng.normal(size=3) * 0.1).astype(np.float32).astype(float)
            # A sphere's worth of inertia more satisfies the triangle inequality.
            inertia += np.eye(3) * np.float32(np.trace(inertia))
            inertia = inertia.astype(np.float32).astype(float)
            links.append(b.add_link(mass=mass, com=com, inertia=inertia))
            (x_p, exact_p), (x_c, exact_c) = pose(rng), pose(rng)
            frames = {"parent_xform": x_p, "child_xform": x_c}
            at = -1 if parent < 0 else links[parent]
            joint, of_parent = (0, pin.SE3.Identity()) if parent < 0 else self.places[parent]
            placement = of_parent * exact_p
            coord, dof = b.joint_coord_count, b.joint_dof_count
            body = exact_c.inverse()

            def add(model, joint=joint, placement=placement, name=f"j{k}"):
                return self.exact.addJoint(joint, model, placement, name)

            if kind == "fixed":
                joints.append(b.add_joint_fixed(at, links[k], **frames))
                body = placement * body
            elif kind == "free":
                joints.append(b.add_joint_free(links[k], **frames))
                joint = add(pin.JointModelFreeFlyer())
            elif kind == "ball":
                joints.append(b.add_joint_ball(at, links[k], **frames))
                joint = add(pin.JointModelSpherical())
            elif kind == "d6":
                axes = np.linalg.qr(rng.normal(size=(3, 3)))[0]
                config = novaphy.ModelBuilder.JointDofConfig
                linear, angular = [axes[0]], [axes[1], axes[2]]
                joints.append(
                    b.add_joint_d6(
                        at,
                        links[k],
                        linear_axes=[config(axis=a) for a in linear],
                        angular_axes=[config(axis=a) for a in angular],
                        **frames,
                    )
                )
                joint = add(pin.JointModelPrismaticUnaligned(*linear[0]))
                for i, axis in enumerate(angular):
                    joint = add(
                        pin.JointModelRevoluteUnaligned(*axis),
                        joint,
                        pin.SE3.Identity(),
                        f"j{k}_{i}",
                    )
            else:
                axis = unit(rng)
                joints.append(getattr(b, f"add_joint_{kind}")(at, links[k], axis=axis, **frames))
                model = getattr(pin, f"JointModel{kind.capitalize()}Unaligned")
                joint = add(model(*axis))
            self.exact.appendBodyToJoint(joint, pin.Inertia(mass, com, inertia), body)
            self.places.append((joint, body))
            self.coms.append(com)
            if kind in ("free", "ball"):
                self.blocks.append((kind, coord, dof, exact_c.inverse() * com))
        b.add_articulation(joints)
        self.model = b.finalize()
        self.data = self.exact.createData()
        self.n = self.model.joint_dof_count
        assert self.n == self.exact.nv and self.model.joint_coord_count == self.exact.nq
        q = rng.uniform(-1, 1, self.exact.nq)
        for kind, coord, _, _ in self.blocks:
            first = coord + (3 if kind == "free" else 0)
            q[first : first + 4] = turn(rng)
        self.state = self.model.state()
        self.state.joint_q.assign(q.astype(np.float32))
        qd = rng.uniform(-1, 1, (2, self.n)).astype(np.float32)
        self.state.joint_qd.assign(qd[0])
        self.q = pin.normalize(self.exact, self.state.joint_q.numpy().astype(float))
        self.qd, self.qdd = qd.astype(float)

    def g(self) -> np.ndarray:
        """Our rates from Pinocchio's, whose balls and free joints turn in the child's axes."""
        g = np.eye(self.n)
        for kind, coord, dof, com in self.blocks:
            first = coord + (3 if kind == "free" else 0)
            q = self.q[first : first + 4]
            r = pin.Quaternion(*q[[3, 0, 1, 2]]).matrix()
            if kind == "ball":
                g[dof : dof + 3, dof : dof + 3] = r
            else:
                g[dof : dof + 3, dof : dof + 3] = g[dof + 3 : dof + 6, dof + 3 : dof + 6] = r
                g[dof : dof + 3, dof + 3 : dof + 6] = -r @ pin.skew(com)
        return g

    def rates(self) -> tuple[np.ndarray, np.ndarray]:
        """Pinocchio's rates and accelerations of ours."""
        inverse = np.linalg.inv(self.g())
        rate, qdd = inverse @ self.qd, self.qdd.copy()
        for kind, _, dof, com in self.blocks:
            if kind == "free":  # a = R (dv + dw x rc + w x (v + w x rc))
                v, w = rate[dof : dof + 3], rate[dof + 3 : dof + 6]
                r = self.g()[dof : dof + 3, dof : dof + 3]
                qdd[dof : dof + 3] -= r @ np.cross(w, v + np.cross(w, com))
        return rate, inverse @ qdd


def near(got, expected, relative) -> None:
    expected = np.asarray(expected)
    error = np.abs(np.asarray(got) - expected).max()
    assert error <= relative * np.abs(expected).max(), error / np.abs(expected).max()


CASES = [(seed, KINDS, seed % 2 == 0) for seed in range(12)]


@pytest.mark.parametrize(("seed", "kinds", "free"), CASES)
def test_random_trees_have_the_dynamics_of_pinocchio(seed, kinds, free):
    pair = Pair(seed, kinds, free)
    g, (rate, acceleration) = pair.g(), pair.rates()
    mass = np.asarray(novaphy.eval_mass_matrix(pair.model, pair.state))[0]
    pin.crba(pair.exact, pair.data, pair.q)
    exact = np.triu(pair.data.M) + np.triu(pair.data.M, 1).T
    near(g.T @ mass @ g, exact, 1e-5)

    tau = novaphy.eval_inverse_dynamics(pair.model, pair.state, pair.qdd.astype(np.float32))
    expected = pin.rnea(pair.exact, pair.data, pair.q, rate, acceleration)
    near(g.T @ tau, expected, 1e-5)

    # Accelerations by their residual, and as near as the condition of the matrix allows.
    qdd = np.asarray(novaphy.eval_forward_dynamics(pair.model, pair.state, tau)).astype(float)
    bias = np.asarray(novaphy.eval_bias(pair.model, pair.state))
    scale = np.abs(mass).max() * np.abs(qdd).max() + np.abs(bias).max()
    assert np.abs(mass @ qdd + bias - tau).max() <= 1e-5 * scale
    near(qdd, pair.qdd, max(2e-6 * np.linalg.cond(mass), 1e-5))


@pytest.mark.parametrize(("seed", "kinds", "free"), CASES)
def test_random_trees_have_the_jacobians_of_pinocchio(seed, kinds, free):
    """Of the centers of mass, in world axes: as body_qd."""
    pair = Pair(seed, kinds, free)
    inverse = np.linalg.inv(pair.g())
    pin.computeJointJacobians(pair.exact, pair.data, pair.q)
    jacobian = np.asarray(novaphy.eval_jacobian(pair.model, pair.state))[0]
    for k, (joint, body) in enumerate(pair.places):
        exact = pin.getJointJacobian(
            pair.exact, pair.data, joint, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        )
        away = pair.data.oMi[joint].rotation @ (body * pair.coms[k])
        exact = np.vstack([exact[:3] - pin.skew(away) @ exact[3:], exact[3:]])
        near(jacobian[6 * k : 6 * k + 6], exact @ inverse, 1e-5)


@pytest.mark.parametrize("seed", range(20, 28))
def test_random_trees_of_hinges_have_the_derivatives_of_pinocchio(seed):
    pair = Pair(seed, HINGES, False)
    got = novaphy.eval_inverse_dynamics_derivatives(
        pair.model, pair.state, pair.qdd.astype(np.float32)
    )
    pin.computeRNEADerivatives(pair.exact, pair.data, pair.q, pair.qd, pair.qdd)
    near(np.asarray(got[0])[0], pair.data.dtau_dq, 1e-5)
    near(np.asarray(got[1])[0], pair.data.dtau_dv, 1e-5)
    tau = pin.rnea(pair.exact, pair.data, pair.q, pair.qd, pair.qdd)
    got = novaphy.eval_forward_dynamics_derivatives(pair.model, pair.state, tau.astype(np.float32))
    pin.computeABADerivatives(pair.exact, pair.data, pair.q, pair.qd, tau)
    minverse = np.triu(pair.data.Minv) + np.triu(pair.data.Minv, 1).T
    mass = np.asarray(novaphy.eval_mass_matrix(pair.model, pair.state))[0]
    allowed = max(2e-6 * np.linalg.cond(mass), 2e-5)
    for ours, exact in zip(got, (pair.data.ddq_dq, pair.data.ddq_dv, minverse), strict=True):
        near(np.asarray(ours)[0], exact, allowed)
