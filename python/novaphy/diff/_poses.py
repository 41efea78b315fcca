"""pose_tangent_gradient: converts gradients by poses {7} to displacements and rotations {6}."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray


def pose_tangent_gradient(body_q: ArrayLike, gradient: ArrayLike) -> NDArray[np.float32]:
    """Return the gradient with respect to displacements and small rotations of poses.

    A gradient by `body_q` treats the seven numbers of a pose as independent. Its component along
    the quaternion has no meaning, because only unit quaternions are rotations. The result is the
    gradient by six numbers. The first three are a displacement d (m), which moves the position p to
    p + d. The last three are a small rotation r (rad) in the world frame, which changes the
    quaternion q to q + (r, 0) q / 2.

    Args:
        body_q: poses {n, 7} or {7}: position (m), unit quaternion x, y, z, w.
        gradient: the gradient by `body_q`, of the same shape.

    Returns:
        {n, 6} or {6}: the derivative by d (per m), then by r (per rad), in the world frame.

    Raises:
        ValueError: the shapes do not fit, or a quaternion does not have length 1 (to 1e-3).
    """
    q, g = np.asarray(body_q, np.float32), np.asarray(gradient, np.float32)
    if q.ndim not in (1, 2) or q.shape[-1] != 7:
        raise ValueError(f"body_q: expected {{n, 7}} or {{7}}, got {q.shape}")
    if g.shape != q.shape:
        raise ValueError(f"gradient: expected {q.shape}, as body_q, got {g.shape}")
    length = np.linalg.norm(q[..., 3:], axis=-1)
    if not (np.abs(length - 1.0) <= 1e-3).all():
        raise ValueError(
            f"body_q: expected quaternions of length 1 (to 1e-3), got {length.ravel()}"
        )
    v, w = q[..., 3:6], q[..., 6:]
    gv, gw = g[..., 3:6], g[..., 6:]
    # With q = (v, w), (r, 0) q / 2 has the vector (r w + r x v) / 2 and the scalar -r . v / 2.
    turn = 0.5 * (w * gv + np.cross(v, gv) - v * gw)
    return np.concatenate([g[..., :3], turn], axis=-1)
