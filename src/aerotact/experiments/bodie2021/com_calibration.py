"""COM calibration: the centre of mass from a flight that rolls and pitches on the spot (bodie2021 III-F, (27)-(29)).

(27) holds in steady hover. The robot therefore rests in each attitude, and only its rests count. While it turns to and
fro the rotors also give J dw, which is opposite to the angle, as is the torque that a higher centre of mass asks for: a
swing of angular frequency w puts z too high by J w^2 / (m g), 2 mm for a period of 8 s.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import casadi as ca
import numpy as np
from scipy.spatial.transform import Rotation

from aerotact.dynamics.model import Model
from aerotact.estimation.calibration import centre_of_mass
from aerotact.experiments.bodie2021.controllers import controllers
from aerotact.experiments.bodie2021.wall import CALIBRATE, ForceSteps
from aerotact.experiments.experiment import Case, ControllerSpec, PaperNumber
from aerotact.experiments.reference import Together, WithFlags
from aerotact.experiments.trajectory import Move, rest_to_rest
from aerotact.log import Log
from aerotact.metrics import Metric
from aerotact.plant.disturbance import Disturbance
from aerotact.plant.mismatch import CentreOfMassError
from aerotact.plots import COLOURS, label, panels, save
from aerotact.ports import Array
from aerotact.reference import Reference
from aerotact.robot import load_robot

OFFSET = (0.005, -0.005, 0.005)  # m in B
TURN = np.radians(15.0)
# Angles to turn to about B's x and y, in TURN; when the robot sets out, is there, and has rested, s.
_TURNS = (
    ((1, 0), (4.0, 6.0, 8.0)),
    ((-1, 0), (8.0, 11.0, 13.0)),
    ((0, 1), (13.0, 15.5, 17.5)),
    ((0, -1), (17.5, 20.5, 22.5)),
    ((0, 0), (22.5, 24.5, 25.0)),
)
SETTLED = 1.0  # s after the arrival, from when on the robot counts as at rest
RESTS = tuple((there + SETTLED, rested) for turn, (_, there, rested) in _TURNS if any(turn))
START, END = RESTS[0][0], _TURNS[-1][1][2]  # s
_AXIS_SPAN = 3.0  # mm, of the plots
EVERY = 10  # rows; what the controllers measure is new at 200 Hz, and its noise is averaged all the same


@dataclass(frozen=True)
class Turning:
    """The tool carried by a base that stays in place and turns.

    Attributes:
        base: motion of the base's own frame, named as a tool's.
        p_BE, R_BE: tool in the base, m, shapes (3,) and (3, 3).
    """

    base: Reference
    p_BE: Array
    R_BE: Array

    def sample(self, times: Array) -> dict[str, Array]:
        """Desired motion of the tool, one row a time."""
        b = self.base.sample(times)
        turn, w, dw = Rotation.from_quat(b["q_WE_d"], scalar_first=True), b["w_E_d"], b["dw_E_d"]
        swung = np.cross(w, self.p_BE)
        return {
            "p_WE_d": b["p_WE_d"] + turn.apply(self.p_BE),
            "q_WE_d": (turn * Rotation.from_matrix(self.R_BE)).as_quat(scalar_first=True),
            "v_WE_d": b["v_WE_d"] + turn.apply(swung),
            "w_E_d": w @ self.R_BE,
            "a_WE_d": b["a_WE_d"] + turn.apply(np.cross(dw, self.p_BE) + np.cross(w, swung)),
            "dw_E_d": dw @ self.R_BE,
        }


@dataclass(frozen=True)
class ComCalibration:
    """The plant's centre of mass is off by 5 mm along each axis; nobody is told."""

    name: str = "bodie2021/com-calibration"
    doc: str = "III-F, (27)-(29): the centre of mass, 5 mm off along each axis, from rolling and pitching in one place"
    robot: str = "tilt_rotor"
    world: str = "floor"
    seeds: int = 5
    controllers: Mapping[str, ControllerSpec] = field(default_factory=lambda: controllers("B"))
    cases: tuple[Case, ...] = (Case("off5mm", "centre of mass off by (5, -5, 5) mm", END, (START, END)),)
    paper: Mapping[str, PaperNumber] = field(default_factory=dict)

    def reference(self, case: Case, model: Model) -> Reference:
        """Roll by 15 degrees to both sides, then pitch, about the base's origin, and rest in each attitude."""
        hover_p, hover_q = model.hover_tool
        turn_WB = Rotation.from_quat(hover_q, scalar_first=True) * Rotation.from_matrix(model.robot.R_BE).inv()
        p_WB, q_WB = hover_p - turn_WB.apply(model.robot.p_BE), turn_WB.as_quat(scalar_first=True)
        moves = [
            Move(
                start,
                there,
                p_WB,
                (turn_WB * Rotation.from_rotvec([*(TURN * np.array(xy)), 0.0])).as_quat(scalar_first=True),
            )
            for xy, (start, there, _) in _TURNS
        ]
        base = rest_to_rest(p_WB, q_WB, moves)
        motion = Turning(base, model.robot.p_BE, model.robot.R_BE)
        return Together((WithFlags(motion, {"calibrate": CALIBRATE}), ForceSteps(())))

    def disturbances(self, case: Case, model: Model, seed: int) -> list[Disturbance]:
        """The offset."""
        return [CentreOfMassError(OFFSET)]

    def metrics(self, case: Case, log: Log) -> dict[str, Metric]:
        """Distance of the estimate to the true centre of mass, and the estimate."""
        found = self.estimate(log.columns)
        error = {"com_error": Metric(float(np.linalg.norm(found - OFFSET)), "m")}
        return error | {f"com_{axis}": Metric(float(value), "m") for axis, value in zip("xyz", found, strict=True)}

    def estimate(self, log: Mapping[str, Array], end: float = np.inf) -> Array:
        """(28) on the wrench of the measured thrusts and tilts: centre of mass in B from the model's, m, shape (3,).

        Args:
            log: columns of a run.
            end: s; only rests that ended by then count, of which there must be one rolled and one pitched.
        """
        model = Model(load_robot(self.robot))
        thrust, tilt = ca.SX.sym("thrust", model.rotors), ca.SX.sym("tilt", model.tilts)
        wrench = ca.Function("wrench", [thrust, tilt], list(model.rotor_wrench(thrust, tilt)))
        rows = steady(log["time"][:, 0], end)[::EVERY]
        measured = [log[f"{name}_measured_est"][rows].T for name in ("thrust", "tilt")]
        force, torque = (np.asarray(part).T for part in wrench.map(len(rows))(*measured))
        return centre_of_mass(force, torque)

    def plot(self, runs: Mapping[tuple[str, str], Mapping[str, Array]], folder: Path) -> list[Path]:
        """The estimate as the flight goes on, beside the truth."""
        figure, axes = panels(1, 3, f"{self.name}: estimate from the attitudes so far", width=3.4)
        ends = [rested for _, rested in RESTS[1:]]
        for colour, ((controller, _), log) in zip(COLOURS, runs.items(), strict=False):
            found = np.array([self.estimate(log, end) for end in ends])
            for axis, values in zip(axes[0], found.T, strict=True):
                axis.plot(range(2, 2 + len(ends)), 1e3 * values, "o-", color=colour, label=controller)
        for axis, name, true in zip(axes[0], "xyz", OFFSET, strict=True):
            axis.axhline(1e3 * true, color="k", ls="--", lw=1.0, label="true")
            label(axis, f"{name} of the centre of mass in B", "mm", "attitudes")
            axis.set_xticks(range(2, 2 + len(ends)))
            axis.set_ylim(1e3 * true - _AXIS_SPAN / 2, 1e3 * true + _AXIS_SPAN / 2)
        return [save(figure, folder / "estimate.png")]


def steady(time: Array, end: float = np.inf) -> Array:
    """Indices of the rows in which the robot rests in one of the attitudes, of those rests that ended by `end`, s."""
    return np.flatnonzero(np.any([(time >= a) & (time < b) for a, b in RESTS if b <= end], axis=0))


EXPERIMENTS = (ComCalibration(),)
