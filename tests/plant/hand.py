"""A hand that guides a robot in tests, so that no controller is needed."""

from dataclasses import dataclass

import numpy as np

from aerotact.plant.plant import Plant


@dataclass
class Hand:
    """Holds the attitude level and presses; glides with a given velocity across the direction of pressing.

    Attributes:
        press_W: constant force, N.
        glide_W: velocity of the point that the base is drawn to, m/s, across `press_W`.
        start: when gliding begins, s.
        stiffness: of that drawing, N/m; zero lets the base go freely across `press_W`.
    """

    press_W: np.ndarray
    glide_W: np.ndarray
    start: float
    stiffness: float = 400.0

    def begin(self, plant: Plant) -> None:
        self.home_W: np.ndarray | None = None

    def apply(self, plant: Plant) -> None:
        truth = plant.truth()
        if self.home_W is None:
            self.home_W = truth["p_WB"]
        along = np.abs(self.press_W) / np.linalg.norm(self.press_W)
        elapsed = max(0.0, plant.time - self.start)
        glide = self.glide_W if elapsed > 0 else np.zeros(3)
        draw = self.stiffness * (self.home_W + self.glide_W * elapsed - truth["p_WB"])
        draw += 0.1 * self.stiffness * (glide - truth["v_WB"])
        force = self.press_W + (1 - along) * draw - 15.0 * along * truth["v_WB"]
        R_WB = plant.data.xmat[plant.base_id].reshape(3, 3)
        q = truth["q_WB"]
        torque_W = R_WB @ (-300.0 * q[1:] * np.sign(q[0]) - 8.0 * truth["w_B"])
        plant.push(plant.base_id, force, plant.data.xipos[plant.base_id], torque_W)
