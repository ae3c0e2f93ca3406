"""What is known of an arm from its servos and encoders: angles of shafts and links, frame i, force at the tool."""

from dataclasses import dataclass
from typing import Any

import casadi as ca

from aerotact.dynamics import so3
from aerotact.dynamics.arm_kinematics import ArmKinematics, arm_kinematics
from aerotact.dynamics.multibody import Multibody
from aerotact.laws.suarez2020.contact_force import force_along, force_of_deflection
from aerotact.ports import BlockBuilder

PASSES = 3
"""Fixed-point passes from servo angles and load to the links without encoders."""


@dataclass(frozen=True)
class Heard:
    """Measurements that the arms' control needs.

    Attributes:
        p_WB, q_WB: of the base, m and wxyz.
        servo: angles of all shafts, rad.
        deflection: of the joints that have encoders, rad.
        swing: angle of the passive joint, rad; 0 without one.
    """

    p_WB: Any
    q_WB: Any
    servo: Any
    deflection: Any
    swing: Any


@dataclass(frozen=True)
class ArmFrame:
    """Frame i of an arm: origin p_WS, m, attitude R_WS, and gravity's reaction `up` in it, m/s2."""

    p_WS: Any
    R_WS: Any
    up: Any

    def point(self, p_W: Any) -> Any:
        """A point of W in frame i, (4) with the inverse."""
        return ca.mtimes(self.R_WS.T, p_W - self.p_WS)


@dataclass(frozen=True)
class ArmFeedback:
    """An arm as its sensors have it.

    Attributes:
        theta: servo angles, rad, (4,).
        q: joint angles, rad, (4,).
        r: tool in frame i, (6), m, (3,).
        force: of the tool on the environment in frame i, as the encoders alone tell, N, (3,).
        acting: the same as taken for true: what is told, and what is measured along what is ruled, N, (3,).
    """

    theta: Any
    q: Any
    r: Any
    force: Any
    acting: Any


@dataclass(frozen=True)
class InstrumentedArm:
    """An arm and which of its joints have encoders.

    Attributes:
        name: of the arm.
        kinematics: of the arm.
        servos: places of its joints in `servo`.
        joints: numbers, 0 to 3, of the joints with encoders.
        encoders: their places in `deflection`.
    """

    name: str
    kinematics: ArmKinematics
    servos: tuple[int, ...]
    joints: tuple[int, ...]
    encoders: tuple[int, ...]

    def feedback(self, heard: Heard, frame: ArmFrame, load: Any, told: Any, ruled: Any) -> ArmFeedback:
        """What the sensors say.

        The deflection of joints without encoders is that of gravity, of the load and of the force: of what is told, and
        of the estimate along what is ruled.

        Args:
            heard: measurements.
            frame: of the arm.
            load: mass carried at the tool, kg.
            told: force in frame i that the arm has without a measurement, N, (3,).
            ruled: force in frame i that is controlled by its measurement, N, (3,); zero if none.
        """
        kin = self.kinematics
        theta = heard.servo[list(self.servos)]
        q = ca.vertcat(*[self._link(j, theta, heard) for j in range(4)])
        force, acting = told, told
        if self.joints:
            size = ca.sqrt(ca.sumsqr(ruled) + 1e-12)
            force = force_of_deflection(kin, theta, q, frame.up, self.joints)
            acting = told + ruled / size * force_along(kin, q, force, ruled / size, self.joints)
        for _ in range(PASSES):
            torque = kin.gravity_torque(q, frame.up) + ca.mtimes(kin.jacobian(q).T, load * frame.up + acting)
            loaded = theta - torque / ca.DM(kin.stiffness)
            q = ca.vertcat(*[q[j] if j in self.joints else loaded[j] for j in range(4)])
        return ArmFeedback(theta, q, kin.forward(q), force, acting)

    def _link(self, joint: int, theta: Any, heard: Heard) -> Any:
        """Angle of a link: as measured, or that of its shaft."""
        return (
            theta[joint] - heard.deflection[self.encoders[self.joints.index(joint)]]
            if joint in self.joints
            else theta[joint]
        )

    def frame(self, heard: Heard, gravity: float) -> ArmFrame:
        """Frame i, (1), (2), (5)."""
        p_BS, R_BS = self.kinematics.shoulder_pose(heard.swing)
        R_WB = so3.rotation(heard.q_WB)
        R_WS = ca.mtimes(R_WB, R_BS)
        return ArmFrame(heard.p_WB + ca.mtimes(R_WB, p_BS), R_WS, gravity * R_WS[2, :].T)


def instrumented_arms(model: Multibody) -> tuple[InstrumentedArm, ...]:
    """The arms of a robot, in order.

    Raises:
        RobotError: an arm whose kinematics are not those of the paper.
    """
    entry = model.robot.file.sensors.deflection
    measured = list(entry.joints) if entry is not None else []
    found = []
    for arm in model.robot.arms:
        places = range(model.servos)[model.arm_slice(arm.name)]
        seen = [(j, measured.index(joint.name)) for j, joint in enumerate(arm.joints) if joint.name in measured]
        joints, encoders = tuple(j for j, _ in seen), tuple(e for _, e in seen)
        found.append(InstrumentedArm(arm.name, arm_kinematics(model.robot, arm.name), tuple(places), joints, encoders))
    return tuple(found)


def listen(b: BlockBuilder, model: Multibody, p_WB: Any, q_WB: Any) -> Heard:
    """Measurement ports of the joints; the base's are given, since other parts of a law have them too."""
    sizes = {name: int(value.shape[0]) for name, value in model.sensed(ca.DM(model.hover_state)).items()}
    hover = {name: value.full().ravel() for name, value in model.sensed(ca.DM(model.hover_state)).items()}
    servo = b.measurement(
        "servo_measured", model.servos, "rad", doc="angles of the servos' shafts", default=tuple(model.hover_servo)
    )
    deflection, swing = ca.SX.zeros(0), ca.SX(0)
    if "deflection_measured" in sizes:
        deflection = b.measurement(
            "deflection_measured",
            sizes["deflection_measured"],
            "rad",
            doc="shaft minus link of the joints with encoders",
            default=tuple(hover["deflection_measured"]),
        )
    if "passive_measured" in sizes:
        swing = b.measurement(
            "passive_measured",
            sizes["passive_measured"],
            "rad",
            doc="angle of the passive joint",
            default=tuple(hover["passive_measured"]),
        )[0]
    return Heard(p_WB, q_WB, servo, deflection, swing)
