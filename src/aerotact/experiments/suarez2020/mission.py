"""Mission: phases that follow each other by time and by what the operator sees, as references for any controller.

The platform flies from point to point on quintics from rest to rest. The arms go to goals in their own frames or in W,
or where the operator's joystick sends them. The same mission serves the laws of suarez2020 and predictive controllers:
each takes the references that it knows by name.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np

from aerotact.dynamics.arm_kinematics import arm_kinematics
from aerotact.dynamics.multibody import Multibody
from aerotact.ports import Array, Port

Vector = tuple[float, float, float]
UP: Vector = (0.0, 0.0, 1.0)


@dataclass(frozen=True)
class Scene:
    """What the operator knows: by cameras and motion capture, and of the arms by the servos.

    Attributes:
        time: s since the phase began.
        p_WB: of the base, m.
        tools_W: position of each arm's tool, m, by the arm's name.
        p_W, q_W: pose of the world's free object, m and wxyz; zeros and no turn without one.
    """

    time: float
    p_WB: Array
    tools_W: Mapping[str, Array]
    p_W: Array
    q_W: Array


Steering = Callable[[Scene], Array]
"""From the scene to where the operator wants a tool to be in W, m, (3,)."""


@dataclass(frozen=True)
class ArmTask:
    """What one arm should do in a phase.

    Attributes:
        r: goal in frame i, m.
        p_W: goal in W, m; counts instead of r.
        steer: where the operator steers the tool by joystick; counts instead of both.
        roll: imposed shoulder roll, rad.
        force_W: on the environment, N.
        load: mass carried, kg.
    """

    r: Vector = (0.25, 0.0, -0.25)
    p_W: Vector | None = None
    steer: Steering | None = None
    roll: float = 0.0
    force_W: Vector = (0.0, 0.0, 0.0)
    load: float = 0.0


@dataclass(frozen=True)
class Phase:
    """One phase.

    Attributes:
        number: in the paper's list.
        name: short.
        least: s that it lasts at least; the flight takes `flight` of them.
        base: where the platform flies, m; None stays.
        flight: s of that flight.
        arms: task by the arm's name.
        until: what must be true to go on; None asks for nothing.
        most: s after which the mission has failed if it is not.
    """

    number: int
    name: str
    least: float
    arms: Mapping[str, ArmTask]
    base: Vector | None = None
    flight: float = 0.0
    until: Callable[[Scene], bool] | None = None
    most: float = 30.0


@dataclass
class Mission:
    """An operator with a list of phases.

    Attributes:
        model: of the robot.
        phases: in order.
        joystick: speed, m/s, at full joystick, and gain of the operator's eye, 1/s: full beyond their ratio in metres.
        failed: number of the phase that did not come to its end, 0 if none.
        ended: all phases are over.
    """

    model: Multibody
    phases: Sequence[Phase]
    joystick: tuple[float, float] = (0.1, 1.5)
    failed: int = field(default=0, init=False)
    ended: bool = field(default=False, init=False)
    ports: Sequence[Port] = field(
        default=(Port("phase", 1, "1", doc="number in the paper's list"), Port("mission_failed", 1, "1", kind="flag")),
        init=False,
    )

    def __post_init__(self) -> None:
        self._kinematics = {arm.name: arm_kinematics(self.model.robot, arm.name) for arm in self.model.robot.arms}
        self._tools = _tools(self.model)
        self._place, self._began = 0, 0.0
        self._from = np.array(self.model.hover_state[:3])
        self._goal = self._target(self._from)
        self._scene = self._look(0.0, {})
        self._said = self._values()

    @property
    def phase(self) -> Phase:
        """The phase of now."""
        return self.phases[self._place]

    def decide(self, time: float, heard: Mapping[str, Array]) -> None:
        """Look, go on if the phase is over, and move the joystick."""
        self._scene = self._look(time, heard)
        phase, over = self.phase, self._scene.time >= self.phase.least
        seen = phase.until is None or phase.until(self._scene)
        if over and not seen and self._scene.time > phase.most and not self.failed:
            self.failed = phase.number
        if over and (seen or self.failed == phase.number):
            if self._place + 1 < len(self.phases):
                self._from, self._began, self._place = self._goal, time, self._place + 1
                self._goal = self._target(self._from)
                self._scene = self._look(time, heard)
            else:
                self.ended = True
        self._said = self._values()

    def sample(self, times: Array) -> dict[str, Array]:
        """References at `times`, s, as things stand: what the present phase says."""
        held = {name: np.broadcast_to(value, (len(times), len(value))) for name, value in self._said.items()}
        return held | self._flight(np.asarray(times, dtype=float))

    def _values(self) -> dict[str, Array]:
        """What does not change until the operator decides anew."""
        said: dict[str, Any] = dict.fromkeys(("f_grasp", "grasped", "yaw_r"), (0.0,))
        for name in self._kinematics:
            task = self.phase.arms.get(name, ArmTask())
            goal = self._in_W(name, task)
            said |= {
                f"r_{name}_d": task.r,
                f"p_{name}_d": goal,
                f"in_W_{name}": (float(task.p_W is not None or task.steer is not None),),
                f"joystick_{name}": self._stick(name, goal) if task.steer else np.zeros(3),
                f"operated_{name}": (float(task.steer is not None),),
                f"roll_{name}": (task.roll,),
                f"f_{name}_d": task.force_W,
                f"load_{name}": (task.load,),
            }
        said["f_tools_W_r"] = (0.0,) * (3 * len(self._kinematics))
        said |= {"phase": (float(self.phase.number),), "mission_failed": (float(self.failed > 0),)}
        return {name: np.asarray(value, dtype=float) for name, value in said.items()}

    def _target(self, start: Array) -> Array:
        base = self.phase.base
        return np.array(start if base is None else base, dtype=float)

    def _flight(self, times: Array) -> dict[str, Array]:
        """Quintic from rest to rest."""
        lasts = max(self.phase.flight, 1e-3)
        s = np.clip((times - self._began) / lasts, 0.0, 1.0)[:, None]
        way = self._goal - self._from
        return {
            "p_WB_r": self._from + way * (10 * s**3 - 15 * s**4 + 6 * s**5),
            "v_WB_r": way / lasts * (30 * s**2 - 60 * s**3 + 30 * s**4),
            "a_WB_r": way / lasts**2 * (60 * s - 180 * s**2 + 120 * s**3),
        }

    def _in_W(self, name: str, task: ArmTask) -> Array:
        """Goal in W: as given, as steered, or that in frame i with the platform where it should be at rest."""
        if task.p_W is not None:
            return np.asarray(task.p_W)
        if task.steer:
            return np.asarray(task.steer(self._scene))
        swing = float(self.model.hover_joint[0]) if self.model.passive else 0.0
        at = self._kinematics[name].from_shoulder(ca.DM(self._goal), ca.DM([1, 0, 0, 0]), swing, ca.DM(task.r))
        return np.asarray(at.full().ravel())

    def _stick(self, name: str, wanted_W: Array) -> Array:
        """Joystick in frame i, whose axes are nearly those of W: proportional to what is missing, full at most."""
        speed, gain = self.joystick
        return np.clip(gain / speed * (wanted_W - self._scene.tools_W[name]), -1.0, 1.0)

    def _look(self, time: float, heard: Mapping[str, Array]) -> Scene:
        at = self.model.state.unpack(self.model.hover_state)
        p_WB, q_WB = heard.get("p_WB", at["p_WB"]), heard.get("q_WB", at["q_WB"])
        tools = self._tools(p_WB, q_WB, heard.get("joint", at["joint"])).full()
        named = {arm.name: tools[:, i] for i, arm in enumerate(self.model.robot.arms)}
        thing = heard.get("objects_W", np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]))
        return Scene(time - self._began, np.array(p_WB), named, thing[:3], thing[3:7])


def _tools(model: Multibody) -> Any:
    """CasADi function (p_WB, q_WB, joint) -> positions of the arms' tools in W, (3, arms)."""
    p, q, joint = ca.SX.sym("p", 3), ca.SX.sym("q", 4), ca.SX.sym("joint", model.joints)
    x = ca.vertcat(p, q, ca.SX.zeros(6), joint, ca.SX.zeros(model.joints + model.servos + model.rotors))
    tools = [model.arm_tool_pose(x, arm.name)[0] for arm in model.robot.arms]
    return ca.Function("tools", [p, q, joint], [ca.horzcat(*tools)])
