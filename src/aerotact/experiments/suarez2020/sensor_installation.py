"""Sensor installation with the long reach: nine phases, 2 N under a pipe for 5 s (suarez2020 VI-B, Figs. 26-31)."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from aerotact.dynamics.model import Model
from aerotact.experiments.experiment import Case, ControllerSpec, PaperNumber
from aerotact.experiments.suarez2020.controllers import MPC, PLATFORM
from aerotact.experiments.suarez2020.flight_plan import LONG_REACH, with_arms
from aerotact.experiments.suarez2020.mission import ArmTask, Mission, Phase, Vector
from aerotact.log import Log
from aerotact.metrics import Metric, rmse
from aerotact.plant.disturbance import Disturbance
from aerotact.plant.placement import Placement
from aerotact.plots import COLOURS, label, panels, save
from aerotact.ports import Array
from aerotact.reference import Reference

PIPE, RADIUS = np.array([1.5, 0.15, 1.1]), 0.1
"""A point of the pipe's axis ahead of the left arm, and its radius, m; world `pipe`."""
TIP = 0.008  # m, radius of the tool's tip
FORCE, PUSHING, SETTLING = 2.0, 10.0, 5.0
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


LAW = ControllerSpec(
    "suarez2020_tools", PLATFORM.rate, "(25)-(28) with the encoders' joints, on the paper's platform", inner=PLATFORM
)
PHASE_6 = 23.0  # s, when it begins
END = PHASE_6 + PUSHING + 16.0
JUDGED = (PHASE_6 + SETTLING, PHASE_6 + PUSHING)


@dataclass(frozen=True)
class SensorInstallation:
    """A sensor is held against a pipe; the robot starts within 10 cm of the hover keyframe."""

    name: str = "suarez2020/sensor-installation"
    doc: str = "VI-B, Figs. 27-31: nine phases with the long reach, 2 N for 5 s under a pipe, and against a plate"
    robot: str = LONG_REACH
    world: str = "pipe"
    seeds: int = 10
    controllers: Mapping[str, ControllerSpec] = field(default_factory=lambda: {"law": LAW, "mpc": MPC})
    cases: tuple[Case, ...] = (
        Case("first", "upwards, in the L-shaped pose (Figs. 27-29)", END, JUDGED),
        Case("second", "upwards, the arm almost stretched (Figs. 30-31)", END, JUDGED),
        Case("forward", "forwards against a plate, so that the pendulum recoils", END, JUDGED),
    )
    paper: Mapping[str, PaperNumber] = field(
        default_factory=lambda: {"mean_first": PaperNumber(2.0, "N", "VI-B: a pushing force of 2 N during 5 s")}
    )

    def reference(self, case: Case, model: Model) -> Reference:
        """The mission."""
        return installation(model, PUSHES[case.name])

    def disturbances(self, case: Case, model: Model, seed: int) -> list[Disturbance]:
        """Where the robot starts; the plate."""
        found: list[Disturbance] = [Placement("base", _t(model.hover_state[:3]), spread=0.1)]
        if case.name == "forward":
            plate = PUSHES["forward"].contact + np.array([TIP + 0.01, 0.0, 0.0])
            found.append(Placement("plate", _t(plate)))
        return found

    def metrics(self, case: Case, log: Log) -> dict[str, Metric]:
        """The force while it is judged, what the arm does for it, and the whole mission."""
        push, rows = PUSHES[case.name], log.window(*case.judged)
        force, swing = pressed(log.columns, push), log["joint"][:, 0]
        before = log.window(PHASE_6 - 1.5, PHASE_6 - 1.0)
        torque = np.abs(STIFFNESS * (log["servo"][:, [0, 3]] - log["joint"][:, [1, 4]]))
        return {
            f"rmse_{case.name}": Metric(rmse(force[rows] - FORCE), "N"),
            f"mean_{case.name}": Metric(float(force[rows].mean()), "N"),
            f"airborne_{case.name}": Metric(float((force[rows] <= 0).mean()), "1"),
            f"peak_{case.name}": Metric(float(force.max()), "N"),
            f"elbow_{case.name}": Metric(float(np.abs(log["joint"][rows, 4]).min()), "rad"),
            f"torque_{case.name}": Metric(float(torque[rows].max()), "N m"),
            f"recoil_{case.name}": Metric(float(swing[rows].mean() - swing[before].mean()), "rad"),
            f"base_{case.name}": Metric(float(np.ptp(log["p_WB"][rows, :2], axis=0).max()), "m"),
            f"done_{case.name}": Metric(float(log["phase"][-1, 0] == 9 and not log["mission_failed"][-1, 0]), "1"),
        }

    def plot(self, runs: Mapping[tuple[str, str], Mapping[str, Array]], folder: Path) -> list[Path]:
        """Figs. 27, 28 and 31: base, force, joints."""
        files = []
        for controller in dict.fromkeys(name for name, _ in runs):
            logs = {case: log for (name, case), log in runs.items() if name == controller}
            figure, axes = panels(3, len(logs), f"{self.name}: {controller}", width=4.4)
            for column, (case, log) in enumerate(logs.items()):
                _panels(axes[:, column], case, log)
            files.append(save(figure, folder / f"sensor_installation_{controller}.png"))
        return files


STIFFNESS = np.array([2.93, 1.48])  # N m/rad, of the left shoulder pitch and elbow


def pressed(log: Mapping[str, Array], push: Push) -> Array:
    """True force of the left tool along the push, N."""
    return np.asarray(-log["f_tools_W"][:, :3] @ np.array(push.direction))


def _panels(axes: Array, case: str, log: Mapping[str, Array]) -> None:
    time, push = log["time"][:, 0], PUSHES[case]
    near = (time > PHASE_6 - 4.0) & (time < PHASE_6 + PUSHING + 3.0)
    for index, colour in zip(range(3), COLOURS, strict=False):
        axes[0].plot(time, log["p_WB"][:, index], color=colour, label=f"{'xyz'[index]} of the base")
        axes[0].plot(time, log["p_WB_r"][:, index], color=colour, ls=":")
    axes[0].set_ylim(-0.3, 3.6)
    label(axes[0], f"{case}: platform", "position in m")
    axes[1].plot(time[near], pressed(log, push)[near], color=COLOURS[0], label="true")
    if "f_left_W" in log:
        axes[1].plot(
            time[near], (log["f_left_W"] @ np.array(push.direction))[near], COLOURS[1], lw=0.8, label="by (26)"
        )
    axes[1].plot(time[near], (log["f_left_d"] @ np.array(push.direction))[near], "k--", lw=1.0, label="reference")
    axes[1].set_ylim(-1.5, 5.0)
    label(axes[1], "contact force", "force in N")
    for joint, name in enumerate(("pitch", "roll", "yaw", "elbow")):
        axes[2].plot(time[near], np.degrees(log["joint"][near, 1 + joint]), color=COLOURS[joint], label=name)
    axes[2].plot(time[near], np.degrees(log["joint"][near, 0]), "k", lw=1.0, label="swing")
    axes[2].set_ylim(-125, 110)
    label(axes[2], "joints of the left arm", "angle in degrees")


EXPERIMENTS = (SensorInstallation(),)
