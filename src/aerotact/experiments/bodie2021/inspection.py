"""Inspection: nine points 5 cm apart on a block of concrete, each held with 5 N for 10 s (bodie2021 V-E, Fig. 13).

The potentials that the paper's probe measures are not modelled; what a flight owes the probe is: a steady force, in one
place. The paper knows where its block is. Here the planner has it from one look with the depth camera.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from aerotact.dynamics.model import Model
from aerotact.experiments.bodie2021.contact_series import Contact, ContactSeries, judge
from aerotact.experiments.bodie2021.controllers import controllers
from aerotact.experiments.bodie2021.disturbed import drawn_machine
from aerotact.experiments.contact_pose import ContactPose, contact_attitude, contact_pose
from aerotact.experiments.experiment import Case, ControllerSpec, PaperNumber
from aerotact.experiments.survey import survey
from aerotact.log import Log
from aerotact.metrics import Metric, in_band, push_force, rmse
from aerotact.plant.disturbance import Disturbance
from aerotact.plots import COLOURS, label, panels, save
from aerotact.ports import Array
from aerotact.reference import Reference

WORLD = "concrete_block"
POINTS, SPACING = 9, 0.05  # m
FORCE, DURATION = 5.0, 10.0  # N, s
FLIGHTS = 3  # the points are shared out to as many flights, which can be flown side by side
SERIES = ContactSeries(POINTS // FLIGHTS, FORCE, DURATION, transfer=2.0, stand_off=0.15)
JUDGED = 7.0  # s, before the force ramps down: all but the first second of the full force


def points(robot: str) -> list[ContactPose]:
    """The nine contacts, in a level row about the point ahead of the hovering tool, from -y to +y."""
    plane = survey(robot, WORLD)
    level_W = contact_attitude(plane.n_W)[:, 1]
    steps = SPACING * (np.arange(POINTS) - (POINTS - 1) / 2)
    return [contact_pose(plane.p_W + step * level_W, plane.n_W) for step in steps]


@dataclass(frozen=True)
class Inspection:
    """Three points a flight, three flights."""

    name: str = "bodie2021/inspection"
    doc: str = "V-E, Fig. 13: nine points 5 cm apart on a block of concrete, 5 N for 10 s each"
    robot: str = "tilt_rotor"
    world: str = WORLD
    seeds: int = 5
    controllers: Mapping[str, ControllerSpec] = field(default_factory=lambda: controllers("E"))
    cases: tuple[Case, ...] = tuple(
        Case(
            f"points{SERIES.count * i + 1}to{SERIES.count * (i + 1)}",
            f"{SERIES.count} of {POINTS} points",
            SERIES.end,
            (SERIES.pressed(0)[0], SERIES.end),
        )
        for i in range(FLIGHTS)
    )
    paper: Mapping[str, PaperNumber] = field(
        default_factory=lambda: {
            "held": PaperNumber(1.0, "1", "V-E: 'able to hold contact between the end-effector and the sample'"),
            "force_mean": PaperNumber(FORCE, "N", "V-E: 'a reference force of 5 N is requested'"),
        }
    )

    def reference(self, case: Case, model: Model) -> Reference:
        """To three of the points, one after the other."""
        first = SERIES.count * self.cases.index(case)
        return SERIES.reference(model.hover_tool, points(self.robot)[first : first + SERIES.count])

    def disturbances(self, case: Case, model: Model, seed: int) -> list[Disturbance]:
        """A machine with errors of its own."""
        return drawn_machine(seed)

    def metrics(self, case: Case, log: Log) -> dict[str, Metric]:
        """Over the points of a flight: share that was held; force; how far from its mean place the tip strays."""
        found = [judge(log.columns, SERIES, number, JUDGED) for number in range(SERIES.count)]
        true, band = (np.concatenate([getattr(c, name) for c in found]) for name in ("force", "band"))
        return {
            "held": Metric(float(np.mean([c.held for c in found])), "1"),
            "force_mean": Metric(float(true.mean()), "N"),
            "force_true": Metric(rmse(true - FORCE), "N"),
            "force_band": Metric(rmse(band - FORCE), "N"),
            "spread": Metric(float(np.mean([spread(c) for c in found])), "m"),
            "off_point": Metric(rmse(np.concatenate([c.across for c in found])), "m"),
            "attitude_max": Metric(float(max(c.attitude.max() for c in found)), "rad"),
            "contact_peak": Metric(float(max(c.peak for c in found)), "N"),
        }

    def plot(self, runs: Mapping[tuple[str, str], Mapping[str, Array]], folder: Path) -> list[Path]:
        """What the probe gets at each of the points, beside each other as in Fig. 13, and the forces over time."""
        labels = list(dict.fromkeys(controller for controller, _ in runs))
        return [_by_point(self, runs, labels, folder), _over_time(self, runs, labels, folder)]


def spread(contact: Contact) -> float:
    """Standard deviation of the tip's place on the surface while it is held, m."""
    return float(np.linalg.norm(contact.across.std(axis=0)))


def _by_point(
    experiment: Inspection, runs: Mapping[tuple[str, str], Mapping[str, Array]], labels: list[str], folder: Path
) -> Path:
    title = f"{experiment.name}: at the nine points, the last {JUDGED:g} s of the full force"
    figure, axes = panels(1, 3, title, width=4.4, height=3.0)
    for colour, (shift, controller) in zip(COLOURS, enumerate(labels), strict=False):
        rows = []
        for i, case in enumerate(experiment.cases):
            if (controller, case.name) in runs:
                log = runs[controller, case.name]
                rows += [(SERIES.count * i + n, judge(log, SERIES, n, JUDGED)) for n in range(SERIES.count)]
        places = np.array([100 * SPACING * (number + 0.12 * (shift - 1)) for number, _ in rows])
        force = np.array([(c.band.mean(), c.band.std()) for _, c in rows])
        style = {"color": colour, "ls": "none", "marker": "o", "ms": 4, "label": controller}
        axes[0, 0].errorbar(places, force[:, 0], force[:, 1], capsize=2, **style)
        axes[0, 1].plot(places, [1e3 * spread(c) for _, c in rows], **style)
        axes[0, 2].plot(places, [1e3 * np.linalg.norm(c.across.mean(axis=0)) for _, c in rows], **style)
    axes[0, 0].axhline(FORCE, color="k", ls="--", lw=1.0)
    label(axes[0, 0], "force behind 5 Hz, mean and deviation", "force in N", "place along the block in cm")
    label(axes[0, 1], "deviation of the tip's place", "mm", "place along the block in cm")
    label(axes[0, 2], "distance of its mean from the point wanted", "mm", "place along the block in cm")
    for axis in axes[0, 1:]:
        axis.set_ylim(0.0, 1.15 * axis.get_ylim()[1])
        axis.get_legend().remove()
    return save(figure, folder / "points.png")


def _over_time(
    experiment: Inspection, runs: Mapping[tuple[str, str], Mapping[str, Array]], labels: list[str], folder: Path
) -> Path:
    figure, axes = panels(len(labels), 1, f"{experiment.name}: force behind 5 Hz at each point", width=7.5)
    for axis, controller in zip(axes[:, 0], labels, strict=True):
        for case in experiment.cases:
            if (controller, case.name) not in runs:
                continue
            log = runs[controller, case.name]
            time, force = log["time"][:, 0], in_band(push_force(log), float(log["time"][1, 0] - log["time"][0, 0]))
            for number in range(SERIES.count):
                start, stop = SERIES.pressed(number)
                rows = (time >= start - 1.0) & (time < stop + 1.0)
                axis.plot(time[rows] - start, force[rows], color=COLOURS[labels.index(controller)], lw=0.8, alpha=0.7)
        rows = (time >= SERIES.pressed(0)[0] - 1.0) & (time < SERIES.pressed(0)[1] + 1.0)
        axis.plot(time[rows] - SERIES.pressed(0)[0], log["f_ref"][rows, 0], "k--", lw=1.0, label="wanted")
        axis.set(xlim=(-1.0, DURATION + 1.0), ylim=(-1.0, 3.2 * FORCE))
        label(axis, controller, "force in N", "time from the first command of force in s")
    return save(figure, folder / "force.png")


EXPERIMENTS = (Inspection(),)
