"""Grip: an arm's tool holds a point of a body of the world and lets it turn, as a loose wrist does."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from aerotact.exceptions import InputError, UnknownName
from aerotact.plant.disturbance import check_vector

if TYPE_CHECKING:
    from aerotact.plant.plant import Plant


@dataclass(frozen=True)
class Grip:
    """A spring and a damper between the two points, alike in all directions.

    Attributes:
        arm: place in `robot.arms`.
        body: of the world.
        point_B: in the body's own frame, m.
        stiffness, damping: N/m and N s/m.

    Raises:
        InputError: a point that is not three finite numbers, a spring or damper below zero.
    """

    arm: int
    body: str
    point_B: tuple[float, float, float]
    stiffness: float = 2000.0
    damping: float = 5.0

    def __post_init__(self) -> None:
        check_vector("Grip: point_B", self.point_B)
        if not (self.stiffness >= 0.0 and self.damping >= 0.0):
            raise InputError(f"Grip: stiffness {self.stiffness}, damping {self.damping}; valid: >= 0")

    def begin(self, plant: "Plant") -> None:
        """Join a plant.

        Raises:
            UnknownName: no such body.
            InputError: no such arm.
        """
        model = plant.model
        if mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, self.body) < 0:
            raise UnknownName("body", self.body, [model.body(i).name for i in range(1, model.nbody)], "the plant")
        if not 0 <= self.arm < len(plant.robot.arms):
            raise InputError(f"Grip: arm is {self.arm}; valid: 0 to {len(plant.robot.arms) - 1}")

    def apply(self, plant: "Plant") -> None:
        """Act for one step."""
        body, data = plant.model.body(self.body).id, plant.data
        arm = data.xmat[body].reshape(3, 3) @ self.point_B
        twist = np.zeros(6)
        mujoco.mj_objectVelocity(plant.model, data, mujoco.mjtObj.mjOBJ_XBODY, body, twist, 0)
        p_W, v_W = data.xpos[body] + arm, twist[3:] + np.cross(twist[:3], arm)
        p_tool, v_tool = plant.tool_point(self.arm)
        force = self.stiffness * (p_W - p_tool) + self.damping * (v_W - v_tool)
        plant.push_tool(force, np.zeros(3), self.arm)
        plant.push(body, -force, p_W)
