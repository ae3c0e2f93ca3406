"""Arm kinematics of suarez2020, (1)-(7) mended: shoulder of pitch, roll and yaw about one point, elbow of pitch.

Frame i of an arm: origin where the three shoulder axes meet, x forward, z up. At zero the arm hangs straight down;

    r_tool = Ry(q1) Rx(side q2) Rz(q3) ([0, 0, -L1] + Ry(q4) [0, 0, -L2]),          (6)

with side = 1 for a roll axis along x (left) and -1 for one against it (right), so that a positive roll lifts either arm
outwards. Everything is written for CasADi expressions and takes numbers too; angles are rad, lengths m.
"""

from dataclasses import dataclass
from typing import Any, Literal

import casadi as ca
import mujoco
import numpy as np
from numpy.typing import ArrayLike

from aerotact.dynamics import so3
from aerotact.exceptions import InputError, RobotError, UnknownName
from aerotact.plant_file import joints_between, lumped, subtree
from aerotact.ports import Array
from aerotact.robot import Robot

_TOLERANCE = 1e-9
Elbow = Literal[-1, 1]
"""-1: the forearm bends forward (q4 <= 0), 1: backward."""


@dataclass(frozen=True)
class ArmKinematics:
    """Geometry of one arm and what follows from it; made by `arm_kinematics`.

    Attributes:
        name: of the arm.
        upper: L1, from shoulder to elbow.
        lower: L2, from elbow to tool.
        side: 1 left, -1 right.
        p_BJ: a point on the passive joint's axis in B, (3,); the base's origin without one.
        p_JS: from there to the shoulder with the passive joint at zero, in B, (3,).
        pendulum: the arm hangs on a passive joint about y.
        stiffness: of the joints, N m/rad, (4,).
        masses: of the four links, kg, (4,).
        centres: centres of mass of the four links in their own frames, (4, 3); the last frame is at the elbow.
    """

    name: str
    upper: float
    lower: float
    side: float
    p_BJ: Array
    p_JS: Array
    pendulum: bool
    stiffness: Array
    masses: Array
    centres: Array

    # forward

    def rotations(self, q: Any) -> tuple[Any, Any, Any, Any]:
        """Attitudes in frame i of the links after pitch, roll, yaw and elbow, (3, 3) each."""
        after_pitch = _about("y", q[0])
        after_roll = ca.mtimes(after_pitch, _about("x", self.side * q[1]))
        after_yaw = ca.mtimes(after_roll, _about("z", q[2]))
        return after_pitch, after_roll, after_yaw, ca.mtimes(after_yaw, _about("y", q[3]))

    def forward(self, q: Any) -> Any:
        """Tool position in frame i for joint angles q (4,), (6): FK(q), or FK(theta) of the equivalent stiff arm."""
        _, _, upper, lower = self.rotations(q)
        return -self.upper * upper[:, 2] - self.lower * lower[:, 2]

    def jacobian(self, q: Any) -> Any:
        """Matrix (3, 4) from joint rates to the tool's velocity in frame i."""
        pitch, roll, yaw, _ = self.rotations(q)
        r = self.forward(q)
        r_elbow = -self.upper * yaw[:, 2]
        y = ca.DM([0, 1, 0])
        columns = (ca.cross(y, r), self.side * ca.cross(pitch[:, 0], r), ca.cross(roll[:, 2], r))
        return ca.horzcat(*columns, ca.cross(yaw[:, 1], r - r_elbow))

    # inverse

    def inverse(self, r: Any, roll: Any, elbow: Elbow = -1) -> Any:
        """Joint angles (4,) that bring the tool to r (3,) with the imposed shoulder roll, (7): IK(r, roll).

        The yaw is within a right angle. Exact where `margins` are not negative; beyond, finite and near.
        """
        far, near, side = ca.vertsplit(self.margins(r, roll))
        bend = 2 * ca.atan2(ca.sqrt(ca.fmax(far, 0)), ca.sqrt(ca.fmax(near, 0)))
        a, b = -elbow * self.lower * ca.sin(bend), self._drop(bend)  # x and z of the tool before the yaw
        s, c = ca.sin(self.side * roll), ca.cos(self.side * roll)
        yaw = ca.atan2(-elbow * (r[1] + b * s), ca.sqrt(ca.fmax(side, 0)))
        x, z = a * ca.cos(yaw), a * ca.sin(yaw) * s + b * c
        pitch = ca.atan2(r[0] * z - r[2] * x, r[0] * x + r[2] * z)
        return ca.vertcat(pitch, roll, yaw, elbow * bend)

    def margins(self, r: Any, roll: Any) -> Any:
        """How far r (3,) is within reach with that roll, m2, (3,): outer sphere, inner sphere, sideways."""
        distance = ca.sumsqr(r)
        far = (self.upper + self.lower) ** 2 - distance
        near = distance - (self.upper - self.lower) ** 2
        bend = 2 * ca.atan2(ca.sqrt(ca.fmax(far, 0)), ca.sqrt(ca.fmax(near, 0)))
        widest = self.lower * ca.sin(bend) * ca.cos(roll)
        across = r[1] + self._drop(bend) * ca.sin(self.side * roll)
        return ca.vertcat(far, near, widest**2 - across**2)

    def joints_at(self, r: ArrayLike, roll: float, elbow: Elbow = -1) -> Array:
        """`inverse` of numbers.

        Raises:
            InputError: r is out of reach with that roll; names the reach.
        """
        goal = np.asarray(r, dtype=float)
        if goal.shape != (3,) or not np.isfinite([*goal, roll]).all():
            raise InputError(
                f"arm '{self.name}': r is {goal.tolist()}, roll {roll}; valid: finite, three and one number"
            )
        far, near, side = self.margins(ca.DM(goal), roll).full().ravel()
        distance, dust = float(np.linalg.norm(goal)), 1e-12
        if far < -dust or near < -dust:
            shortest, longest = abs(self.upper - self.lower), self.upper + self.lower
            raise InputError(
                f"arm '{self.name}': tool at {goal.tolist()} m is {distance:.4g} m from the shoulder; "
                f"valid: a reach of {shortest:.4g} to {longest:.4g} m"
            )
        if side < -dust:
            lowest, highest = self._sideways(distance, roll)
            raise InputError(
                f"arm '{self.name}': tool at {goal.tolist()} m is out of reach with a shoulder roll of {roll:.4g} rad; "
                f"valid: y of {lowest:.4g} to {highest:.4g} m at that distance"
            )
        return np.asarray(self.inverse(ca.DM(goal), roll, elbow).full().ravel())

    def _drop(self, bend: Any) -> Any:
        """z of the tool before shoulder roll and yaw."""
        return -(self.upper + self.lower * ca.cos(bend))

    def _sideways(self, distance: float, roll: float) -> tuple[float, float]:
        """Lowest and highest y that the tool reaches at a distance from the shoulder."""
        cosine = (distance**2 - self.upper**2 - self.lower**2) / (2 * self.upper * self.lower)
        bend = np.arccos(np.clip(cosine, -1.0, 1.0))
        middle = (self.upper + self.lower * np.cos(bend)) * np.sin(self.side * roll)
        half = self.lower * np.sin(bend) * np.cos(roll)
        return float(middle - half), float(middle + half)

    # statics

    def gravity_torque(self, q: Any, up: Any) -> Any:
        """Torques (4,), N m, that hold the links against gravity; `up` is that of frame i times 9.81 m/s2, (3,)."""
        pitch, roll, yaw, lower = self.rotations(q)
        elbow = -self.upper * yaw[:, 2]
        origins = (ca.DM.zeros(3), ca.DM.zeros(3), ca.DM.zeros(3), elbow)
        axes = (ca.DM([0, 1, 0]), self.side * pitch[:, 0], roll[:, 2], yaw[:, 1])
        moments = [
            mass * (origin + ca.mtimes(R, ca.DM(centre)))
            for mass, origin, R, centre in zip(
                self.masses, origins, (pitch, roll, yaw, lower), self.centres, strict=True
            )
        ]
        torques = []
        for joint, (axis, origin) in enumerate(zip(axes, origins, strict=True)):
            moment = sum(moments[joint:], ca.DM.zeros(3)) - float(self.masses[joint:].sum()) * origin
            torques.append(ca.dot(up, ca.cross(axis, moment)))
        return ca.vertcat(*torques)

    def servo_for(self, q: Any, torque: Any) -> Any:
        """Servo angles (4,), rad, that make the springs give `torque` (4,), N m, at joint angles q: q + K^-1 torque."""
        return q + torque / ca.DM(self.stiffness)

    def cartesian_stiffness(
        self, q: Any, axes: tuple[int, ...] = (0, 1, 2), joints: tuple[int, ...] = (0, 1, 2, 3)
    ) -> Any:
        """(J K^-1 J')^-1, N/m, in frame i: (27) mended for more joints than axes.

        Args:
            q: joint angles (4,).
            axes: of frame i; (0, 2) with `joints` (0, 3) is the plane of the two instrumented joints.
            joints: those that yield, at least as many as axes.
        """
        J = self.jacobian(q)[list(axes), list(joints)]
        compliance = ca.DM(1.0 / self.stiffness[list(joints)])
        return ca.inv(ca.mtimes(J * ca.repmat(compliance.T, len(axes), 1), J.T))

    # frames

    def shoulder_pose(self, swing: Any = 0.0) -> tuple[Any, Any]:
        """Origin p_BS (3,), m, and attitude R_BS (3, 3) of frame i in B, (1) and (2), for the passive joint's angle."""
        R_BS = _about("y", swing if self.pendulum else 0.0)
        return ca.DM(self.p_BJ) + ca.mtimes(R_BS, ca.DM(self.p_JS)), R_BS

    def to_shoulder(self, p_WB: Any, q_WB: Any, swing: Any, p_W: Any) -> Any:
        """A point of W seen in frame i, (4) with the inverse and (5)."""
        p_BS, R_BS = self.shoulder_pose(swing)
        return ca.mtimes(R_BS.T, ca.mtimes(so3.rotation(q_WB).T, p_W - p_WB) - p_BS)

    def from_shoulder(self, p_WB: Any, q_WB: Any, swing: Any, r: Any) -> Any:
        """A point of frame i in W, (3) and (5)."""
        p_BS, R_BS = self.shoulder_pose(swing)
        return p_WB + ca.mtimes(so3.rotation(q_WB), p_BS + ca.mtimes(R_BS, r))


def arm_kinematics(robot: Robot, name: str) -> ArmKinematics:
    """Kinematics of an arm, read from the compiled plant.xml at the zero of all joints.

    Raises:
        UnknownName: no such arm.
        RobotError: the arm has other axes, or more than one passive joint carries it.
    """
    arms = {arm.name: arm for arm in robot.arms}
    if name not in arms:
        raise UnknownName("arm", name, arms, f"robot '{robot.name}'")
    arm, model, data = arms[name], robot.mjmodel, mujoco.MjData(robot.mjmodel)
    mujoco.mj_kinematics(model, data)
    R_WB, p_WB = data.xmat[robot.base_id].reshape(3, 3), data.xpos[robot.base_id]
    anchors = [(data.xanchor[j.index] - p_WB) @ R_WB for j in arm.joints]
    axes = np.array([data.xaxis[j.index] @ R_WB for j in arm.joints])
    tool = (data.site_xpos[arm.tool_index] - p_WB) @ R_WB
    side = float(axes[1, 0]) if len(axes) == 4 else 0.0
    sound = abs(abs(side) - 1.0) < _TOLERANCE
    if sound:
        expected = np.array([[0.0, 1.0, 0.0], [side, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]])
        sound &= bool(np.abs(axes - expected).max() < _TOLERANCE)
        sound &= bool(np.ptp(anchors[:3], axis=0).max() < _TOLERANCE)
        upper, lower = anchors[0] - anchors[3], anchors[3] - tool
        sound &= bool(np.abs([upper[:2], lower[:2]]).max() < _TOLERANCE and upper[2] > 0 and lower[2] > 0)
    above = joints_between(model, int(model.jnt_bodyid[arm.joints[0].index]), robot.base_id)
    passive = [j.index for j in robot.passive if j.index in above]
    own = [j.index for j in arm.joints]
    if not sound or len(passive) > 1 or set(above) - {own[0], *own, *passive}:
        raise RobotError(
            robot.folder / "plant.xml",
            f"arm '{name}'",
            "is no arm of shoulder pitch, roll, yaw and elbow pitch that hangs straight down at zero",
            "use axes y, x or -x, z, y, the first three through one point, with at most one passive joint above",
        )
    p_BJ = np.zeros(3)
    if passive:
        axis = data.xaxis[passive[0]] @ R_WB
        if np.abs(axis - [0.0, 1.0, 0.0]).max() > _TOLERANCE:
            raise RobotError(
                robot.folder / "plant.xml", f"arm '{name}'", f"hangs on an axis {axis.tolist()}", 'use axis="0 1 0"'
            )
        p_BJ = (data.xanchor[passive[0]] - p_WB) @ R_WB
    bodies = [set(subtree(model, int(model.jnt_bodyid[j]))) for j in own]
    masses, centres = np.zeros(4), np.zeros((4, 3))
    for link, origin in enumerate((anchors[0], anchors[0], anchors[0], anchors[3])):
        beyond = bodies[link + 1] if link < 3 else set()
        masses[link], p_WC, _ = lumped(model, data, sorted(bodies[link] - beyond))
        centres[link] = (p_WC - p_WB) @ R_WB - origin
    return ArmKinematics(
        name=name,
        upper=float(upper[2]),
        lower=float(lower[2]),
        side=side,
        p_BJ=p_BJ,
        p_JS=anchors[0] - p_BJ,
        pendulum=bool(passive),
        stiffness=np.array([j.stiffness for j in arm.joints]),
        masses=masses,
        centres=centres,
    )


def _about(axis: Literal["x", "y", "z"], angle: Any) -> Any:
    """Rotation matrix about an axis."""
    c, s = ca.cos(angle), ca.sin(angle)
    if axis == "x":
        rows = ((1, 0, 0), (0, c, -s), (0, s, c))
    elif axis == "y":
        rows = ((c, 0, s), (0, 1, 0), (-s, 0, c))
    else:
        rows = ((c, -s, 0), (s, c, 0), (0, 0, 1))
    return ca.vertcat(*[ca.horzcat(*row) for row in rows])
