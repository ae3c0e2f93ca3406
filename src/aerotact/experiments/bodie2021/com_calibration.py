"""COM calibration: the centre of mass from a flight that rolls and pitches on the spot (bodie2021 III-F, (27)-(29))."""

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
from aerotact.experiments.reference import Together, Waypoints, WithFlags
from aerotact.log import Log
from aerotact.loop import Reference
from aerotact.metrics import Metric
from aerotact.plant.disturbance import Disturbance
from aerotact.plant.mismatch import CentreOfMassError
from aerotact.plots import COLOURS, label, panels, save
from aerotact.ports import Array
from aerotact.robot import load_robot

OFFSET = (0.003, -0.0032, 0.0024)  # m in B: 5 mm in all
TURN = np.radians(15.0)
START, END = 4.0, 21.0  # s
_TIMES = [START, 6.0, 8.0, 10.0, 12.0, 14.0, 16.0, 18.0, 20.0]
_ROLL = [0, 1, 0, -1, 0, 0, 0, 0, 0]
_PITCH = [0, 0, 0, 0, 0, 1, 0, -1, 0]
_AXIS_SPAN = 7.0  # mm, of the plots
EVERY = 10  # rows; what the controllers measure is new at 200 Hz, and its noise is averaged all the same


@dataclass(frozen=True)
class Turning:
    """The tool carried by a base that stays in place and turns.

    Attributes:
        base: motion of the base's own frame, named as a tool's.
        p_BE, R_BE: tool in the base, m, shapes (3,) and (3, 3).
    """

    base: Waypoints
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
    """The plant's centre of mass is off by 5 mm; nobody is told."""

    name: str = "bodie2021/com-calibration"
    doc: str = "III-F, (27)-(29): the centre of mass, 5 mm off, from rolling and pitching in one place"
    robot: str = "tilt_rotor"
    world: str = "floor"
    seeds: int = 5
    controllers: Mapping[str, ControllerSpec] = field(default_factory=lambda: controllers("B"))
    cases: tuple[Case, ...] = (Case("off5mm", "centre of mass off by (3, -3.2, 2.4) mm", END, (START, END)),)
    paper: Mapping[str, PaperNumber] = field(default_factory=dict)

    def reference(self, case: Case, model: Model) -> Reference:
        """Roll by 15 degrees to both sides, then pitch, about the base's origin."""
        hover_p, hover_q = model.hover_tool
        R_WB = Rotation.from_quat(hover_q, scalar_first=True).as_matrix() @ model.robot.R_BE.T
        q_WB = Rotation.from_matrix(R_WB).as_quat(scalar_first=True)
        turns = TURN * np.column_stack([_ROLL, _PITCH, np.zeros(len(_TIMES))])
        base = Waypoints(hover_p - R_WB @ model.robot.p_BE, q_WB, _TIMES, np.zeros((len(_TIMES), 3)), turns)
        motion = Turning(base, model.robot.p_BE, model.robot.R_BE)
        return Together((WithFlags(motion, {"calibrate": CALIBRATE}), ForceSteps(())))

    def disturbances(self, case: Case, model: Model, seed: int) -> list[Disturbance]:
        """The offset."""
        return [CentreOfMassError(OFFSET)]

    def metrics(self, case: Case, log: Log) -> dict[str, Metric]:
        """Distance of the estimate to the true centre of mass, and the estimate."""
        found = self.estimate(log.columns, log.window(*case.judged))
        error = {"com_error": Metric(float(np.linalg.norm(found - OFFSET)), "m")}
        return error | {f"com_{axis}": Metric(float(value), "m") for axis, value in zip("xyz", found, strict=True)}

    def estimate(self, log: Mapping[str, Array], rows: slice) -> Array:
        """(28) on the wrench of the measured thrusts and tilts: centre of mass in B from the model's, m, shape (3,)."""
        model = Model(load_robot(self.robot))
        thrust, tilt = ca.SX.sym("thrust", model.rotors), ca.SX.sym("tilt", model.tilts)
        wrench = ca.Function("wrench", [thrust, tilt], list(model.rotor_wrench(thrust, tilt)))
        measured = [log[f"{name}_measured_est"][rows][::EVERY].T for name in ("thrust", "tilt")]
        force, torque = (np.asarray(part).T for part in wrench.map(measured[0].shape[1])(*measured))
        return centre_of_mass(force, torque)

    def plot(self, runs: Mapping[tuple[str, str], Mapping[str, Array]], folder: Path) -> list[Path]:
        """The estimate as the flight goes on, beside the truth."""
        figure, axes = panels(1, 3, f"{self.name}: estimate from the flight so far", width=3.4)
        ends = np.arange(7.0, END + 0.1, 0.5)
        for colour, ((controller, _), log) in zip(COLOURS, runs.items(), strict=False):
            time = log["time"][:, 0]
            rows = [slice(*np.searchsorted(time, [START, end])) for end in ends]
            found = np.array(
                [self.estimate(log, r) if end > 15.0 else np.full(3, np.nan) for r, end in zip(rows, ends, strict=True)]
            )
            for axis, values in zip(axes[0], found.T, strict=True):
                axis.plot(ends, 1e3 * values, color=colour, label=controller)
        for axis, name, true in zip(axes[0], "xyz", OFFSET, strict=True):
            axis.axhline(1e3 * true, color="k", ls="--", lw=1.0, label="true")
            label(axis, f"{name} of the centre of mass in B", "mm")
            axis.set_ylim(1e3 * true - _AXIS_SPAN / 2, 1e3 * true + _AXIS_SPAN / 2)
        return [save(figure, folder / "estimate.png")]


EXPERIMENTS = (ComCalibration(),)
