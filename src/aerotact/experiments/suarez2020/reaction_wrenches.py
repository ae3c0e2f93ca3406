"""Reaction wrenches: the same push by the left arm in both configurations, and what the platform feels of it (VI-C)."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import casadi as ca
import numpy as np
from scipy.spatial.transform import Rotation

from aerotact.dynamics.model import Model
from aerotact.dynamics.model_of import model_of
from aerotact.experiments.experiment import Case, ControllerSpec, PaperNumber
from aerotact.experiments.suarez2020.controllers import PLATFORM
from aerotact.experiments.suarez2020.flight_plan import LONG_REACH, STANDARD, hovering
from aerotact.experiments.suarez2020.pendulum import swing
from aerotact.log import Log
from aerotact.metrics import Metric
from aerotact.plant.disturbance import Disturbance, ToolForce
from aerotact.plots import COLOURS, label, panels, save
from aerotact.ports import Array
from aerotact.reference import Reference
from aerotact.robot import load_robot

PUSH = 2.0  # N, by the arm on the environment, as in VI-B
START, STOP, RAMP, END = 5.0, 20.0, 1.0, 21.0  # s
BEFORE, PUSHING = (3.0, START), (STOP - RAMP - 4.0, STOP - RAMP)  # s, over which means are taken
DIRECTIONS = {"up": (0.0, 0.0, 1.0), "forward": (1.0, 0.0, 0.0)}
PIPE, PROPELLER, TIP = 0.10, 0.1905, 0.008  # radii, m: Fig. 32, Table 1, and of the sphere at the tool


def _case(configuration: str, direction: str, robot: str) -> Case:
    name = f"{configuration}-{direction}"
    return Case(name, f"{configuration}, {PUSH:g} N {direction}", END, (PUSHING[0], PUSHING[1]), robot=robot)


@dataclass(frozen=True)
class ReactionWrenches:
    """L-shaped arms, the base in its place; the environment answers the left tool's push; nobody is told of it."""

    name: str = "suarez2020/reaction-wrenches"
    doc: str = (
        "Fig. 33: 2 N up and forward by the left tool: torque and force at the platform, recoil; distances, Fig. 32"
    )
    robot: str = STANDARD
    world: str = "floor"
    seeds: int = 5
    controllers: Mapping[str, ControllerSpec] = field(default_factory=lambda: {"law": PLATFORM})
    cases: tuple[Case, ...] = tuple(
        _case(configuration, direction, robot)
        for configuration, robot in (("standard", STANDARD), ("long-reach", LONG_REACH))
        for direction in DIRECTIONS
    )
    paper: Mapping[str, PaperNumber] = field(
        default_factory=lambda: {
            f"pitch_long-reach-{d}": PaperNumber(
                0.0, "N m", "Comparison, Fig. 33: 'no torque is exerted in the pitch angle'"
            )
            for d in DIRECTIONS
        }
    )

    def reference(self, case: Case, model: Model) -> Reference:
        """Stay."""
        return hovering(model)

    def disturbances(self, case: Case, model: Model, seed: int) -> list[Disturbance]:
        """The answer to the push."""
        x, y, z = (-PUSH * part for part in DIRECTIONS[case.name.rsplit("-", 1)[1]])
        return [ToolForce((x, y, z), START, STOP, ramp=RAMP)]

    def metrics(self, case: Case, log: Log) -> dict[str, Metric]:
        """What the rotors give while the arm pushes, less what they give before; recoil; distance to the pipe.

        Roll and pitch: torque about the base's origin that the platform feels, the rotors' with the other sign. Axial:
        force of arms and pendulum on the base, upwards.
        """
        before, pushing = log.window(*BEFORE), log.window(*PUSHING)
        lift, torque = rotor_wrench(str(case.robot), log["thrust"])
        felt = -(torque[pushing].mean(axis=0) - torque[before].mean(axis=0))
        found = {
            "roll": Metric(float(felt[0]), "N m"),
            "pitch": Metric(float(felt[1]), "N m"),
            "axial": Metric(float(lift[before].mean() - lift[pushing].mean()), "N"),
            "tool_moved": Metric(float(np.linalg.norm(_mean_change(log["p_WE"], before, pushing))), "m"),
        }
        if case.robot == LONG_REACH:
            found["recoil"] = Metric(float(_mean_change(swing(log.columns)[:, None], before, pushing)[0]), "rad")
        if case.name.endswith("up"):
            found["pipe_to_propellers"] = Metric(pipe_distance(str(case.robot), log.columns, pushing), "m")
        return {f"{name}_{case.name}": metric for name, metric in found.items()}

    def plot(self, runs: Mapping[tuple[str, str], Mapping[str, Array]], folder: Path) -> list[Path]:
        """Torque, lift and recoil over time, of both configurations."""
        figure, axes = panels(3, 2, f"{self.name}: what the platform feels of {PUSH:g} N, as in Fig. 33", width=5.0)
        for column, direction in enumerate(DIRECTIONS):
            flown = [(case, log) for (_, case), log in runs.items() if case.endswith(direction)]
            for colour, (name, log) in zip(COLOURS, flown, strict=False):
                case = next(c for c in self.cases if c.name == name)
                time = log["time"][:, 0]
                rest = (time >= BEFORE[0]) & (time < BEFORE[1])
                lift, torque = rotor_wrench(str(case.robot), log["thrust"])
                felt = torque[rest, 1].mean() - torque[:, 1]
                axes[0, column].plot(time, _smooth(felt), color=colour, label=case.doc)
                axes[1, column].plot(time, _smooth(lift[rest].mean() - lift), color=colour, label=case.doc)
                if case.robot == LONG_REACH:
                    axes[2, column].plot(time, np.rad2deg(swing(log)), color=colour, label=case.doc)
            label(axes[0, column], f"{direction}: pitch torque on the platform", "torque in N m")
            label(axes[1, column], f"{direction}: force on the platform along z", "force in N")
            label(axes[2, column], f"{direction}: recoil", "angle in degrees")
        return [save(figure, folder / "fig33.png")]


@cache
def _model(robot: str) -> Model:
    return model_of(load_robot(robot))


@cache
def _allocation(robot: str) -> Array:
    """Matrix (4, n) from thrusts, N, to lift, N, and torque about the base's origin, N m in B."""
    model, columns = _model(robot), []
    for unit in np.eye(model.rotors):
        force, torque = (ca.DM(part).full().ravel() for part in model.rotor_wrench(ca.DM(unit)))
        columns.append([force[2], *torque])
    return np.array(columns).T


def rotor_wrench(robot: str, thrust: Array) -> tuple[Array, Array]:
    """Lift, N, (rows,), and torque about the base's origin, N m in B, (rows, 3), of thrusts, N, (rows, n)."""
    wrench = thrust @ _allocation(robot).T
    return wrench[:, 0], wrench[:, 1:]


def pipe_distance(robot: str, log: Mapping[str, Array], rows: slice) -> float:
    """Least distance, m, of the propellers' rims from a pipe along y that the left tool touches from below, Fig. 32."""
    p_WB, p_WE = log["p_WB"][rows].mean(axis=0), log["p_WE"][rows].mean(axis=0)
    turn = Rotation.from_quat(log["q_WB"][rows].mean(axis=0), scalar_first=True)
    angles = np.linspace(0.0, 2 * np.pi, 73)
    rim = PROPELLER * np.column_stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)])
    discs = np.vstack([rotor.p_BR + rim for rotor in _model(robot).robot.rotors])
    from_axis = p_WB + turn.apply(discs) - p_WE - [0.0, 0.0, TIP + PIPE]
    return float(np.hypot(from_axis[:, 0], from_axis[:, 2]).min() - PIPE)


def _mean_change(values: Array, before: slice, after: slice) -> Array:
    return np.asarray(values[after].mean(axis=0) - values[before].mean(axis=0))


def _smooth(values: Array, rows: int = 30) -> Array:
    """Mean over a window, for the eye."""
    return np.asarray(np.convolve(np.pad(values, rows // 2, mode="edge"), np.ones(rows) / rows, "same"))[
        rows // 2 : rows // 2 + len(values)
    ]


EXPERIMENTS = (ReactionWrenches(),)
