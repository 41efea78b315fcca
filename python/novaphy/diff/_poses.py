"""Gradients of poses in six numbers."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray


def pose_tangent_gradient(body_q: ArrayLike, gradient: ArrayLike) -> NDArray[np.float32]:
    """Return the gradient with respect to displacements and small rotations of poses.

    A gradient by `body_q` is that of seven free numbers, and its part along the quaternion only
    stretches the quaternion. A displacement d moves a pose to p + d. A small rotation r (rad) in
    the world turns the pose to q + (r, 0) q / 2. The result is the gradient with respect to d and
    r.

    Args:
        body_q: poses {n, 7} (or one, {7}): position (m), unit quaternion x, y, z, w.
        gradient: the gradient by `body_q`, of the same shape.

    Returns:
        {n, 6} (or {6}): by d (1/m), then by r (1/rad), world frame.

    Raises:
        ValueError: shapes that do not fit, or a quaternion that is not of length 1 (to 1e-3).
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
    # d (r, 0) q / 2: the vector r w + r x v, the scalar -r . v.
    turn = 0.5 * (w * gv + np.cross(v, gv) - v * gw)
    return np.concatenate([g[..., :3], turn], axis=-1)
