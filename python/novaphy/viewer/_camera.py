"""The camera of a viewer: position, direction, and control by the pointer."""

from __future__ import annotations

import numpy as np

FIELD_OF_VIEW = 40.0  # degrees, from the bottom to the top of the image
CLOSEST = 1e-3  # m, smallest distance of the camera from its target


class Camera:
    """A camera at `pos` that looks at `target`; the up direction is an axis of the world."""

    def __init__(self, up_axis: int = 2) -> None:
        """Place the camera at a default position away from the origin."""
        self.up_axis = up_axis
        self.is_set = False
        self.target = np.zeros(3)
        self.distance = 5.0
        self.yaw, self.pitch = 55.0, -20.0  # viewing direction (degrees)

    @property
    def up(self) -> np.ndarray:
        """The up direction of the world, a unit vector {3}."""
        return np.eye(3)[self.up_axis]

    @property
    def forward(self) -> np.ndarray:
        """The viewing direction, a unit vector {3}."""
        yaw, pitch = np.radians([self.yaw, self.pitch])
        direction = np.zeros(3)
        direction[(self.up_axis + 1) % 3] = np.cos(yaw) * np.cos(pitch)
        direction[(self.up_axis + 2) % 3] = np.sin(yaw) * np.cos(pitch)
        direction[self.up_axis] = np.sin(pitch)
        return direction

    @property
    def pos(self) -> np.ndarray:
        """The position of the camera (m)."""
        return self.target - self.distance * self.forward

    def place(self, pos: np.ndarray, pitch: float | None, yaw: float | None) -> None:
        """Move the camera to `pos` (m). Without angles (degrees) the camera looks at its target."""
        away = self.target - pos
        self.distance = max(float(np.linalg.norm(away)), CLOSEST)
        flat = away[[(self.up_axis + 1) % 3, (self.up_axis + 2) % 3]]
        if yaw is None:
            yaw = float(np.degrees(np.arctan2(flat[1], flat[0])))
        if pitch is None:
            pitch = float(np.degrees(np.arctan2(away[self.up_axis], np.linalg.norm(flat))))
        self.yaw, self.pitch = float(yaw), float(pitch)
        self.target = pos + self.distance * self.forward
        self.is_set = True

    def frame(self, lower: np.ndarray, upper: np.ndarray) -> None:
        """Move the camera so that a whole box is visible."""
        self.target = 0.5 * (lower + upper)
        radius = 0.5 * float(np.linalg.norm(upper - lower))
        self.distance = max(1.1 * radius / np.sin(np.radians(FIELD_OF_VIEW / 2)), 10 * CLOSEST)

    def orbit(self, right: float, up: float) -> None:
        """Rotate the camera around the target by angles in degrees."""
        self.yaw -= right
        self.pitch = float(np.clip(self.pitch - up, -89.0, 89.0))
        self.is_set = True

    def pan(self, right: float, up: float) -> None:
        """Move the camera sideways by fractions of the image's height."""
        side, above, _ = self.axes()
        height = 2.0 * self.distance * np.tan(np.radians(FIELD_OF_VIEW / 2))
        self.target = self.target - height * (right * side + up * above)
        self.is_set = True

    def zoom(self, factor: float) -> None:
        """Multiply the distance to the target by a factor; below 1 the camera gets nearer."""
        self.distance = max(self.distance * factor, CLOSEST)
        self.is_set = True

    def axes(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the right, up and forward directions of the image, unit vectors {3}."""
        forward = self.forward
        side = np.cross(forward, self.up)
        side /= np.linalg.norm(side)
        return side, np.cross(side, forward), forward

    def view_projection(self, aspect: float) -> np.ndarray:
        """Return the matrix {4, 4} from world to clip coordinates, for column vectors."""
        side, above, forward = self.axes()
        view = np.eye(4)
        view[:3, :3] = [side, above, -forward]
        view[:3, 3] = -view[:3, :3] @ self.pos
        near, far = 0.01 * self.distance, 100.0 * self.distance
        f = 1.0 / np.tan(np.radians(FIELD_OF_VIEW / 2))
        projection = np.zeros((4, 4))
        projection[0, 0], projection[1, 1] = f / aspect, f
        projection[2, 2], projection[2, 3] = (
            (far + near) / (near - far),
            2 * far * near / (near - far),
        )
        projection[3, 2] = -1.0
        return projection @ view

    def project(self, points: np.ndarray, width: int, height: int) -> np.ndarray:
        """Project points {n, 3} (m) to pixels {n, 2}, counted from the upper left corner."""
        clip = np.pad(points, ((0, 0), (0, 1)), constant_values=1.0)
        clip = clip @ self.view_projection(width / height).T
        x, y = (clip[:, :2] / clip[:, 3:]).T
        return np.stack([0.5 * (1 + x) * width, 0.5 * (1 - y) * height], axis=-1)

    def ray(self, x: float, y: float, width: int, height: int) -> np.ndarray:
        """Return the direction from the camera through a pixel."""
        side, above, forward = self.axes()
        size = np.tan(np.radians(FIELD_OF_VIEW / 2))
        right, up = (2 * x / width - 1) * size * width / height, (1 - 2 * y / height) * size
        direction = forward + right * side + up * above
        return direction / np.linalg.norm(direction)
