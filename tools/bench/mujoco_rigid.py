#!/usr/bin/env python3
"""Time MuJoCo on rigid bodies. rigid.py describes scenes and records.

All options but friction have MuJoCo's defaults. Contacts are constraints: a time constant
(`solref`) and not a stiffness determines how deep bodies overlap.
    pip install mujoco==4.0.0
    python tools/bench/mujoco_rigid.py --scene columns --n 1000
"""

from __future__ import annotations

import mujoco
import numpy as np
from rigid import DENSITY, GRAVITY, HALF, SURFACE, box_poses, run


class Boxes:
    """Boxes under gravity on the ground."""

    dt = 1.0 / 500

    def __init__(self, scene: str, n: int, turn: float, factor: float, device: str) -> None:
        """Build the model. MuJoCo runs on the CPU, and its contacts have no stiffness."""
        if factor != 1.0:
            raise SystemExit(f"mujoco_rigid: --stiffer: expected 1, got {factor}")
        if device != "cpu":
            raise SystemExit(f"mujoco_rigid: --device: expected cpu, got {device}")
        bodies = []
        for pose in box_poses(scene, n, turn):
            place = " ".join(map(str, pose[:3]))
            turned = " ".join(map(str, (pose[6], *pose[3:6])))
            bodies.append(
                f'<body pos="{place}" quat="{turned}"><freejoint/>'
                f'<geom type="box" size="{HALF} {HALF} {HALF}" density="{DENSITY}"/></body>'
            )
        text = f"""<mujoco><option timestep="{self.dt}" gravity="0 0 {-GRAVITY}"/>
            <default><geom friction="{SURFACE["mu"]} 0.005 0.0001"/></default>
            <size memory="2G"/>
            <worldbody><geom type="plane" size="0 0 1"/>{"".join(bodies)}</worldbody></mujoco>"""
        self.model = mujoco.MjModel.from_xml_string(text)
        self.data = mujoco.MjData(self.model)

    def step(self) -> None:
        """Run one step."""
        mujoco.mj_step(self.model, self.data)

    def contacts(self) -> np.ndarray:
        """Return the contact depths of the last step {count} (m)."""
        return -np.array(self.data.contact.dist)


if __name__ == "__main__":
    run(__doc__, "mujoco", Boxes, ("columns", "pile"))
