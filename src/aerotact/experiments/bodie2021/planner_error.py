"""Planner error: a force is wanted, but the surface is not where the plan has it (bodie2021 V-C, Fig. 10).

Beside the paper's three cases, free flight beside a wall: nothing may pass for a contact or a wish for force there.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from aerotact.dynamics.model import Model
from aerotact.experiments.bodie2021.controllers import TABLE_IV, controllers
from aerotact.experiments.bodie2021.disturbed import drawn_machine, wrench_noise
from aerotact.experiments.bodie2021.wall import CALIBRATE, DEPART, WALL, in_front_of_wall
from aerotact.experiments.experiment import Case, ControllerSpec, PaperNumber
from aerotact.experiments.force_profile import ForceProfile, press
from aerotact.experiments.reference import Together, WithFlags
from aerotact.experiments.trajectory import Move, Sampled, rest_to_rest
from aerotact.log import Log
from aerotact.metrics import Metric, push_force, rmse
from aerotact.plant.disturbance import Disturbance
from aerotact.plots import COLOURS, label, panels, save
from aerotact.ports import Array
from aerotact.reference import Reference

FORCE, D_MAX = 5.0, TABLE_IV["C"]["d_max"]  # N, m
RAMPS = press(9.0, 19.0, FORCE)
HOLD = (RAMPS[0].stop, RAMPS[1].start)  # s
END = 22.0  # s
GAPS = {"near": 0.0, "0.25m": 0.25, "0.6m": 0.6}  # m of the set-point in front of the wall
BESIDE = "beside"
# The flight beside the wall: when the tool is there, s; its distance from the wall, across and up from hover, m.
_WAY = ((5.5, 0.25, 0.2, 0.0), (7.0, 0.3, -0.2, 0.1), (8.5, 0.5, 0.0, 0.0))
MISGUIDED = (9.0, 10.5)  # s, a force is wanted although the wall is at the last of these distances, beyond d_max
AWAY = 11.0  # s
ATTEMPT = 1e-3  # confidence from which force control counts as attempted


@dataclass(frozen=True)
class PlannerError:
    """A force of 5 N is wanted at set-points at the wall, within and beyond the distance of force control."""

    name: str = "bodie2021/planner-error"
    doc: str = "V-C, Fig. 10: 5 N wanted with the set-point at the wall, 0.25 m and 0.6 m in front of it"
    robot: str = "tilt_rotor"
    world: str = "wall"
    seeds: int = 5
    controllers: Mapping[str, ControllerSpec] = field(default_factory=lambda: controllers("C"))
    cases: tuple[Case, ...] = (
        Case("near", "set-point on the wall", END, HOLD),
        Case("0.25m", "set-point 0.25 m in front of the wall", END, HOLD),
        Case("0.6m", "set-point 0.6 m in front of the wall", END, HOLD),
        Case(BESIDE, "free flight 0.25 to 0.5 m beside the wall, then a force wanted at 0.5 m", AWAY, (DEPART, AWAY)),
    )
    paper: Mapping[str, PaperNumber] = field(
        default_factory=lambda: {
            "trust_near": PaperNumber(1.0, "1", "Force Tracking Robustness to Planner Error, a): lambda goes to 1"),
            "trust_0.6m": PaperNumber(0.0, "1", "the same, c): 'direct force control is therefore not enabled'"),
        }
    )

    def reference(self, case: Case, model: Model) -> Reference:
        """To the set-point and stay; the force ramps up there, holds, and ramps down. Or along the wall."""
        if case.name == BESIDE:
            return beside_wall(model)
        return Together((in_front_of_wall(model, GAPS[case.name]), ForceProfile(RAMPS)))

    def disturbances(self, case: Case, model: Model, seed: int) -> list[Disturbance]:
        """None in the paper's cases; beside the wall a machine with errors of its own, and wrench noise."""
        return [*drawn_machine(seed), wrench_noise()] if case.name == BESIDE else []

    def metrics(self, case: Case, log: Log) -> dict[str, Metric]:
        """Force control beyond d_max, the largest confidence, and whether the robot is steady and upright."""
        if case.name == BESIDE:
            return _beside_metrics(log)
        trust = confidence(log.columns)
        beyond = (log["surface_distance_est"][:, 0] > D_MAX) & (trust > ATTEMPT)
        held, after = log.window(HOLD[1] - 2.0, HOLD[1]), log.window(END - 1.0, END)
        cosine = np.abs((log["q_WE"] * log["q_WE_d"]).sum(axis=1)).clip(0.0, 1.0)
        return {
            "rows_beyond_d_max": Metric(int(beyond.sum()), "1"),
            f"trust_{case.name}": Metric(float(trust.max()), "1"),
            f"push_{case.name}": Metric(float(push_force(log.columns)[held].mean()), "N"),
            f"speed_{case.name}": Metric(rmse(log["v_WE"][held]), "m/s"),
            f"away_{case.name}": Metric(float(np.linalg.norm((log["p_WE"] - log["p_WE_d"])[held], axis=1).max()), "m"),
            f"back_{case.name}": Metric(rmse((log["p_WE"] - log["p_WE_d"])[after]), "m"),
            f"attitude_{case.name}": Metric(float(2 * np.arccos(cosine).max()), "rad"),
        }

    def plot(self, runs: Mapping[tuple[str, str], Mapping[str, Array]], folder: Path) -> list[Path]:
        """Fig. 10: confidence, distance and wanted force, for each controller and case."""
        labels = list(dict.fromkeys(controller for controller, _ in runs))
        found = [case for case in self.cases if case.name in GAPS and any((name, case.name) in runs for name in labels)]
        if not found:
            return []
        title = f"{self.name}: confidence, distance and wanted force, as in Fig. 10"
        figure, axes = panels(len(labels), len(found), title, width=4.0)
        for row, controller in zip(axes, labels, strict=True):
            for axis, case in zip(row, found, strict=True):
                if (controller, case.name) not in runs:
                    continue
                log = runs[controller, case.name]
                time = log["time"][:, 0]
                what = "lambda" if "confidence_factor" in log else "approaches or pushes"
                axis.plot(time, confidence(log), color=COLOURS[0], label=what)
                axis.plot(time, log["surface_distance"][:, 0], color=COLOURS[1], label="distance, m")
                axis.plot(time, log["f_ref"][:, 0] / 10, "k--", lw=1.0, label="wanted force, 10 N")
                axis.axhline(D_MAX, color="k", ls=":", lw=0.8, label="d_max, m")
                axis.set(xlim=(4.0, END), ylim=(-0.05, 1.45))
                label(axis, f"{controller}: {case.doc}", "lambda, m, 10 N")
                axis.get_legend().remove()
            row[0].legend(loc="upper left", ncols=2)
        return [save(figure, folder / "fig10.png")]


def beside_wall(model: Model) -> Reference:
    """To and fro before the wall without a wish for force, then one out of reach of it."""
    p_WE, q_WE = model.hover_tool
    moves, before = [], DEPART
    for there, gap, across, up in _WAY:
        moves.append(Move(before, there, np.array([WALL - gap, p_WE[1] + across, p_WE[2] + up]), q_WE))
        before = there
    motion = WithFlags(Sampled(rest_to_rest(p_WE, q_WE, moves)), {"calibrate": CALIBRATE})
    return Together((motion, ForceProfile(press(*MISGUIDED, FORCE))))


def _beside_metrics(log: Log) -> dict[str, Metric]:
    """False contacts: rows in which a contact is felt or force control attempted; nearest and furthest distance."""
    rows = log.window(DEPART, AWAY)
    felt = log["contact_est"][rows, 0] if "contact_est" in log else np.zeros(1)
    gap = log["surface_distance"][rows, 0]
    return {
        "false_contacts": Metric(int((felt > 0).sum()), "1"),
        "false_attempts": Metric(int((confidence(log.columns)[rows] > ATTEMPT).sum()), "1"),
        "true_contacts": Metric(int((push_force(log.columns)[rows] > 0).sum()), "1"),
        "nearest": Metric(float(gap.min()), "m"),
        "furthest": Metric(float(gap.max()), "m"),
    }


def confidence(log: Mapping[str, Array]) -> Array:
    """How much force control is attempted, in [0, 1]: lambda of (17), or whether an MPC approaches or pushes."""
    if "confidence_factor" in log:
        return np.asarray(log["confidence_factor"][:, 0])
    return np.maximum(log["approaching"][:, 0], log["pushing"][:, 0])


EXPERIMENTS = (PlannerError(),)
