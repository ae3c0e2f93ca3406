"""Hover grasp: both tools stay at their grasping points for 50 s while air moves the robot (suarez2020 VI-A-3)."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from aerotact.dynamics.model import Model
from aerotact.experiments.experiment import Case, ControllerSpec, PaperNumber
from aerotact.experiments.reference import Together
from aerotact.experiments.suarez2020.controllers import MPC, PLATFORM, TOOLS
from aerotact.experiments.suarez2020.flight_plan import LONG_REACH, STANDARD, Grasp, hovering, with_arms
from aerotact.experiments.suarez2020.pendulum import swing
from aerotact.log import Log
from aerotact.metrics import Metric, rmse
from aerotact.plant.disturbance import Disturbance
from aerotact.plant.gust import Gust
from aerotact.plots import COLOURS, label, panels, save
from aerotact.ports import Array
from aerotact.reference import Reference

START, SETTLED, END = 2.0, 6.0, 56.0  # s
# Air, assumed: the paper names aerodynamic effects in its testbed and gives no numbers. Standard deviations, N, time
# constants, s, and the rotors' downwash on a forearm, N.
BASE_GUST, BASE_LASTS, ARM_GUST, ARM_LASTS, DOWNWASH = 0.5, 0.8, 0.08, 0.3, (0.0, 0.0, -0.1)


@dataclass(frozen=True)
class HoverGrasp:
    """The grasping points are where the tools hover; Vicon knows them, the arms follow."""

    name: str = "suarez2020/hover-grasp"
    doc: str = "Figs. 22-24: both tools at their grasping points for 50 s in hover, in moving air"
    robot: str = STANDARD
    world: str = "floor"
    seeds: int = 5
    controllers: Mapping[str, ControllerSpec] = field(
        default_factory=lambda: {"arms-held": PLATFORM, "law": TOOLS, "mpc": MPC}
    )
    cases: tuple[Case, ...] = (
        Case("standard", "arms at the base", END, (SETTLED, END), robot=STANDARD),
        Case("long-reach", "arms below a passive pendulum", END, (SETTLED, END), robot=LONG_REACH),
    )
    paper: Mapping[str, PaperNumber] = field(default_factory=dict)

    def reference(self, case: Case, model: Model) -> Reference:
        """Platform and tools where they hover."""
        return Together((hovering(model), Grasp(with_arms(model), START)))

    def disturbances(self, case: Case, model: Model, seed: int) -> list[Disturbance]:
        """Gusts on base and forearms, downwash on the forearms."""
        mj = model.robot.mjmodel
        forearms = [mj.body(mj.site_bodyid[arm.tool_index]).name for arm in model.robot.arms]
        base = Gust(mj.body(model.robot.base_id).name, BASE_GUST, BASE_LASTS)
        return [base, *(Gust(forearm, ARM_GUST, ARM_LASTS, DOWNWASH) for forearm in forearms)]

    def metrics(self, case: Case, log: Log) -> dict[str, Metric]:
        """Distances of the tools to their points, of the base to its own; as in Fig. 24."""
        rows = log.window(*case.judged)
        errors = tool_errors(log.columns)[rows]
        base = log["p_WB"][rows] - log["p_WB_r"][rows]
        found = {
            "tools_rmse": Metric(float(np.hypot(rmse(errors[:, 0]), rmse(errors[:, 1])) / np.sqrt(2)), "m"),
            **{f"{side}_rmse": Metric(rmse(errors[:, n]), "m") for n, side in enumerate(("left", "right"))},
            **{f"left_rmse_{axis}": Metric(rmse(errors[:, 0, n]), "m") for n, axis in enumerate("xyz")},
            "left_max": Metric(float(np.linalg.norm(errors[:, 0], axis=1).max()), "m"),
            "base_rmse": Metric(rmse(base), "m"),
        }
        if case.robot == LONG_REACH:
            found["swing_rms"] = Metric(rmse(swing(log.columns)[rows]), "rad")
        return {f"{name}_{case.name}": metric for name, metric in found.items()}

    def plot(self, runs: Mapping[tuple[str, str], Mapping[str, Array]], folder: Path) -> list[Path]:
        """Figs. 23 and 24: left tool beside its point, distances of the tools and of the base."""
        return [_figure_23(self, runs, folder), _figure_24(self, runs, folder)]


def tool_errors(log: Mapping[str, Array]) -> Array:
    """Tool minus grasping point of each arm, m in W, (rows, arms, 3); the points are where the tools began."""
    tools = log["p_tools_W"].reshape(len(log["p_tools_W"]), -1, 3)
    return np.asarray(tools - tools[0])


def _figure_23(experiment: HoverGrasp, runs: Mapping[tuple[str, str], Mapping[str, Array]], folder: Path) -> Path:
    names = [c.name for c in experiment.cases if any(case == c.name for _, case in runs)]
    figure, axes = panels(
        3, len(names), f"{experiment.name}: left tool and its grasping point, as in Fig. 23", width=5.0
    )
    for column, name in enumerate(names):
        flown = [(controller, log) for (controller, case), log in runs.items() if case == name]
        for row, axis in enumerate("xyz"):
            for colour, (controller, log) in zip(COLOURS, flown, strict=False):
                place = axes[row, column]
                place.plot(log["time"][:, 0], log["p_tools_W"][:, row], color=colour, label=controller)
                place.axhline(log["p_tools_W"][0, row], color="k", lw=0.8)
            label(axes[row, column], f"{name}: {axis}", "position in m")
    return save(figure, folder / "fig23.png")


def _figure_24(experiment: HoverGrasp, runs: Mapping[tuple[str, str], Mapping[str, Array]], folder: Path) -> Path:
    names = [c.name for c in experiment.cases if any(case == c.name for _, case in runs)]
    figure, axes = panels(
        3, len(names), f"{experiment.name}: tracking error and displacement, as in Fig. 24", width=5.0
    )
    for column, name in enumerate(names):
        flown = [(controller, log) for (controller, case), log in runs.items() if case == name]
        for colour, (controller, log) in zip(COLOURS, flown, strict=False):
            time, distance = log["time"][:, 0], 1e3 * np.linalg.norm(tool_errors(log), axis=2)
            base = 1e3 * np.linalg.norm(log["p_WB"] - log["p_WB_r"], axis=1)
            for row, values in enumerate((distance[:, 0], distance[:, 1], base)):
                axes[row, column].plot(time, values, color=colour, label=controller, lw=0.9)
        for row, what in enumerate(("left tool", "right tool", "base")):
            label(axes[row, column], f"{name}: {what}", "distance in mm")
    return save(figure, folder / "fig24.png")


EXPERIMENTS = (HoverGrasp(),)
