"""Hook: the bent end of an arm's forearm, in which a bar of a free body lies and from which it can be lifted off.

In the tool's frame E the forearm's shaft runs along z and its lip rises along x at the end. The bar is a straight line;
where it crosses the plane y = 0 of E it lies on the shaft (pushed along +x) and cannot leave over the end while it is
below the lip's height (pushed along -z). Both push only, by a spring and a damper; friction is the tip's (LuGre).
"""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from aerotact.exceptions import InputError, UnknownName
from aerotact.plant.tip_friction import lugre_step
from aerotact.ports import Array

if TYPE_CHECKING:
    from aerotact.plant.plant import Plant


@dataclass
class Hook:
    """One arm's hook and the bar that it may carry.

    Attributes:
        arm: place in `robot.arms`.
        body: that carries the bar; of the world, free.
        middle_B: the bar's middle in the body's frame, m; it runs along y.
        half: half the bar's length, m.
        floor: x of the bar's axis in E when it lies on the shaft, m.
        lip: x in E up to which the lip holds it, m.
        end: z in E where the lip begins, m.
        back: length of shaft behind the tool's point on which the bar finds support, m.
        friction: Coulomb coefficient.
        stiffness, damping: of the contact, N/m and N s/m.
    """

    arm: int
    body: str
    middle_B: tuple[float, float, float]
    half: float
    floor: float = 0.016
    lip: float = 0.045
    end: float = 0.010
    back: float = 0.10
    friction: float = 0.4
    stiffness: float = 1500.0
    damping: float = 6.0
    _bristle: Array = field(default_factory=lambda: np.zeros(3), init=False, repr=False)

    def __post_init__(self) -> None:
        numbers = [*self.middle_B, self.half, self.floor, self.lip, self.end, self.back, self.friction]
        if not np.isfinite(numbers).all() or min(self.half, self.stiffness, self.damping, self.friction) < 0:
            raise InputError(
                f"Hook: {numbers}, stiffness {self.stiffness}, damping {self.damping}; valid: finite, >= 0"
            )

    def begin(self, plant: "Plant") -> None:
        """Join a plant.

        Raises:
            UnknownName: no such free body.
            InputError: no such arm.
        """
        if self.body not in plant.objects:
            raise UnknownName("free body", self.body, plant.objects, "the world")
        if not 0 <= self.arm < len(plant.robot.arms):
            raise InputError(f"Hook: arm is {self.arm}; valid: 0 to {len(plant.robot.arms) - 1}")

    def apply(self, plant: "Plant") -> None:
        """Act for one step."""
        model, data = plant.model, plant.data
        body, site = model.body(self.body).id, model.site(plant.robot.arms[self.arm].tool).id
        R_WE, p_E = data.site_xmat[site].reshape(3, 3), data.site_xpos[site]
        R_WO = data.xmat[body].reshape(3, 3)
        middle, axis = data.xpos[body] + R_WO @ self.middle_B, R_WO[:, 1]
        across = float(axis @ R_WE[:, 1])
        along = -float((middle - p_E) @ R_WE[:, 1]) / across if abs(across) > 0.5 else np.inf
        if abs(along) > self.half:
            self._bristle = np.zeros(3)
            return
        c_W = middle + along * axis
        x, _, z = R_WE.T @ (c_W - p_E)
        v_W = _velocity(plant, body, c_W) - _velocity(plant, int(model.site_bodyid[site]), c_W)
        v = R_WE.T @ v_W
        force = np.zeros(3)
        if -0.03 < x < self.floor and -self.back < z < self.end + 0.02:
            force[0] = max(0.0, self.stiffness * (self.floor - x) - self.damping * v[0])
        if -0.03 < x < self.lip and self.end < z < self.end + 0.03:
            force[2] = -max(0.0, self.stiffness * (z - self.end) + self.damping * v[2])
        if not force.any():
            self._bristle = np.zeros(3)
            return
        normal = float(np.linalg.norm(force))
        n = force / normal
        sliding = v - n * (n @ v)
        self._bristle -= n * (n @ self._bristle)
        self._bristle, rubbed = lugre_step(self._bristle, sliding, normal, self.friction, plant.timestep)
        push_W = R_WE @ (force + rubbed)
        plant.push(body, push_W, c_W)
        plant.push_tool(-push_W, R_WE.T @ (c_W - p_E), self.arm)


def _velocity(plant: "Plant", body: int, p_W: Array) -> Array:
    """Velocity in W of a point that moves with a body, m/s."""
    twist = np.zeros(6)
    mujoco.mj_objectVelocity(plant.model, plant.data, mujoco.mjtObj.mjOBJ_XBODY, body, twist, 0)
    return np.asarray(twist[3:] + np.cross(twist[:3], p_W - plant.data.xpos[body]))
