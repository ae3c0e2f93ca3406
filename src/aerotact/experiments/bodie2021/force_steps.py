"""Force steps: 5, 10 and 20 N on a rigid wall (bodie2021 V-B, Fig. 8)."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

from aerotact.dynamics.model import Model
from aerotact.experiments.bodie2021.controllers import controllers
from aerotact.experiments.bodie2021.wall import (
    ARRIVE,
    ForceSteps,
    in_front_of_wall,
    measured_push,
    observed_push,
    step_response,
)
from aerotact.experiments.experiment import Case, ControllerSpec, PaperNumber
from aerotact.experiments.reference import Together
from aerotact.log import Log
from aerotact.metrics import Metric, push_force
from aerotact.plant.disturbance import Disturbance
from aerotact.plots import COLOURS, label, panels, save
from aerotact.ports import Array
from aerotact.reference import Reference

STEPS = ((9.0, 5.0), (14.0, 10.0), (19.0, 20.0), (24.0, 5.0))  # s and N
END = 29.0  # s
JUDGED_STEPS = {
    f"{a[1]:g}to{b[1]:g}": (a, b, stop)
    for (a, b), stop in zip(pairwise(STEPS), (*(s for s, _ in STEPS[2:]), END), strict=True)
}
"""Name -> start and force of the level before, of the level after, and when that ends."""


@dataclass(frozen=True)
class ForceStepsOnWall:
    """The set-point on the wall, its tool at right angles to it; the wanted force jumps."""

    name: str = "bodie2021/force-steps"
    doc: str = "V-B, Fig. 8: 5, 10 and 20 N on a rigid wall, the wanted force jumping"
    robot: str = "tilt_rotor"
    world: str = "wall"
    seeds: int = 5
    controllers: Mapping[str, ControllerSpec] = field(default_factory=lambda: controllers("B"))
    cases: tuple[Case, ...] = (Case("steps", "5, 10, 20, 5 N, each for 5 s", END, (STEPS[1][0], END)),)
    paper: Mapping[str, PaperNumber] = field(
        default_factory=lambda: {
            f"settled_{force:g}": PaperNumber(force, "N", "Direct Force Tracking Accuracy: 'tracked consistently'")
            for _, force in STEPS[:3]
        }
    )

    def reference(self, case: Case, model: Model) -> Reference:
        """To the wall and stay; force from then on."""
        return Together((in_front_of_wall(model, 0.0), ForceSteps(STEPS)))

    def disturbances(self, case: Case, model: Model, seed: int) -> list[Disturbance]:
        """None."""
        return []

    def metrics(self, case: Case, log: Log) -> dict[str, Metric]:
        """Each step's rise, overshoot and settled force, from the true force; the peak at touch-down."""
        time, force = log.time, push_force(log.columns)
        touch = step_response(time, force, (STEPS[0][0], STEPS[1][0]), (0.0, STEPS[0][1]))
        first = log.window(ARRIVE - 2.0, STEPS[1][0])
        found = {
            "touch_peak": Metric(float(force[first].max()), "N"),
            f"settled_{STEPS[0][1]:g}": Metric(touch.settled, "N"),
        }
        for name, (before, after, stop) in JUDGED_STEPS.items():
            response = step_response(time, force, (after[0], stop), (before[1], after[1]))
            key = f"settled_{after[1]:g}" if after[1] > before[1] else f"settled_{name}"
            found[key] = Metric(response.settled, "N")
            found[f"t90_{name}"] = Metric(response.rise, "s")
            found[f"overshoot_{name}"] = Metric(response.overshoot, "1")
            found[f"peak_{name}"] = Metric(float(force[log.window(after[0], stop)].max()), "N")
        return found

    def plot(self, runs: Mapping[tuple[str, str], Mapping[str, Array]], folder: Path) -> list[Path]:
        """Fig. 8 for each controller, and the steps close up for all of them."""
        return [_figure_8(self, runs, folder), _close_up(self, runs, folder)]


def _figure_8(experiment: ForceStepsOnWall, runs: Mapping[tuple[str, str], Mapping[str, Array]], folder: Path) -> Path:
    figure, axes = panels(len(runs), 1, f"{experiment.name}: force on the wall, as in Fig. 8", width=7.5)
    for axis, ((controller, _), log) in zip(axes[:, 0], runs.items(), strict=True):
        time = log["time"][:, 0]
        axis.plot(time, push_force(log), color="0.75", lw=0.8, label="true")
        axis.plot(time, measured_push(log), color=COLOURS[0], label="measured")
        observed = observed_push(log)
        if observed is not None:
            axis.plot(time, observed, color=COLOURS[1], ls=":", label="momentum observer")
        axis.plot(time, log["f_ref"][:, 0], "k--", lw=1.0, label="wanted")
        axis.set(xlim=(ARRIVE - 1, END), ylim=(-3, 28))
        label(axis, controller, "force in N")
        axis.legend(loc="upper left", ncols=4)
    return save(figure, folder / "fig8.png")


def _close_up(experiment: ForceStepsOnWall, runs: Mapping[tuple[str, str], Mapping[str, Array]], folder: Path) -> Path:
    figure, axes = panels(1, len(JUDGED_STEPS), f"{experiment.name}: true force at the steps", width=3.6, height=2.8)
    for axis, (name, (before, after, _)) in zip(axes[0], JUDGED_STEPS.items(), strict=True):
        for colour, ((controller, _), log) in zip(COLOURS, runs.items(), strict=False):
            axis.plot(log["time"][:, 0] - after[0], push_force(log), color=colour, label=controller)
        axis.plot([-0.2, 0, 0, 1], [before[1], before[1], after[1], after[1]], "k--", lw=1.0, label="wanted")
        height = abs(after[1] - before[1])
        low, high = sorted((before[1], after[1]))
        axis.set(xlim=(-0.1, 0.9), ylim=(low - 0.3 * height, high + 0.4 * height))
        label(axis, name.replace("to", " to ") + " N", "force in N", "time from the step in s")
        if name != next(iter(JUDGED_STEPS)):
            axis.get_legend().remove()
    axes[0, 0].get_legend().set_loc("lower right")
    return save(figure, folder / "steps.png")


EXPERIMENTS = (ForceStepsOnWall(),)
