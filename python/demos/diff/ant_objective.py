"""The objective of the Ant that learns from zero: a trot, a servo that follows it, and the loss.

The trot is a reference motion of the hinges, in which diagonal legs move in phase. All weights of
the actor start at zero, and the trot breaks this symmetry. At first a servo at the hinges follows
the trot, so that the Ant walks before the actor has learned anything. The strength of the servo is
reduced while the actor learns. Trained actors walk without the servo.
"""

from __future__ import annotations

import numpy as np

from novaphy.envs import ACTIONS, FEET, AntWorlds, rotate

FPS = 20
PERIOD = 14  # frames in a period of the trot
# Parameters of the trot (rad). A hip swings with the amplitude SWAY about OFFSET, and its phase is
# AHEAD of the lift of the foot. An ankle bends by ANKLE, with the amplitude LIFT. Hind legs bend by
# HIND_BEND more and lift by HIND_LIFT more; front legs less. REACH couples the ankles to the hips,
# so that standing feet move straight back below the torso. Two second harmonics shape the motion:
# LIFT_2 makes a foot stand for half of the period, and SWAY_2 makes its speed constant.
SWAY, OFFSET, AHEAD = 0.056, 0.05, 0.12
ANKLE, LIFT, HIND_BEND, HIND_LIFT, REACH = 1.264, 0.30, 0.079, 0.1, 0.075
SWAY_2, LIFT_2 = 0.28, 0.28
HIP_SIGN, ANKLE_SIGN = np.array([1.0, 1.0, -1.0, -1.0]), np.array([1.0, -1.0, -1.0, 1.0])
FRONT = np.array([1.0, -1.0, -1.0, 1.0])
DIAGONAL = np.array([0.0, np.pi, 0.0, np.pi])  # phase of each leg (rad)
STIFFNESS, DAMPING = 1000.0, 70.0  # gains of the servo (N m/rad, N m s/rad)
SERVO_SAMPLE = 5  # substeps between two updates of the servo's targets
SPEED = 0.3  # m/s, the desired speed of the torso
CLEARANCE, TOUCHING = 0.06, 0.004  # m: desired height of a swinging foot; lower feet touch
RATE = 0.06  # s, weight of the rates relative to the angles in the loss term "pose"
WEIGHTS = {
    "speed": 5.0, "tilt": 130.0, "heading": 20.0, "drift": 8.0, "pose": 5.0, "jump": 0.05,
    "symmetry": 0.25, "clearance": 150.0, "slip": 1.0, "turn": 0.09,
}  # fmt: skip
FREE = {**WEIGHTS, "speed": 25.0, "slip": 1.5}  # weights for stages without the servo
FAST = {**FREE, "speed": 150.0}  # weights for training in several different worlds
# Directions from the torso's center to the hips; lengths of leg and foot (m).
SIDES = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
LEG, FOOT, TIP_RADIUS = 0.2 * np.sqrt(2.0), 0.4 * np.sqrt(2.0), 0.08
ROWS = 40


def phase(frame: np.ndarray) -> np.ndarray:
    """Return the phase (rad) of the trot at a frame."""
    return 2.0 * np.pi * np.asarray(frame) / PERIOD


def reference(frame: np.ndarray, trot: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Return the hinge angles {n, 8} (rad) of the trot at frames {n}, and their rates (rad/s).

    `frame` may have fractional numbers. `trot` scales the strides; 0 gives the stance.
    """
    p, w = phase(frame)[:, None] + DIAGONAL, 2.0 * np.pi * FPS / PERIOD
    ahead = p + AHEAD
    sway, sway_rate = np.sin(ahead) + SWAY_2 * np.sin(2 * ahead), np.cos(ahead)
    sway, sway_rate = trot * sway, trot * w * (sway_rate + 2.0 * SWAY_2 * np.cos(2 * ahead))
    lift = trot * 0.5 * (np.cos(p) + LIFT_2 * np.cos(2 * p) + 1.0 - LIFT_2)
    lift_rate = trot * -0.5 * w * (np.sin(p) + 2.0 * LIFT_2 * np.sin(2 * p))
    high = LIFT - HIND_LIFT * FRONT
    bend = ANKLE - HIND_BEND * FRONT - REACH * FRONT * sway - high * lift
    pose, rate = np.empty((2, len(p), ACTIONS))
    pose[:, 0::2], rate[:, 0::2] = HIP_SIGN * (OFFSET - SWAY * sway), -HIP_SIGN * SWAY * sway_rate
    pose[:, 1::2] = ANKLE_SIGN * bend
    rate[:, 1::2] = -ANKLE_SIGN * (REACH * FRONT * sway_rate + high * lift_rate)
    return pose, rate


class Servo:
    """Drives at the hinges of a batch that follow the trot, implicit in every substep."""

    def __init__(self, ants: AntWorlds) -> None:
        """Make a servo with strength 0."""
        self.ants, self.strength, self.trot = ants, 0.0, 1.0
        self.q = ants.control.joint_target_q.numpy().reshape(ants.num_worlds, -1)
        self.qd = ants.control.joint_target_qd.numpy().reshape(ants.num_worlds, -1)

    def set(self, strength: float, trot: float = 1.0) -> None:
        """Set the strength, a factor of STIFFNESS and DAMPING, and the scale of the strides."""
        self.trot = trot
        if strength == self.strength:
            return
        self.strength, model = strength, self.ants.model
        for array, value in ((model.joint_target_ke, STIFFNESS), (model.joint_target_kd, DAMPING)):
            numbers = array.numpy().reshape(self.ants.num_worlds, -1)
            numbers[:, 6:] = strength * value
            array.assign(numbers.ravel())
        self.ants.solver.notify_model_changed(0)

    def lead(self, frame: np.ndarray, substep: int) -> None:
        """Set the servo's targets for frames {worlds}, if an update is due in the substep."""
        if self.strength > 0.0 and substep % SERVO_SAMPLE == 0:
            middle = (substep + 0.5 * (SERVO_SAMPLE - 1)) / self.ants.substeps
            now = reference(frame + middle, self.trot)
            self.q[:, -ACTIONS:], self.qd[:, -ACTIONS:] = now
            self.ants.control.joint_target_q.assign(self.q.ravel())
            self.ants.control.joint_target_qd.assign(self.qd.ravel())


def axis(q: np.ndarray, k: int) -> np.ndarray:
    """Return axis k of the torso's frame in the world {n, 3}."""
    return rotate(q[:, 3:7].astype(np.float64), np.broadcast_to(np.eye(3)[k], (len(q), 3)))


def foot_motion(q: np.ndarray, qd: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return heights and velocities of the feet, with their derivatives.

    The four arrays are the heights {n, 4} (m), the derivatives of heights by tangents {n, 4, 14},
    the horizontal velocities of the lowest points {n, 4, 2} (m/s), and the derivatives of these
    velocities by the rates {n, 4, 2, 14}. Tangents are defined in ant_gradients.py.
    """
    n, legs = len(q), len(FEET)
    bend = q[:, 8::2] * ANKLE_SIGN
    turn = np.arctan2(SIDES[:, 1], SIDES[:, 0]) + q[:, 7::2]
    c, s, zero = np.cos(turn), np.sin(turn), np.zeros_like(turn)
    reach, fall = LEG + FOOT * np.cos(bend), -FOOT * np.sin(bend)

    def world(*parts: np.ndarray) -> np.ndarray:
        v = np.stack(parts, axis=-1)
        return rotate(np.broadcast_to(q[:, None, 3:7], (n, legs, 4)), v)

    tip = world(0.2 * SIDES[:, 0] + reach * c, 0.2 * SIDES[:, 1] + reach * s, fall)
    by_hip = world(-reach * s, reach * c, zero)
    by_bend = world(fall * c, fall * s, -FOOT * np.cos(bend))
    # The velocity of the lowest point relative to the tip's center: rate x (vector to that point).
    down = np.array([0.0, 0.0, -TIP_RADIUS])
    up = world(zero, zero, zero + 1.0)
    bending = np.cross(up, world(c, s, zero))
    j, k = np.zeros((2, n, legs, 3, 14))
    j[..., :3] = k[..., :3] = np.eye(3)
    for i in range(3):
        e = np.eye(3)[i]
        j[..., 3 + i], k[..., 3 + i] = np.cross(e, tip), np.cross(e, tip + down)
    for leg in range(legs):
        hip, ankle, sign = 6 + 2 * leg, 7 + 2 * leg, ANKLE_SIGN[leg]
        j[:, leg, :, hip], j[:, leg, :, ankle] = by_hip[:, leg], sign * by_bend[:, leg]
        k[:, leg, :, hip] = by_hip[:, leg] + np.cross(up[:, leg], down)
        k[:, leg, :, ankle] = sign * (by_bend[:, leg] + np.cross(bending[:, leg], down))
    height = q[:, 2:3] + tip[..., 2] - TIP_RADIUS
    k = k[:, :, :2]
    return height, j[:, :, 2], np.einsum("nlks,ns->nlk", k, qd), k


def residuals(q, qd, a, last, frame, weights=WEIGHTS, trot=1.0):
    """Return the residuals {n, 40} at the ends of frames, whose sum of squares is the loss.

    Also return their derivatives by tangents and rates {n, 40, 28}, and by the actions {n, 40, 8}.
    The derivative by the actions of the frame before (`last`) is the negative of the derivative by
    the actions. `trot` scales the strides and the speed; 0: the Ant stands.
    """
    w = {name: np.sqrt(value) for name, value in weights.items()}
    n = len(q)
    q, qd = q.astype(np.float64), qd.astype(np.float64)
    r, by_state, by_action = np.zeros((n, ROWS)), np.zeros((n, ROWS, 28)), np.zeros((n, ROWS, 8))
    up, ahead = axis(q, 2), axis(q, 0)
    r[:, 0] = w["speed"] * (qd[:, 0] - trot * SPEED)
    by_state[:, 0, 14] = w["speed"]
    r[:, 1:3] = w["tilt"] * up[:, :2]
    r[:, 3] = w["heading"] * ahead[:, 1]
    for row, vector, k in ((1, up, 0), (2, up, 1), (3, ahead, 1)):  # e x vector, component k
        by_state[:, row, 3:6] = w["heading" if row == 3 else "tilt"] * np.cross(
            vector, np.eye(3)[k]
        )
    r[:, 4], by_state[:, 4, 1] = w["drift"] * q[:, 1], w["drift"]
    pose, rate = reference(np.asarray(frame) + 1.0, trot)
    r[:, 6:14] = w["pose"] * (q[:, 7:] - pose + RATE * (qd[:, 6:] - rate))
    by_state[:, 6:14, 6:14] = w["pose"] * np.eye(8)
    by_state[:, 6:14, 20:28] = w["pose"] * RATE * np.eye(8)
    # Hinges of diagonally opposite legs should mirror each other, so that their sums are 0.
    r[:, 14:18] = w["symmetry"] * (q[:, 7:11] + q[:, 11:15])
    by_state[:, 14:18, 6:10] = by_state[:, 14:18, 10:14] = w["symmetry"] * np.eye(4)
    r[:, 18:26], by_action[:, 18:26] = w["jump"] * (a - last), w["jump"] * np.eye(8)
    # Swinging feet should be high enough. Standing and touching feet should not slip.
    height, by_tangent, speed, by_rate = foot_motion(q, qd)
    wave = trot * (np.cos(phase(np.asarray(frame) + 1.0)[:, None] + DIAGONAL) + 1.0) - 1.0
    low = np.minimum(height - CLEARANCE * np.maximum(wave, 0.0), 0.0) * (wave > 0.0)
    r[:, 26:30] = w["clearance"] * low
    by_state[:, 26:30, :14] = w["clearance"] * by_tangent * (low < 0.0)[..., None]
    stands = ((wave < -0.2) | (height < TOUCHING))[..., None]
    r[:, 30:38] = (w["slip"] * speed * stands).reshape(n, 8)
    by_state[:, 30:38, 14:] = (w["slip"] * by_rate * stands[..., None]).reshape(n, 8, 14)
    r[:, 38:40] = w["turn"] * qd[:, 3:5]
    by_state[:, 38, 17] = by_state[:, 39, 18] = w["turn"]
    return r, by_state, by_action
