"""Model.select: finds joints, bodies, shapes and actuators by name, and their rows in arrays."""

from __future__ import annotations

from fnmatch import fnmatchcase
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _core

_COORDS = ("joint_q", "joint_target_q")
_OF_JOINTS = frozenset(
    "joint_" + name
    for name in (
        "X_c", "X_p", "ancestor", "articulation", "child", "dof_dim", "enabled", "mimic",
        "mimic_coef", "parent", "type", "world",
    )
)  # fmt: skip


class Selection:
    """The joints, bodies, shapes and actuators that Model.select found.

    The attributes joints, bodies, shapes, sites, actuators, coords and dofs are indices in
    ascending order. coords and dofs are the rows of the joints in joint_q and joint_qd. Sites are
    shapes with ShapeFlags.SITE.

    `view` gives access to the selected rows of an array, `get` copies them, and `set` writes them.
    The values have the shape {worlds, rows, ...} if several worlds have the same number of rows,
    else {rows, ...}.
    """

    joints: NDArray[np.int32]
    bodies: NDArray[np.int32]
    shapes: NDArray[np.int32]
    sites: NDArray[np.int32]
    actuators: NDArray[np.int32]
    coords: NDArray[np.int32]
    dofs: NDArray[np.int32]

    def __init__(self, model: _core.Model, pattern: str, world: int | None) -> None:
        if not isinstance(pattern, str):
            raise TypeError(f"select: pattern: expected a str, got {pattern!r}")
        if world is not None and not -1 <= world < model.world_count:
            last = model.world_count - 1
            raise IndexError(f"select: world: expected -1 to {last}, got {world}")
        found = _Names(model, pattern, world)
        kinds = ("joints", "bodies", "shapes", "actuators", "coords", "dofs")
        counts = ("joint", "body", "shape", "actuator", "joint_coord", "joint_dof")
        self._counts = {
            kind: getattr(model, name + "_count") for kind, name in zip(kinds, counts, strict=True)
        }
        self._worlds: dict[str, NDArray[np.int32]] = {}
        for kind, (rows, worlds) in zip(kinds, found.rows(), strict=True):
            setattr(self, kind, rows)
            self._worlds[kind] = worlds
        if not any(found.found.values()):
            raise ValueError(
                "select: pattern: expected the name of a joint, body, shape or actuator, "
                f"got {pattern!r}"
            )
        flags = model.shape_flags.numpy()[self.shapes]
        self.sites = self.shapes[(flags & int(_core.ShapeFlags.SITE)) != 0]

    def rows(self, field: str) -> NDArray[np.int32]:
        """Return the selected row indices of a field such as joint_q, body_qd or ctrl.

        The field belongs to a Model, SimState or Control.
        """
        return getattr(self, self._kind(field))  # type: ignore[no-any-return]

    def view(self, owner: Any, field: str) -> RowsView:
        """Return a view of the selected rows of `owner.field`, for reading and writing in place."""
        kind = self._kind(field)
        rows = getattr(self, kind)
        array = getattr(owner, field)
        if array.shape[0] != self._counts[kind]:
            raise ValueError(
                f"Selection: field: expected one with a row for each of the {self._counts[kind]} "
                f"{kind}, got {field!r} with {array.shape[0]} rows"
            )
        counts = np.unique(self._worlds[kind], return_counts=True)[1]
        if len(counts) > 1 and (counts == counts[0]).all():
            rows = rows.reshape(len(counts), counts[0])
        return RowsView(array, rows)

    def get(self, owner: Any, field: str) -> NDArray[Any]:
        """Return a copy of the selected rows of `owner.field`."""
        return self.view(owner, field)[...]

    def set(self, owner: Any, field: str, values: ArrayLike) -> None:
        """Write the selected rows of `owner.field`; values are broadcast to the shape of `get`."""
        self.view(owner, field)[...] = values

    @staticmethod
    def _kind(field: str) -> str:
        if field in _COORDS:
            return "coords"
        if field in _OF_JOINTS:
            return "joints"
        if field == "ctrl" or field.startswith("actuator_"):
            return "actuators"
        for start, kind in (("body_", "bodies"), ("shape_", "shapes"), ("joint_", "dofs")):
            if field.startswith(start):
                return kind
        raise ValueError(
            f"Selection: field: expected one of joints, bodies, shapes or actuators, got {field!r}"
        )


class RowsView:
    """Selected rows of an array: view[key] reads current values, view[key] = values writes them.

    A key is a NumPy index for the shape of the view. np.asarray(view) copies all values. On the CPU
    view[key] copies the values of the key only. A tape detects writes through the view by the
    contents of the array, as after array.numpy(copy=False, writable=True).
    """

    def __init__(self, array: _core.DeviceArray, rows: NDArray[np.int32]) -> None:
        self._array = array
        shape = array.shape[1:]
        width = int(np.prod(shape))
        places = rows[..., None] * np.int64(width) + np.arange(width)
        self._places = places.reshape(*rows.shape, *shape)  # indices into the flattened array

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape of the values, as in NumPy."""
        return self._places.shape

    def __len__(self) -> int:
        return len(self._places)

    def __repr__(self) -> str:
        return f"RowsView({self[...]!r})"

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        if copy is False:
            raise ValueError("RowsView: copy: the rows are no array of their own, got copy=False")
        return self[...] if dtype is None else self[...].astype(dtype)

    def __getitem__(self, key: Any) -> Any:
        memory = self._array.numpy(copy=not self._array.device.is_cpu)
        return memory.reshape(-1)[self._places[key]]

    def __setitem__(self, key: Any, values: ArrayLike) -> None:
        places = self._places[key]
        given = np.asarray(values)
        try:
            given = np.broadcast_to(given, places.shape)
        except ValueError:
            raise ValueError(
                f"RowsView: values: expected the shape {places.shape}, got {given.shape}"
            ) from None
        on_cpu = self._array.device.is_cpu
        memory = self._array.numpy(copy=not on_cpu, writable=True)
        memory.reshape(-1)[places] = given
        if not on_cpu:
            self._array.assign(memory)


class _Names:
    """Finds joints, bodies, shapes and actuators by name or by articulation/name."""

    def __init__(self, model: _core.Model, pattern: str, world: int | None) -> None:
        of_joint = model.joint_articulation.numpy()
        worlds = {
            kind: getattr(model, f"{kind}_world").numpy() for kind in ("joint", "body", "shape")
        }
        names = ["" if a < 0 else model.articulation_label[a] for a in of_joint]
        self.starts = {"coords": model.joint_q_start.numpy(), "dofs": model.joint_qd_start.numpy()}
        owner = dict(zip(model.joint_child.numpy().tolist(), names, strict=True))
        joint_of = np.searchsorted(self.starts["dofs"], model.actuator_dof.numpy(), "right") - 1
        for k in np.flatnonzero(model.actuator_dof.numpy() < 0):
            body = model.actuator_body.numpy()[k].max()  # one of the two bodies may be the world
            joint_of[k] = model.joint_child.numpy().tolist().index(body)

        def matches(label: str, articulation: str, of_world: int) -> bool:
            if world is not None and of_world != world:
                return False
            return fnmatchcase(label, pattern) or fnmatchcase(f"{articulation}/{label}", pattern)

        self.world = {**worlds, "actuator": worlds["joint"][joint_of]}
        self.found = {
            "joint": [
                j for j, label in enumerate(model.joint_label)
                if matches(label, names[j], worlds["joint"][j])
            ],
            "body": [
                b for b, label in enumerate(model.body_label)
                if matches(label, owner.get(b, ""), worlds["body"][b])
            ],
            "shape": [
                s for s, (label, body) in enumerate(
                    zip(model.shape_label, model.shape_body.numpy().tolist(), strict=True)
                )
                if matches(label, owner.get(body, ""), worlds["shape"][s])
            ],
            "actuator": [
                k for k, label in enumerate(model.actuator_label)
                if matches(label, names[joint_of[k]], worlds["joint"][joint_of[k]])
            ],
        }  # fmt: skip

    def rows(self) -> list[tuple[NDArray[np.int32], NDArray[np.int32]]]:
        """Return (rows, world of each row) of joints, bodies, shapes, actuators, coords, dofs."""
        pairs = [(rows, self.world[kind][rows]) for kind, rows in self.found.items()]
        joints = self.found["joint"]
        for starts in self.starts.values():
            rows = [row for j in joints for row in range(starts[j], starts[j + 1])]
            of_rows = [w for j in joints for w in
                       [self.world["joint"][j]] * int(starts[j + 1] - starts[j])]  # fmt: skip
            pairs.append((rows, np.array(of_rows, np.int32)))
        return [(np.array(rows, np.int32), worlds) for rows, worlds in pairs]
