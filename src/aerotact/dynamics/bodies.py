"""Bodies: mass matrix, velocity forces and frames of the rigid bodies of plant.xml, through the library adam.

All in axes of B with nu = [v_B; w_B; joint_rate]. A steady translation and gravity are left out: with the base's proper
acceleration a_B = R_WB' (a_WB + g e_z), which an accelerometer there would read,

    M(q) [a_B; dw_B; joint_acceleration] + c(q, w_B, joint_rate) = forces

holds in every attitude and at every speed, so M and c know nothing of the base's pose, its velocity or gravity.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import mujoco
import numpy as np

from aerotact.dynamics import so3
from aerotact.robot import Robot

_DUST = 1e-15


@dataclass(frozen=True)
class SiteFrame:
    """A site of plant.xml seen from the base, as functions of the joint angles.

    Attributes:
        p_BS: position, m, (3,).
        q_BS: attitude, (4,), smooth in the joint angles.
        J_v: from joint rates to the site's velocity against the base, in B, (3, m).
        J_w: from joint rates to its angular velocity against the base, in S, (3, m).
    """

    p_BS: Any
    q_BS: Any
    J_v: Any
    J_w: Any


class Bodies:
    """The tree of bodies of a robot with m joints; angles are rad.

    Attributes:
        joints: names in the order of q: passive joints, then the arms' joints.
        indices: their ids in plant.xml.
    """

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        joints = [(joint.name, joint.index) for joint in robot.passive]
        joints += [(joint.name, joint.index) for arm in robot.arms for joint in arm.joints]
        self.joints = tuple(name for name, _ in joints)
        self.indices = tuple(index for _, index in joints)
        self._sites: dict[int, Any] = {}

    def mass_matrix(self, q: Any) -> Any:
        """M, shape (6 + m, 6 + m), rotor inertias (armature) included, for joint angles q (m,)."""
        return self._mass_matrix(q)

    def velocity_forces(self, q: Any, w_B: Any, rate: Any) -> Any:
        """c, shape (6 + m,): centrifugal and Coriolis forces for angular velocity w_B (3,) and joint rates (m,)."""
        return self._velocity_forces(q, w_B, rate)

    def site(self, index: int, q: Any) -> SiteFrame:
        """Frame of a site of plant.xml, by its id, for joint angles q (m,)."""
        if index not in self._sites:
            self._sites[index] = self._site_function(index)
        return SiteFrame(*self._sites[index](q))

    @cached_property
    def _tree(self) -> Any:
        import adam
        from adam.casadi import KinDynComputations

        tree = KinDynComputations.from_mujoco_model(self._robot.mjmodel, joints_name_list=list(self.joints))
        tree.set_frame_velocity_representation(adam.Representations.BODY_FIXED_REPRESENTATION)
        return tree

    def _symbols(self, *names: str) -> list[Any]:
        return [ca.SX.sym(name, len(self.joints)) for name in names]

    @cached_property
    def _mass_matrix(self) -> Any:
        (q,) = self._symbols("q")
        model = self._robot.mjmodel
        armature = np.concatenate([np.zeros(6), model.dof_armature[model.jnt_dofadr[list(self.indices)]]])
        return ca.Function("M", [q], [self._tree.mass_matrix(ca.SX.eye(4), q) + ca.diag(ca.DM(armature))])

    @cached_property
    def _velocity_forces(self) -> Any:
        (q, rate), w_B = self._symbols("q", "rate"), ca.SX.sym("w_B", 3)
        twist, no_gravity = ca.vertcat(ca.SX.zeros(3), w_B), np.zeros(6)
        c = self._tree.rbdalgos.rnea(ca.SX.eye(4), q, twist, rate, no_gravity)
        return ca.Function("c", [q, w_B, rate], [c.array])

    def _site_function(self, index: int) -> Any:
        (q,) = self._symbols("q")
        model = self._robot.mjmodel
        H = self._tree.forward_kinematics(model.body(model.site_bodyid[index]).name, ca.SX.eye(4), q)
        R = np.zeros(9)
        mujoco.mju_quat2Mat(R, model.site_quat[index])
        R_BS = ca.mtimes(H[0:3, 0:3], ca.sparsify(ca.DM(R.reshape(3, 3)), _DUST))
        p_BS = H[0:3, 3] + ca.mtimes(H[0:3, 0:3], ca.DM(model.site_pos[index]))
        turns = ca.jacobian(ca.vec(R_BS), q)
        J_w = [so3.vee(ca.mtimes(R_BS.T, ca.reshape(turns[:, j], 3, 3))) for j in range(len(self.joints))]
        outputs = [p_BS, self._site_attitude(index, q), ca.jacobian(p_BS, q), ca.horzcat(*J_w)]
        return ca.Function("site", [q], ca.cse(outputs))

    def _site_attitude(self, index: int, q: Any) -> Any:
        """q_BS, joint by joint, so that its sign does not jump."""
        model, base = self._robot.mjmodel, self._robot.base_id
        attitude, body = ca.DM(model.site_quat[index]), int(model.site_bodyid[index])
        while body != base:
            first = int(model.body_jntadr[body])
            for joint in reversed(range(first, first + int(model.body_jntnum[body]))):
                half = q[self.indices.index(joint)] / 2
                turn = ca.vertcat(ca.cos(half), ca.DM(model.jnt_axis[joint]) * ca.sin(half))
                attitude = so3.product(turn, attitude)
            attitude = so3.product(ca.DM(model.body_quat[body]), attitude)
            body = int(model.body_parentid[body])
        return attitude
