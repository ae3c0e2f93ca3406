"""Hover: both configurations stay where they are for a minute, on simulated sensors."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from aerotact.dynamics.model import Model
from aerotact.experiments.experiment import Case, ControllerSpec, PaperNumber
from aerotact.experiments.suarez2020.controllers import MPC, PLATFORM
from aerotact.experiments.suarez2020.flight_plan import LONG_REACH, STANDARD, resting
from aerotact.experiments.suarez2020.pendulum import swing, tilt
from aerotact.log import Log
from aerotact.metrics import Metric, rmse
from aerotact.plant.disturbance import Disturbance
from aerotact.plots import COLOURS, label, panels, save
from aerotact.ports import Array
from aerotact.reference import Reference

END, SETTLED = 60.0, 5.0  # s


@dataclass(frozen=True)
class Hover:
    """Arms L-shaped, nothing acts but the sensors' errors."""

    name: str = "suarez2020/hover"
    doc: str = "a minute of hover of both configurations on simulated sensors"
    robot: str = STANDARD
    world: str = "floor"
    seeds: int = 5
    controllers: Mapping[str, ControllerSpec] = field(default_factory=lambda: {"law": PLATFORM, "mpc": MPC})
    cases: tuple[Case, ...] = (
        Case("standard", "arms at the base", END, (SETTLED, END), robot=STANDARD),
        Case("long-reach", "arms below a passive pendulum", END, (SETTLED, END), robot=LONG_REACH),
    )
    paper: Mapping[str, PaperNumber] = field(default_factory=dict)

    def reference(self, case: Case, model: Model) -> Reference:
        """Stay."""
        return resting(model)

    def disturbances(self, case: Case, model: Model, seed: int) -> list[Disturbance]:
        """None."""
        return []

    def metrics(self, case: Case, log: Log) -> dict[str, Metric]:
        """How far base, tools and pendulum stray."""
        rows = log.window(*case.judged)
        base = log["p_WB"][rows] - log["p_WB_r"][rows]
        tools = log["p_tools_W"][rows] - log["p_tools_W"][0]
        found = {
            f"base_rmse_{case.name}": Metric(rmse(base), "m"),
            f"base_max_{case.name}": Metric(float(np.linalg.norm(base, axis=1).max()), "m"),
            f"tool_rmse_{case.name}": Metric(rmse(tools[:, :3]), "m"),
            f"tilt_max_{case.name}": Metric(float(tilt(log["q_WB"][rows]).max()), "rad"),
        }
        if case.robot == LONG_REACH:
            found[f"swing_max_{case.name}"] = Metric(float(np.abs(swing(log.columns)[rows]).max()), "rad")
        return found

    def plot(self, runs: Mapping[tuple[str, str], Mapping[str, Array]], folder: Path) -> list[Path]:
        """Base and left tool over time."""
        names = list(dict.fromkeys(case for _, case in runs))
        figure, axes = panels(2, len(names), self.name, width=5.0)
        for column, name in enumerate(names):
            for (controller, case), log in runs.items():
                if case != name:
                    continue
                time = log["time"][:, 0]
                for axis, colour in enumerate(COLOURS[:3]):
                    text = f"{controller} {'xyz'[axis]}"
                    axes[0, column].plot(time, 1e3 * (log["p_WB"] - log["p_WB_r"])[:, axis], color=colour, label=text)
                    moved = log["p_tools_W"][:, axis] - log["p_tools_W"][0, axis]
                    axes[1, column].plot(time, 1e3 * moved, color=colour, label=text)
            label(axes[0, column], f"{name}: base minus reference", "error in mm")
            label(axes[1, column], f"{name}: left tool from its start", "distance in mm")
        return [save(figure, folder / "hover.png")]


EXPERIMENTS = (Hover(),)
