"""Bodies: mass matrix, velocity forces and frames of the rigid bodies of plant.xml, through the library adam.

All in axes of B with nu = [v_B; w_B; joint_rate]. A steady translation and gravity are left out: with the base's proper
acceleration a_B = R_WB' (a_WB + g e_z), which an accelerometer there would read,

    M(q) [a_B; dw_B; joint_acceleration] + c(q, w_B, joint_rate) = forces

holds in every attitude and at every speed, so M and c know nothing of the base's pose, its velocity or gravity.
"""

from typing import Any

import adam
import casadi as ca
import mujoco
import numpy as np
from adam.casadi import KinDynComputations

from aerotact.robot import Robot

_DUST = 1e-15


class Bodies:
    """The tree of bodies of a robot with joints.

    Attributes:
        joints: names in the order of q: passive joints, then the arms' joints.
        indices: their ids in plant.xml.
    """

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        model = robot.mjmodel
        joints = [*robot.passive, *(joint for arm in robot.arms for joint in arm.joints)]
        self.joints = tuple(joint.name for joint in joints)
        self.indices = tuple(joint.index for joint in joints)
        self._armature = model.dof_armature[model.jnt_dofadr[list(self.indices)]]
        self._tree = KinDynComputations.from_mujoco_model(model, joints_name_list=list(self.joints))
        self._tree.set_frame_velocity_representation(adam.Representations.BODY_FIXED_REPRESENTATION)

    def mass_matrix(self, q: Any) -> Any:
        """M, shape (6 + n, 6 + n), for joint angles q (n,), rad."""
        armature = np.concatenate([np.zeros(6), self._armature])
        return ca.cse(self._tree.mass_matrix(ca.SX.eye(4), q)) + ca.diag(ca.DM(armature))

    def velocity_forces(self, q: Any, w_B: Any, rate: Any) -> Any:
        """c, shape (6 + n,): centrifugal and Coriolis forces."""
        twist = ca.vertcat(ca.SX.zeros(3), w_B)
        return self._tree.rbdalgos.rnea(ca.SX.eye(4), q, twist, rate, np.zeros(6)).array

    def site(self, index: int, q: Any) -> tuple[Any, Any]:
        """Position p_BS (3,), m, and rotation R_BS (3, 3) of a site of plant.xml, by its id."""
        model = self._robot.mjmodel
        body = model.body(model.site_bodyid[index]).name
        H = self._tree.forward_kinematics(body, ca.SX.eye(4), q)
        R_XS = np.zeros(9)
        mujoco.mju_quat2Mat(R_XS, model.site_quat[index])
        p_BS = H[0:3, 3] + ca.mtimes(H[0:3, 0:3], ca.DM(model.site_pos[index]))
        return p_BS, ca.mtimes(H[0:3, 0:3], ca.sparsify(ca.DM(R_XS.reshape(3, 3)), _DUST))
