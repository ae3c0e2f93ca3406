"""Swing release: the pendulum is let go at ten degrees (suarez2020 VI-B: 'attenuated rapidly, in less than 2 sec')."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from aerotact.dynamics.model import Model
from aerotact.experiments.experiment import Case, ControllerSpec, PaperNumber
from aerotact.experiments.suarez2020.controllers import ATTITUDE_HOLD, LQR, MPC, PID, PLATFORM
from aerotact.experiments.suarez2020.flight_plan import LONG_REACH, resting, with_arms
from aerotact.experiments.suarez2020.pendulum import settled, swing
from aerotact.log import Log
from aerotact.metrics import Metric
from aerotact.plant.displaced import Displaced
from aerotact.plant.disturbance import Disturbance
from aerotact.plots import COLOURS, label, panels, save
from aerotact.ports import Array
from aerotact.reference import Reference

RELEASED = float(np.deg2rad(10.0))
END = 8.0  # s


@dataclass(frozen=True)
class SwingRelease:
    """At rest, the base level and in its place; the pendulum stands off and is let go at once."""

    name: str = "suarez2020/swing-release"
    doc: str = "the pendulum let go at 10 degrees: how soon its swing is below 20 and 10 % of that"
    robot: str = LONG_REACH
    world: str = "floor"
    seeds: int = 5
    controllers: Mapping[str, ControllerSpec] = field(
        default_factory=lambda: {"attitude-hold": ATTITUDE_HOLD, "pid": PID, "law": PLATFORM, "lqr": LQR, "mpc": MPC}
    )
    cases: tuple[Case, ...] = (
        Case("backward", "let go 10 degrees behind", END, (0.0, END)),
        Case("forward", "let go 10 degrees ahead", END, (0.0, END)),
    )
    paper: Mapping[str, PaperNumber] = field(
        default_factory=lambda: {
            "below_10": PaperNumber(
                2.0, "s", "Installation of sensor device, 1: 'in less than 2 sec'; of what, is not said"
            )
        }
    )

    def reference(self, case: Case, model: Model) -> Reference:
        """Stay."""
        return resting(model)

    def disturbances(self, case: Case, model: Model, seed: int) -> list[Disturbance]:
        """The pendulum's start."""
        return [Displaced(with_arms(model).bodies.joints[0], _start(case))]

    def metrics(self, case: Case, log: Log) -> dict[str, Metric]:
        """Times after which the swing stays below a share of its start; how far the base is drawn along."""
        angle = swing(log.columns, _start(case))
        moved = np.linalg.norm(log["p_WB"] - log["p_WB_r"], axis=1)
        found = {f"below_{share}": settled(log.time, angle, share / 100 * RELEASED) for share in (20, 10, 5)}
        return {
            **{name: Metric(value, "s") for name, value in found.items()},
            "base_moved": Metric(float(moved.max()), "m"),
            "swing_left": Metric(float(np.abs(angle[log.window(END - 2.0, END)]).max()), "rad"),
        }

    def plot(self, runs: Mapping[tuple[str, str], Mapping[str, Array]], folder: Path) -> list[Path]:
        """Swing and base."""
        cases = [c for c in self.cases if any(case == c.name for _, case in runs)]
        figure, axes = panels(2, len(cases), self.name, width=5.0)
        for column, case in enumerate(cases):
            flown = [(controller, log) for (controller, name), log in runs.items() if name == case.name]
            for colour, (controller, log) in zip(COLOURS, flown, strict=False):
                time = log["time"][:, 0]
                axes[0, column].plot(time, np.rad2deg(swing(log, _start(case))), color=colour, label=controller)
                axes[1, column].plot(time, 1e3 * (log["p_WB"] - log["p_WB_r"])[:, 0], color=colour, label=controller)
            for side in (-1, 1):
                axes[0, column].axhline(side * np.rad2deg(0.1 * RELEASED), color="k", ls=":", lw=0.8)
            label(axes[0, column], f"{case.doc}: swing", "angle in degrees")
            label(axes[1, column], "base minus reference, along x", "distance in mm")
        return [save(figure, folder / "swing.png")]


def _start(case: Case) -> float:
    """A positive angle swings the arms backwards."""
    return RELEASED if case.name == "backward" else -RELEASED


EXPERIMENTS = (SwingRelease(),)
