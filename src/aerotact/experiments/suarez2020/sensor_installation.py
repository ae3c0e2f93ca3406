"""Sensor installation with the long reach: nine phases, 2 N under a pipe for 5 s (suarez2020 VI-B, Figs. 26-31)."""

from dataclasses import dataclass

import numpy as np

from aerotact.dynamics.model import Model
from aerotact.experiments.suarez2020.flight_plan import with_arms
from aerotact.experiments.suarez2020.mission import ArmTask, Mission, Phase, Vector
from aerotact.ports import Array

PIPE, RADIUS = np.array([1.5, 0.15, 1.1]), 0.1
"""A point of the pipe's axis ahead of the left arm, and its radius, m; world `pipe`."""
TIP = 0.008  # m, radius of the tool's tip
FORCE, PUSHING, SETTLING = 2.0, 8.0, 3.0
"""N; s that phase 6 lasts; s of it that are not judged."""
L_POSE: Vector = (0.25, 0.0, -0.25)
STRETCHED: Vector = (0.42, 0.0, -0.24)
FOLDED: Vector = (0.12, 0.0, -0.40)
BELOW: Vector = (0.0, 0.0, 1.0)
AHEAD: Vector = (1.0, 0.0, 0.0)


@dataclass(frozen=True)
class Push:
    """How a case pushes.

    Attributes:
        r: tool in frame i at contact, m.
        direction: of the push in W.
    """

    r: Vector
    direction: Vector

    @property
    def contact(self) -> Array:
        """Where the tool's middle is when its tip touches the pipe, m in W."""
        return PIPE - (RADIUS + TIP) * np.array(self.direction)


PUSHES = {
    "first": Push(L_POSE, BELOW),
    "second": Push(STRETCHED, BELOW),
    "forward": Push(L_POSE, AHEAD),
}
_UNTIL = dict.fromkeys(PUSHES, 27.0)


def installation(model: Model, push: Push) -> Mission:
    """The nine phases. Take-off and landing, which the paper leaves to a pilot, are a rise and a descent of 0.4 m."""
    arms = with_arms(model)
    start = np.array(arms.hover_state[:3])
    contact, direction = push.contact, np.array(push.direction)
    # From the tool in W back to the base that has it there with the pendulum as in hover.
    tool = np.array(arms.hover_tool[0]) + np.array(push.r) - np.array(L_POSE) - start
    here = contact - tool
    before = here - 0.5 * np.array(AHEAD)
    lower = start - [0.0, 0.0, 0.4]
    clear = tuple(np.array(push.r) - 0.06 * direction)
    fold, ready = _both(FOLDED), _both(L_POSE)
    touching = {"left": _at(push.r, contact + 0.002 * direction), "right": ArmTask(r=FOLDED)}
    near = {"left": _at(push.r, contact - 0.015 * direction), "right": ArmTask(r=FOLDED)}
    pushing = {"left": _at(push.r, contact, FORCE * direction), "right": ArmTask(r=FOLDED)}
    back = {"left": ArmTask(r=clear), "right": ArmTask(r=FOLDED)}
    return Mission(
        arms,
        (
            Phase(1, "take-off", 5.0, fold, _t(start), 0.0),
            Phase(2, "arms to the operation position", 3.0, ready),
            Phase(3, "to the workspace", 6.0, ready, _t(before), 5.0),
            Phase(4, "approach", 5.0, back, _t(here), 3.5),
            Phase(5, "arm to the contact point", 3.0, near),
            Phase(5, "contact", 1.0, touching),
            Phase(6, "contact force", PUSHING, pushing),
            Phase(7, "retract the arm", 2.0, back),
            Phase(7, "retract", 4.0, back, _t(before), 3.5),
            Phase(8, "to the landing point", 6.0, fold, _t(start), 5.0),
            Phase(9, "land", 4.0, fold, _t(lower), 3.5),
        ),
    )


def _t(vector: Array) -> Vector:
    x, y, z = (float(v) for v in vector)
    return x, y, z


def _both(r: Vector) -> dict[str, ArmTask]:
    return {"left": ArmTask(r=r), "right": ArmTask(r=r)}


def _at(r: Vector, p_W: Array, force_W: Array | None = None) -> ArmTask:
    return ArmTask(r=r, p_W=_t(p_W), force_W=_t(np.zeros(3) if force_W is None else force_W))
