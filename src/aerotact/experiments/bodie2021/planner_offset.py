"""Planner offset: a set-point 4 cm in front of the wall and one 1 cm behind its face, 5 N (bodie2021 V-B, Fig. 9)."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from aerotact.dynamics.model import Model
from aerotact.experiments.bodie2021.controllers import controllers
from aerotact.experiments.bodie2021.wall import DEPART, in_front_of_wall, measured_push, settling_time
from aerotact.experiments.experiment import Case, ControllerSpec, PaperNumber
from aerotact.experiments.force_profile import ForceProfile, press
from aerotact.experiments.reference import Together
from aerotact.log import Log
from aerotact.metrics import Metric, in_band, push_force
from aerotact.plant.disturbance import Disturbance
from aerotact.plots import COLOURS, label, panels, save
from aerotact.ports import Array
from aerotact.reference import Reference

FORCE = 5.0  # N
RAMPS = press(9.0, 19.0, FORCE)
HOLD = (RAMPS[0].stop, RAMPS[1].start)  # s
END = 20.0  # s
GAPS = {"front4cm": 0.04, "behind1cm": -0.01}  # m in front of the wall
SETTLED = 0.05  # share of the force, of the band in which it counts as settled


@dataclass(frozen=True)
class PlannerOffset:
    """A contact whose set-point is off the surface."""

    name: str = "bodie2021/planner-offset"
    doc: str = "V-B, Fig. 9: 5 N with the set-point 4 cm in front of the wall, and 1 cm behind its face"
    robot: str = "tilt_rotor"
    world: str = "wall"
    seeds: int = 5
    controllers: Mapping[str, ControllerSpec] = field(default_factory=lambda: controllers("B"))
    cases: tuple[Case, ...] = (
        Case("front4cm", "set-point 4 cm in front of the wall", END, HOLD),
        Case("behind1cm", "set-point 1 cm behind its face", END, HOLD),
    )
    paper: Mapping[str, PaperNumber] = field(
        default_factory=lambda: {
            f"settled_{name}": PaperNumber(FORCE, "N", "Direct Force Tracking Accuracy: 'settles at the reference'")
            for name in GAPS
        }
    )

    def reference(self, case: Case, model: Model) -> Reference:
        """To the set-point and stay; the force ramps up there, holds, and ramps down."""
        return Together((in_front_of_wall(model, GAPS[case.name]), ForceProfile(RAMPS)))

    def disturbances(self, case: Case, model: Model, seed: int) -> list[Disturbance]:
        """None."""
        return []

    def metrics(self, case: Case, log: Log) -> dict[str, Metric]:
        """Peak until the force is held, settled force, and when the force in the band came within 5 % for good."""
        force = push_force(log.columns)
        peak = force[log.window(DEPART, HOLD[0] + 3.0)].max()
        banded = in_band(force, log.period)
        settles = settling_time(log.time, banded, (RAMPS[0].start, HOLD[1]), FORCE, SETTLED * FORCE)
        return {
            f"impact_peak_{case.name}": Metric(float(peak), "N"),
            f"settled_{case.name}": Metric(float(force[log.window(HOLD[1] - 1.0, HOLD[1])].mean()), "N"),
            f"settles_{case.name}": Metric(None if np.isnan(settles) else settles, "s"),
        }

    def plot(self, runs: Mapping[tuple[str, str], Mapping[str, Array]], folder: Path) -> list[Path]:
        """Fig. 9 for each controller."""
        labels = list(dict.fromkeys(controller for controller, _ in runs))
        found = [case for case in self.cases if any((name, case.name) in runs for name in labels)]
        figure, axes = panels(
            len(labels), len(found), f"{self.name}: force and its components along the tool, as in Fig. 9", width=5.0
        )
        for row, controller in zip(axes, labels, strict=True):
            for axis, case in zip(row, found, strict=True):
                if (controller, case.name) in runs:
                    _components(axis, runs[controller, case.name])
                    label(axis, f"{controller}: {case.doc}", "force in N")
                    axis.get_legend().remove()
        handles = {h.get_label(): h for axis in axes.flat for h in axis.get_lines()}
        figure.legend(handles=list(handles.values()), loc="outside lower center", ncols=5)
        return [save(figure, folder / "fig9.png")]


def _components(axis: object, log: Mapping[str, Array]) -> None:
    """Measured force, and where the controller has them the direct and the impedance part of its command."""
    time = log["time"][:, 0]
    curves = [("true", push_force(log), "0.75", "-"), ("measured", measured_push(log), "k", "-")]
    if "f_dir_B" in log:
        curves += [
            ("direct force control", log["f_dir_B"][:, 0], COLOURS[0], "-"),
            ("impedance control", log["f_imp_B"][:, 0], COLOURS[1], "-"),
        ]
    for name, values, colour, style in curves:
        axis.plot(time, values, color=colour, ls=style, label=name, lw=0.8 if name == "true" else 1.3)  # type: ignore[attr-defined]
    axis.plot(time, log["f_ref"][:, 0], "k--", lw=1.0, label="wanted")  # type: ignore[attr-defined]
    axis.set(xlim=(6.0, END), ylim=(-7.0, 15.0))  # type: ignore[attr-defined]


EXPERIMENTS = (PlannerOffset(),)
