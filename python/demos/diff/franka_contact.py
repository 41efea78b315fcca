"""The Franka that pushes a box, with rigid contacts in one simulation.

In this file, arm and box are two articulations of one model, and the box pushes back on the arm.
The sphere at the tip touches the box, and the box lies on a plane. Contacts are solved by projected
Gauss-Seidel with Coulomb friction. In demo_diffsim_franka_push_box.py the contact is a surrogate
without reaction.

The derivative of the box's final position comes from the adjoints of all steps
(DiffFeatherstoneSolver). The derivatives of the tip's path and of the joint speeds come from the
sensitivity of the arm without the box, as in demo_diffsim_franka_push_box.py.
"""

from __future__ import annotations

import numpy as np
from demo_diffsim_franka_push_box import (
    AXES,
    BOX,
    DT,
    FINGER_KD,
    FINGER_KE,
    FRICTION,
    HALF,
    KD,
    KE,
    KEYS,
    LINE,
    MASS,
    NO_CONTACT,
    RADIUS,
    STEPS,
    TIP,
    FrankaPush,
)

import novaphy
from novaphy import diff, nova
from novaphy.solvers import DiffFeatherstoneSolver

UPRIGHT = (0.0, 0.0, 0.0, 1.0)
BOX_COORDS, BOX_DOFS = 7, 6  # the box has the last coordinates and dofs of the model
AGREE = 0.8  # least cosine between gradient and differences, which are noisy due to contacts


class FullPush(FrankaPush):
    """FrankaPush whose box is part of the simulation."""

    def __init__(self, device: str, exact: bool) -> None:
        super().__init__(device, exact)
        builder = novaphy.ModelBuilder()
        robot = builder.add_urdf(novaphy.assets.path("fr3.urdf"))
        cfg = novaphy.ShapeConfig(density=0.0, mu=FRICTION)
        tip = builder.add_shape_sphere(
            robot.links["fr3_link7"], xform=(*TIP, *UPRIGHT), radius=RADIUS, cfg=cfg
        )
        below = (0.0, 0.0, LINE[1] - HALF, *UPRIGHT)
        plane = builder.add_shape_plane(xform=below, width=0.0, length=0.0, cfg=cfg)
        pose = (BOX, LINE[0], LINE[1], *UPRIGHT)
        inertia = np.diag([MASS * HALF**2 * 2.0 / 3.0] * 3)
        body = builder.add_body(mass=MASS, inertia=inertia, xform=pose, label="box")
        box = builder.add_shape_box(body, hx=HALF, hy=HALF, hz=HALF, cfg=cfg)
        self.full = full = builder.finalize(device, requires_grad=True)
        drives = full.joint_target_ke.numpy(), full.joint_target_kd.numpy()
        arm = full.joint_dof_count - BOX_DOFS
        for numbers, finger, axes in zip(drives, (FINGER_KE, FINGER_KD), (KE, KD), strict=True):
            numbers[:arm] = finger
            numbers[self.dofs] = axes
        mode = full.joint_target_mode.numpy()
        mode[:arm] = int(novaphy.JointTargetMode.POSITION_VELOCITY)
        full.joint_target_ke.assign(drives[0])
        full.joint_target_kd.assign(drives[1])
        full.joint_target_mode.assign(mode)
        self.steps = DiffFeatherstoneSolver(full, angular_damping=0.0)
        self.pipeline = novaphy.CollisionPipeline(
            full, shape_pairs_filtered=[(tip, box), (plane, box)]
        )
        self.trajectory = diff.Trajectory(full, STEPS)
        self.controls = [full.control() for _ in range(STEPS)]
        for control in self.controls:
            control.joint_target_q.requires_grad = control.joint_target_qd.requires_grad = True
        self.start_q = full.joint_q.numpy()
        self.start_q[self.dofs] = self.first

    def label(self) -> str:
        """Return a description of the gradient."""
        return (
            "rigid contact with reaction, adjoint of every step; tip's line: "
            f"{self.sensitivity.label}"
        )

    def push(self, gradient: bool) -> None:
        """Simulate arm and box. With `gradient` also set the box's final derivatives."""
        poses, rates = self.weights @ self.played, self.rate_weights @ self.played
        target, rate = self.full.joint_target_q.numpy(), self.full.joint_target_qd.numpy()
        by_pose = []
        for t, control in enumerate(self.controls):
            target[self.dofs], rate[self.dofs] = self.target(poses[t]), rates[t]
            if gradient:
                by_pose.append(self.exact_target_by_pose())
            control.joint_target_q.assign(target)
            control.joint_target_qd.assign(rate)
        first = self.trajectory[0]
        first.joint_q.assign(self.start_q)
        first.joint_qd.zero_()
        novaphy.eval_fk(self.full, first.joint_q, first.joint_qd, first)
        with nova.Tape() as tape:
            self.steps.rollout(self.trajectory, self.controls, None, DT, pipeline=self.pipeline)
            end = self.trajectory[STEPS]
            ends = diff.state_joint_q_tensor(end), diff.state_joint_qd_tensor(end)
        self.take_states()
        if not gradient:
            return
        if np.all(self.box == np.float32(BOX)):
            raise ValueError(NO_CONTACT)
        self.end_by_keys = np.zeros((2, KEYS * AXES))
        for row, (values, k) in enumerate(zip(ends, (BOX_COORDS, BOX_DOFS), strict=True)):
            seed = np.zeros(values.size, np.float32)
            seed[-k] = 1.0  # the adjoint of x, or of its rate
            tape.zero()
            tape.backward(values, nova.tensor(seed))
            by_keys = np.zeros((KEYS, AXES))
            for t, control in enumerate(self.controls):
                by_target, by_rate = (
                    a.grad.numpy()[self.dofs].astype(np.float64)
                    for a in (control.joint_target_q, control.joint_target_qd)
                )
                by_keys += np.outer(self.weights[t], by_target @ by_pose[t])
                by_keys += np.outer(self.rate_weights[t], by_rate)
            self.end_by_keys[row] = by_keys.ravel()

    def forward(self, keys: np.ndarray, gradient: bool = False) -> None:
        """Simulate the arm without the box, for the derivative of the tip's path, then with it."""
        self.played = keys
        super().forward(keys, gradient)

    def take_states(self) -> None:
        """Copy the states of arm and box to the model that the viewers show and the checks use."""
        coords, dofs = self.model.joint_coord_count, self.model.joint_dof_count
        self.box, self.box_rate = np.zeros((2, STEPS))
        for t in range(STEPS + 1):
            full, arm = self.trajectory[t], self.states[t]
            q, qd = full.joint_q.numpy(), full.joint_qd.numpy()
            poses = full.body_q.numpy()
            arm.joint_q.assign(q[:coords])
            arm.joint_qd.assign(qd[:dofs])
            arm.body_q.assign(poses[: self.model.body_count])
            if t > 0:
                self.box[t - 1], self.box_rate[t - 1] = q[coords], qd[dofs]
                hand = poses[self.hand].astype(np.float64)
                turn = np.cross(hand[3:6], TIP) + hand[6] * np.array(TIP)
                self.tip[t - 1] = hand[:3] + TIP + 2.0 * np.cross(hand[3:6], turn)

    def check_gradient(self) -> bool:
        """Compare gradients with differences along five random directions.

        Print the cosines between the differences and two gradients: this one, and the gradient
        without the reaction of the box.
        """
        rng = np.random.default_rng(7)
        directions = rng.normal(size=(5, KEYS, AXES))
        directions /= np.linalg.norm(directions, axis=(1, 2), keepdims=True)
        fd = np.array([self.difference(direction) for direction in directions])
        flat, passed = directions.reshape(5, -1), True
        alone = FrankaPush(str(self.model.device), self.sensitivity.label != "frozen")
        alone.keys = self.keys
        for scene in (self, alone):
            ad = flat @ scene.gradient()[1]
            cosine = ad @ fd / (np.linalg.norm(ad) * np.linalg.norm(fd))
            ratio = np.linalg.norm(ad) / np.linalg.norm(fd)
            print(f"{scene.label()}: cosine {cosine:.3f}, ratio of lengths {ratio:.2f}")
            print(f"  along five directions {np.round(ad, 5)}, differences {np.round(fd, 5)}")
            passed = passed and (scene is alone or cosine >= AGREE)
        info = self.steps.gradient_info()
        print(
            f"  of {info['contact_steps']} steps with contacts {info['exact_steps']} are exact and "
            f"{info['frozen_steps']} frozen, the others surrogate"
        )
        return passed
