"""Stop: the platform flies at 1 m/s and stops; the pendulum swings on."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from aerotact.dynamics.model import Model
from aerotact.experiments.experiment import Case, ControllerSpec, PaperNumber
from aerotact.experiments.suarez2020.controllers import LQR, MPC, PID, PLATFORM
from aerotact.experiments.suarez2020.flight_plan import LONG_REACH, resting
from aerotact.experiments.suarez2020.pendulum import settled, swing
from aerotact.log import Log
from aerotact.metrics import Metric
from aerotact.plant.disturbance import Disturbance
from aerotact.plots import COLOURS, label, panels, save
from aerotact.ports import Array
from aerotact.reference import Reference

START, FLIES, STOP, STANDS, END = 2.0, 3.25, 7.0, 7.5, 13.0  # s
AHEAD, BACK = 0.8, 2.0  # m/s2; 1 m/s between
LEGS = (
    (START, (AHEAD, 0.0, 0.0)),
    (FLIES, (0.0, 0.0, 0.0)),
    (STOP, (-BACK, 0.0, 0.0)),
    (STANDS, (0.0, 0.0, 0.0)),
)
BOUND = float(np.deg2rad(2.0))


@dataclass(frozen=True)
class StopFromFlight:
    """Along x, the arms held; speed and acceleration are given beside the position."""

    name: str = "suarez2020/stop"
    doc: str = "a stop from 1 m/s at 2 m/s2 with the long reach: how far the pendulum swings and how long"
    robot: str = LONG_REACH
    world: str = "floor"
    seeds: int = 5
    controllers: Mapping[str, ControllerSpec] = field(
        default_factory=lambda: {"pid": PID, "law": PLATFORM, "lqr": LQR, "mpc": MPC}
    )
    cases: tuple[Case, ...] = (Case("stop", "1 m/s to rest in 0.5 s", END, (STOP, END)),)
    paper: Mapping[str, PaperNumber] = field(
        default_factory=lambda: {
            "swing_ends": PaperNumber(
                2.0, "s", "Installation of sensor device, 1: 'in less than 2 sec'; of what, is not said"
            )
        }
    )

    def reference(self, case: Case, model: Model) -> Reference:
        """Off, along, stop."""
        return resting(model, LEGS)

    def disturbances(self, case: Case, model: Model, seed: int) -> list[Disturbance]:
        """None."""
        return []

    def metrics(self, case: Case, log: Log) -> dict[str, Metric]:
        """Swing after the stop has begun, and in all; times from the end of the stop; the base's overshoot."""
        rows, after = log.window(*case.judged), log.window(STANDS, END)
        angle = swing(log.columns)
        peak = float(np.abs(angle[rows]).max())
        return {
            "swing_peak": Metric(peak, "rad"),
            "swing_peak_start": Metric(float(np.abs(angle[log.window(START, STOP)]).max()), "rad"),
            "swing_ends": Metric(settled(log.time[after], angle[after], 0.1 * peak), "s"),
            "below_2deg": Metric(settled(log.time[after], angle[after], BOUND), "s"),
            "base_overshoot": Metric(float((log["p_WB"] - log["p_WB_r"])[after, 0].max()), "m"),
        }

    def plot(self, runs: Mapping[tuple[str, str], Mapping[str, Array]], folder: Path) -> list[Path]:
        """Swing, speed and distance."""
        figure, axes = panels(3, 1, self.name, width=7.5, height=2.2)
        for colour, ((controller, _), log) in zip(COLOURS, runs.items(), strict=False):
            time = log["time"][:, 0]
            axes[0, 0].plot(time, np.rad2deg(swing(log)), color=colour, label=controller)
            axes[1, 0].plot(time, log["v_WB"][:, 0], color=colour, label=controller)
            axes[2, 0].plot(time, 1e3 * (log["p_WB"] - log["p_WB_r"])[:, 0], color=colour, label=controller)
        for log in list(runs.values())[:1]:
            axes[1, 0].plot(log["time"][:, 0], log["v_WB_r"][:, 0], "k:", label="reference")
        for side in (-1, 1):
            axes[0, 0].axhline(side * np.rad2deg(BOUND), color="k", ls=":", lw=0.8)
        label(axes[0, 0], "swing", "angle in degrees")
        label(axes[1, 0], "speed of the base", "speed in m/s")
        label(axes[2, 0], "base minus reference", "distance in mm")
        return [save(figure, folder / "stop.png")]


EXPERIMENTS = (StopFromFlight(),)
