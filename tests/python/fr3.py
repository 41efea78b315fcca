"""The Franka Research 3 built link by link, with the numbers of franka_description (Apache-2.0)."""

from __future__ import annotations

import numpy as np

import novaphy

HALF = 0.5 * np.pi
# xyz, roll of each joint's frame in its parent; all axes are z.
FRAMES = (
    ((0.0, 0.0, 0.333), 0.0),
    ((0.0, 0.0, 0.0), -HALF),
    ((0.0, -0.316, 0.0), HALF),
    ((0.0825, 0.0, 0.0), HALF),
    ((-0.0825, 0.384, 0.0), -HALF),
    ((0.0, 0.0, 0.0), HALF),
    ((0.088, 0.0, 0.0), HALF),
)
LOWER = (-2.7437, -1.7837, -2.9007, -3.0421, -2.8065, 0.5445, -3.0159)
UPPER = (2.7437, 1.7837, 2.9007, -0.1518, 2.8065, 4.5169, 3.0159)
EFFORT = (87.0, 87.0, 87.0, 87.0, 12.0, 12.0, 12.0)
VELOCITY = (2.62, 2.62, 2.62, 2.62, 5.26, 4.18, 5.26)
KE = (600.0, 600.0, 600.0, 600.0, 250.0, 150.0, 50.0)
KD = (50.0, 50.0, 50.0, 50.0, 30.0, 25.0, 15.0)
MASS = (2.9274653, 2.9355370, 2.2449014, 2.6155956, 2.3271208, 1.8170377, 0.6271433)
COM = (
    (4.128e-7, -0.0181251324, -0.0386035970),
    (0.0031828864, -0.0743221644, 0.0088146084),
    (0.0407015686, -0.0048200565, -0.0289730823),
    (-0.0459100965, 0.0630492960, -0.0085187868),
    (-0.0016039605, 0.0292536262, -0.0972965990),
    (0.0597131221, -0.0410294666, -0.0101692726),
    (0.0045225817, 0.0086261921, -0.0161633251),
)
# xx, yy, zz, xy, xz, yz about the center of mass
INERTIA = (
    (0.0239273165, 0.0224821614, 0.0063500983, 1.33179e-5, -1.14047749e-4, -0.0019950321),
    (0.0419389463, 0.0251451489, 0.0617021447, 2.02573315e-4, 0.0040777842, -0.0042252158),
    (0.0241014252, 0.0197405327, 0.0190444945, 0.0024046946, -0.0028562693, -0.0021042127),
    (0.0345299832, 0.0288816219, 0.0412547117, 0.0132255227, 0.0101514300, -9.76283387e-4),
    (0.0516102785, 0.0478772971, 0.0164236256, -0.0057151734, -0.0035673168, 0.0106739851),
    (0.0054123336, 0.0140583295, 0.0160808179, 0.0061934564, 0.0014219289, -0.0013140754),
    (2.10923892e-4, 1.7718568e-4, 5.99319060e-5, -2.43329911e-5, 4.56448038e-5, 8.74407022e-5),
)
TCP = (0.0, 0.0, 0.107 + 0.1034)  # in the frame of link 7


def builder(**dof: object) -> novaphy.ModelBuilder:
    """The arm without hand, seven revolute joints with the drives of the push-box scene."""
    b = novaphy.ModelBuilder()
    parent, joints = -1, []
    for k, (xyz, roll) in enumerate(FRAMES):
        xx, yy, zz, xy, xz, yz = INERTIA[k]
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        link = b.add_link(mass=MASS[k], com=COM[k], inertia=inertia, lock_inertia=True)
        turn = (np.sin(0.5 * roll), 0.0, 0.0, np.cos(0.5 * roll))
        joints.append(
            b.add_joint_revolute(
                parent,
                link,
                parent_xform=(*xyz, *turn),
                axis=(0.0, 0.0, 1.0),
                **{
                    "target_ke": KE[k],
                    "target_kd": KD[k],
                    "damping": 0.003,
                    "limit_lower": LOWER[k],
                    "limit_upper": UPPER[k],
                    "effort_limit": EFFORT[k],
                    "velocity_limit": VELOCITY[k],
                    "actuator_mode": novaphy.JointTargetMode.POSITION,
                }
                | dof,
            )
        )
        parent = link
    b.add_articulation(joints)
    return b
