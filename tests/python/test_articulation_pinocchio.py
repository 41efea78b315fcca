"""The functions of the dynamics against Pinocchio, on trees that are drawn for the test."""

from __future__ import annotations

import numpy as np
import pytest
from test_mimic_joints import branched_urdf

import novaphy
from novaphy.testing import assert_allclose

pytestmark = pytest.mark.skipif(not novaphy.has_io(), reason="built without io")


@pytest.mark.parametrize("seed", range(10, 16))
def test_random_trees_have_the_dynamics_of_pinocchio(seed: int) -> None:
    pin = pytest.importorskip("pinocchio", reason="the oracle of this test: pip install pin")
    text = branched_urdf(seed)
    builder = novaphy.ModelBuilder()
    joints = builder.add_urdf(text, joint_ordering=None, mimic="independent").joints
    model = builder.finalize()
    exact = pin.buildModelFromXML(text)
    data = exact.createData()
    state = model.state()
    draw = np.random.default_rng(seed)

    def close(found: np.ndarray, expected: np.ndarray, tolerance: float) -> None:
        found = np.asarray(found, float).reshape(expected.shape)
        assert_allclose(found, expected, atol=tolerance * np.abs(expected).max(), rtol=0)

    for _ in range(4):
        q, qd, qdd, tau = draw.uniform(-2, 2, (4, 6)).astype(np.float32)
        state.joint_q.assign(q)
        state.joint_qd.assign(qd)
        at = [x.astype(float) for x in (q, qd, qdd, tau)]
        pin.crba(exact, data, at[0])
        mass = np.triu(data.M) + np.triu(data.M, 1).T
        condition = np.linalg.cond(mass)
        close(novaphy.eval_mass_matrix(model, state), mass, 1e-5)
        torque = pin.rnea(exact, data, *at[:3])
        close(novaphy.eval_inverse_dynamics(model, state, qdd), torque, 1e-5)
        pin.computeRNEADerivatives(exact, data, *at[:3])
        by_q, by_qd, inertia = novaphy.eval_inverse_dynamics_derivatives(model, state, qdd)
        close(by_q, data.dtau_dq, 1e-5)
        close(by_qd, data.dtau_dv, 1e-5)
        close(inertia, mass, 1e-5)
        rates = pin.aba(exact, data, at[0], at[1], at[3])
        found = novaphy.eval_forward_dynamics(model, state, tau)
        close(found, rates, 2e-6 * condition)
        residual = pin.rnea(exact, data, at[0], at[1], np.asarray(found, float).ravel()) - at[3]
        scale = np.abs(mass).max() * np.abs(rates).max()
        assert np.abs(residual).max() < 1e-5 * max(scale, np.abs(at[3]).max())
        pin.computeABADerivatives(exact, data, at[0], at[1], at[3])
        by_q, by_qd, inverse = novaphy.eval_forward_dynamics_derivatives(model, state, tau)
        close(by_q, data.ddq_dq, 2e-6 * condition)
        close(by_qd, data.ddq_dv, 2e-6 * condition)
        upper = np.triu(data.Minv)
        close(inverse, upper + np.triu(upper, 1).T, 2e-6 * condition)
        assert (inverse[0] == inverse[0].T).all()
        jacobian = np.asarray(novaphy.eval_jacobian(model, state), float)[0]
        pin.computeJointJacobians(exact, data, at[0])
        for k in range(1, exact.njoints):
            expected = pin.getJointJacobian(exact, data, k, pin.LOCAL_WORLD_ALIGNED).copy()
            arm = data.oMi[k].rotation @ exact.inertias[k].lever  # to the center of mass
            expected[:3] += np.cross(expected[3:].T, arm).T
            row = 6 * joints[exact.names[k]]
            close(jacobian[row : row + 6], expected, 1e-5)
        center = pin.centerOfMass(exact, data, at[0])
        base = 1e-5 * max(1.0, np.abs(center).max())
        assert_allclose(np.ravel(novaphy.eval_center_of_mass(model, state)), center, atol=base)
        kinetic = pin.computeKineticEnergy(exact, data, at[0], at[1])
        assert np.ravel(novaphy.eval_energy(model, state))[0] == pytest.approx(kinetic, rel=1e-5)
