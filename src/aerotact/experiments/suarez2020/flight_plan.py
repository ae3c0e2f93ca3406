"""What the platform and its arms should do in the experiments of suarez2020."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import casadi as ca
import numpy as np

from aerotact.dynamics.model import Model
from aerotact.dynamics.multibody import Multibody
from aerotact.exceptions import MissingCapability
from aerotact.experiments.reference import Together
from aerotact.laws.suarez2020.flying_arms import suarez2020_tools
from aerotact.ports import Array

STANDARD, LONG_REACH = "dual_arm_standard", "dual_arm_long_reach"


def with_arms(model: Model) -> Multibody:
    """The model of a robot with arms, which these experiments need.

    Raises:
        MissingCapability: it has none.
    """
    if not isinstance(model, Multibody) or not model.robot.arms:
        raise MissingCapability(f"experiments of suarez2020 need arm, which robot '{model.robot.name}' lacks")
    return model


@dataclass(frozen=True)
class Platform:
    """The platform at rest or in straight flight, level in yaw; arms held; no force wanted at the tools.

    Attributes:
        p_WB: where it begins, m, (3,).
        servo: angles that the arms hold, rad, (s,).
        arms: how many.
        legs: (start in s, acceleration in m/s2, (3,)) from then on; constant between two, none before the first.
    """

    p_WB: Array
    servo: Array
    arms: int
    legs: Sequence[tuple[float, tuple[float, float, float]]] = ()

    def sample(self, times: Array) -> dict[str, Array]:
        """References of the platform's laws, one row a time."""
        n = len(times)
        p, v, a = np.tile(self.p_WB, (n, 1)), np.zeros((n, 3)), np.zeros((n, 3))
        for (start, acceleration), (stop, _) in pairwise((*self.legs, (np.inf, (0.0, 0.0, 0.0)))):
            flown = np.clip(times - start, 0.0, stop - start)[:, None]
            coasted = np.clip(times - stop, 0.0, None)[:, None]
            leg = np.asarray(acceleration)
            a += ((times >= start) & (times < stop))[:, None] * leg
            v += flown * leg
            p += (0.5 * flown**2 + flown * coasted) * leg
        return {
            "p_WB_r": p,
            "v_WB_r": v,
            "a_WB_r": a,
            "yaw_r": np.zeros((n, 1)),
            "servo_r": np.tile(self.servo, (n, 1)),
            "f_tools_W_r": np.zeros((n, 3 * self.arms)),
        }


def hovering(model: Model, legs: Sequence[tuple[float, tuple[float, float, float]]] = ()) -> Platform:
    """The hover keyframe, or flight from there."""
    arms = with_arms(model)
    return Platform(arms.hover_state[:3], arms.hover_servo, len(arms.robot.arms), legs)


@dataclass(frozen=True)
class Grasp:
    """Both tools where they hover, as points in W from `start` on; until then, as places beside the shoulders.

    Serves the references of suarez2020_tools.

    Attributes:
        model: whose tools.
        start: s.
    """

    model: Multibody
    start: float

    def sample(self, times: Array) -> dict[str, Array]:
        """References of the arms, one row a time."""
        n = len(times)
        rest = suarez2020_tools(self.model, 50.0).reference
        values = {port.name: np.tile(port.default, (n, 1)) for port in rest}
        x, on = ca.DM(self.model.hover_state), (times >= self.start - 1e-9).astype(float)[:, None]
        for arm in self.model.robot.arms:
            p_WE, _ = self.model.arm_tool_pose(x, arm.name)
            values[f"p_{arm.name}_d"] = np.tile(ca.DM(p_WE).full().ravel(), (n, 1))
            values[f"in_W_{arm.name}"] = on
        return values


def resting(model: Model, legs: Sequence[tuple[float, tuple[float, float, float]]] = ()) -> Together:
    """`hovering`, for controllers that plan the arms too: these stay in their places beside the shoulders."""
    return Together((hovering(model, legs), Grasp(with_arms(model), np.inf)))
