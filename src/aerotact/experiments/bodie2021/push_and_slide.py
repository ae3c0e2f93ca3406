"""Push and slide: the tool draws a spline on a whiteboard at four pressures (bodie2021 V-D, Table VI, Figs. 11-12)."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from aerotact.dynamics.model import Model
from aerotact.experiments.bodie2021.controllers import controllers
from aerotact.experiments.bodie2021.disturbed import disturbed_machine
from aerotact.experiments.bodie2021.violins import violins
from aerotact.experiments.bodie2021.wall import ARRIVE, CALIBRATE, DEPART, WALL
from aerotact.experiments.experiment import Case, ControllerSpec, PaperNumber
from aerotact.experiments.force_profile import ForceProfile, Ramp
from aerotact.experiments.reference import Together, Waypoints, WithFlags
from aerotact.experiments.trajectory import Chain, Line, Sampled, TimeScaled, chord_lengths
from aerotact.log import LOG_RATE, Log
from aerotact.metrics import Metric, in_band, push_force, rmse
from aerotact.plant.disturbance import Disturbance
from aerotact.plant.mismatch import ToolYawError
from aerotact.plots import COLOURS, label, panels, save
from aerotact.ports import Array
from aerotact.reference import Reference
from aerotact.robot import load_robot

RAMP = (8.5, 10.0)  # s, of the force
SLIDE = (14.0, 27.0)  # s; all are in contact when it begins, as in the paper's Fig. 12
LIFT = (27.5, 28.0)  # s, the force goes back to 0
AWAY, END = 29.5, 30.0  # s
BACK = 0.15  # m, of the retreat
IMPEDANCE_DEPTH = 0.04  # m, of the set-point behind the board where no force is wanted
YAW = 10.0  # degrees
MPC_GAINS = {"weight_tilt_rate": 2e-4}
"""Of the MPC: servos turn more freely, against the wrench noise."""
# A closed curve of 0.7 m x 0.4 m that crosses itself, as across and up from where the tool hovers, m.
_CURVE = np.array(
    [
        [0.0, 0.0],
        [0.25, 0.2],
        [0.35, 0.0],
        [0.25, -0.2],
        [0.0, 0.0],
        [-0.25, 0.2],
        [-0.35, 0.0],
        [-0.25, -0.2],
        [0.0, 0.0],
    ]
)
FORCES = {"impedance": 0.0, "1N": 1.0, "3N": 3.0, "5N": 5.0, "5N-yaw": 5.0}
"""Case -> force wanted, N."""
_TABLE_VI = {
    "impedance": (0.0055, 0.0131, 0.0962, 0.0183, None),
    "1N": (0.0063, 0.0118, 0.1319, 0.0152, 1.0627),
    "3N": (0.0061, 0.0124, 0.1096, 0.0180, 1.2761),
    "5N": (0.0067, 0.0115, 0.1049, 0.0181, 1.0963),
}


def _case(name: str) -> Case:
    force = FORCES[name]
    doc = f"{force:g} N" if force else f"no force wanted, the set-point {1e3 * IMPEDANCE_DEPTH:g} mm behind the board"
    yaw = f", the tool turned by {YAW:g} degrees against its calibration" if name == "5N-yaw" else ""
    return Case(name, doc + yaw, END, SLIDE)


def _paper() -> dict[str, PaperNumber]:
    found: dict[str, PaperNumber] = {}
    for case, row in _TABLE_VI.items():
        for metric, symbol, value in zip(
            ("body_across", "body_up", "tool_across", "tool_up", "force_band"),
            ("e_B,x", "e_B,z", "e_t,x", "e_t,z", "e_f"),
            row,
            strict=True,
        ):
            if value is not None:
                unit = "N" if symbol == "e_f" else "m"
                found[f"{metric}_{case}"] = PaperNumber(value, unit, f"Table VI, {symbol}, {case}")
    # The table's e_t,x is that of a tool which is not where it is believed to be.
    found["tool_across_5N-yaw"] = found["tool_across_5N"]
    return found


@dataclass(frozen=True)
class PushAndSlide:
    """The tool on a closed spline, pressed on the board with a constant force, or by impedance alone."""

    name: str = "bodie2021/push-and-slide"
    doc: str = "V-D, Table VI, Figs. 11-12: along a spline on a whiteboard with 0, 1, 3, 5 N, on the disturbed machine"
    robot: str = "tilt_rotor"
    world: str = "whiteboard"
    seeds: int = 5
    controllers: Mapping[str, ControllerSpec] = field(
        default_factory=lambda: controllers("D", mpc=MPC_GAINS, estimators={"contact_observer": {"L_normal": 150.0}})
    )
    cases: tuple[Case, ...] = tuple(map(_case, FORCES))
    paper: Mapping[str, PaperNumber] = field(default_factory=_paper)

    def reference(self, case: Case, model: Model) -> Reference:
        """To the board, along the spline, and back."""
        p_WE, q_WE = model.hover_tool
        force = FORCES[case.name]
        depth = 0.0 if force else IMPEDANCE_DEPTH
        start = np.array([WALL + depth, p_WE[1], p_WE[2]])
        behind = start - [depth + BACK, 0.0, 0.0]
        curve = np.column_stack([np.zeros(len(_CURVE)), _CURVE])
        lengths = chord_lengths(curve)
        spline = Waypoints(start, q_WE, list(lengths), curve, np.zeros_like(curve), at_rest=False)
        motion = Chain(
            [
                (DEPART, TimeScaled(Line(p_WE, q_WE, start, q_WE), (0.0, 1.0), DEPART, ARRIVE)),
                (SLIDE[0], TimeScaled(spline, (0.0, lengths[-1]), *SLIDE)),
                (LIFT[1], TimeScaled(Line(start, q_WE, behind, q_WE), (0.0, 1.0), LIFT[1], AWAY)),
            ]
        )
        push = ForceProfile([Ramp(*RAMP, force), Ramp(*LIFT, 0.0)] if force else [])
        return Together([WithFlags(Sampled(motion), {"calibrate": CALIBRATE}), push])

    def disturbances(self, case: Case, model: Model, seed: int) -> list[Disturbance]:
        """The disturbed machine; in one case the tool is not where it is believed to be."""
        yaw: list[Disturbance] = [ToolYawError(float(np.deg2rad(YAW)))] if case.name == "5N-yaw" else []
        return [*yaw, *disturbed_machine(seed)]

    def metrics(self, case: Case, log: Log) -> dict[str, Metric]:
        """RMSE of body and tool in the board's plane, of the force, and the share of time without contact."""
        rows, name = log.window(*case.judged), case.name
        body, tool = plane_errors(self.robot, log.columns)
        force, wanted = push_force(log.columns), log["f_ref"][rows, 0]
        found = {
            f"body_across_{name}": Metric(rmse(body[rows, 0]), "m"),
            f"body_up_{name}": Metric(rmse(body[rows, 1]), "m"),
            f"tool_across_{name}": Metric(rmse(tool[rows, 0]), "m"),
            f"tool_up_{name}": Metric(rmse(tool[rows, 1]), "m"),
            f"tool_plane_{name}": Metric(rmse(tool[rows]), "m"),
            f"airborne_{name}": Metric(float((force[rows] <= 0.0).mean()), "1"),
            f"peak_{name}": Metric(float(force.max()), "N"),
        }
        if FORCES[name]:
            found[f"force_{name}"] = Metric(rmse(force[rows] - wanted), "N")
            found[f"force_band_{name}"] = Metric(rmse(in_band(force, log.period)[rows] - wanted), "N")
        return found

    def plot(self, runs: Mapping[tuple[str, str], Mapping[str, Array]], folder: Path) -> list[Path]:
        """Figs. 11 and 12 as violins, the drawn lines, and the forces over time."""
        labels = list(dict.fromkeys(controller for controller, _ in runs))
        cases = [c.name for c in self.cases if any((n, c.name) in runs for n in labels)]
        return [
            self._figure_11(runs, labels, cases, folder),
            self._figure_12(runs, labels, cases, folder),
            self._drawn(runs, labels, cases, folder),
        ]

    def _figure_11(self, runs: Mapping, labels: list[str], cases: list[str], folder: Path) -> Path:
        figure, axes = panels(2, 2, f"{self.name}: errors in the board's plane, as in Fig. 11")
        parts = (("body across", 0, 0), ("body up", 0, 1), ("tool across", 1, 0), ("tool up", 1, 1))
        errors = {key: plane_errors(self.robot, log) for key, log in runs.items()}
        for axis, (title, part, column) in zip(axes.flat, parts, strict=True):
            series = {
                n: {c: 1e3 * errors[n, c][part][_judged(runs[n, c]), column] for c in cases if (n, c) in runs}
                for n in labels
            }
            violins(axis, series, cases)
            label(axis, title, "error in mm", x="case")
            if axis is not axes[0, 0]:
                axis.get_legend().remove()
        return save(figure, folder / "fig11_position.png")

    def _figure_12(self, runs: Mapping, labels: list[str], cases: list[str], folder: Path) -> Path:
        pressed = [c for c in cases if FORCES[c]]
        figure, axes = panels(1, 2, f"{self.name}: errors of the normal force, as in Fig. 12", height=3.0)
        for axis, filtered in zip(axes.flat, (True, False), strict=True):
            series = {n: {c: _force_error(runs[n, c], filtered) for c in pressed if (n, c) in runs} for n in labels}
            violins(axis, series, pressed)
            label(axis, "behind the filter of 5 Hz" if filtered else "true force", "measured - wanted in N", x="case")
        axes[0, 1].get_legend().remove()
        return save(figure, folder / "fig12_force.png")

    def _drawn(self, runs: Mapping, labels: list[str], cases: list[str], folder: Path) -> Path:
        figure, axes = panels(2, len(cases), f"{self.name}: what is drawn, and the force", width=3.4, height=2.8)
        for column, case in enumerate(cases):
            line, force = axes[:, column]
            for colour, name in zip(COLOURS, labels, strict=False):
                if (name, case) not in runs:
                    continue
                log = runs[name, case]
                rows, time = _judged(log), log["time"][:, 0]
                line.plot(-log["p_WE"][rows, 1], log["p_WE"][rows, 2], color=colour, label=name, lw=1.0)
                force.plot(time, in_band(push_force(log), 1 / LOG_RATE), color=colour, label=name, lw=0.9)
            wanted = next(runs[n, case] for n in labels if (n, case) in runs)
            rows = _judged(wanted)
            line.plot(-wanted["p_WE_d"][rows, 1], wanted["p_WE_d"][rows, 2], "k:", label="wanted", lw=1.0)
            force.plot(wanted["time"][:, 0], wanted["f_ref"][:, 0], "k:", label="wanted")
            line.set_aspect("equal")
            label(line, case, "up in m", x="across in m, seen from behind the robot", legend=[])
            label(force, f"{case}, 5 Hz", "normal force in N", legend=None if column == 0 else [])
            force.set(xlim=(ARRIVE - 0.5, AWAY), ylim=(-0.5, 2.2 * max(FORCES[case], 1.5) + 1))
        return save(figure, folder / "drawn.png")


def plane_errors(robot: str, log: Mapping[str, Array]) -> tuple[Array, Array]:
    """Errors of body and tool in the board's plane, across (W's y) and up, m, shape (rows, 2) each.

    The body's set-point is where it puts the tool at its set-point if the tool is where it is believed to be.
    """
    believed = load_robot(robot)
    R_WB_d = Rotation.from_quat(log["q_WE_d"], scalar_first=True) * Rotation.from_matrix(believed.R_BE).inv()
    body = log["p_WB"] - (log["p_WE_d"] - R_WB_d.apply(believed.p_BE))
    return body[:, 1:], (log["p_WE"] - log["p_WE_d"])[:, 1:]


def _judged(log: Mapping[str, Array]) -> Array:
    return np.flatnonzero((log["time"][:, 0] >= SLIDE[0]) & (log["time"][:, 0] < SLIDE[1]))


def _force_error(log: Mapping[str, Array], filtered: bool) -> Array:
    rows, force = _judged(log), push_force(log)
    return np.asarray((in_band(force, 1 / LOG_RATE) if filtered else force)[rows] - log["f_ref"][rows, 0])


EXPERIMENTS = (PushAndSlide(),)
