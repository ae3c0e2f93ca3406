"""Bimanual tasks on a bench: a bar into a hole, a plug out of its socket (V-E, Fig. 18)."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from aerotact.dynamics.model import Model
from aerotact.experiments.experiment import Case, ControllerSpec, PaperNumber
from aerotact.experiments.suarez2020.flight_plan import STANDARD
from aerotact.experiments.suarez2020.schedule import Schedule
from aerotact.laws.suarez2020.bench_arms import suarez2020_arms
from aerotact.laws.suarez2020.bimanual import bar_goals
from aerotact.log import Log
from aerotact.metrics import Metric, rmse
from aerotact.plant.clamp import Clamp
from aerotact.plant.disturbance import Disturbance
from aerotact.plant.grip import Grip
from aerotact.plant.placement import Placement
from aerotact.plant.plug import Plug
from aerotact.plots import COLOURS, label, panels, save
from aerotact.ports import Array
from aerotact.reference import Reference

LAW, RATE = "suarez2020_arms", 200.0
ROLL = 0.6  # rad, of the shoulders, so that the forearms can push and pull sideways
INWARDS = np.array([0.05, 0.0, -0.37])  # m, tools in frame i for that
PLUGGED, WATCHED, PULL, PULLED = 3.0, 3.5, 2.5, (4.0, 9.0)  # s, s, N, s: the pull grows over that time
HOLD = (1.0, 2.0)  # N, at which the plug comes loose
THRESHOLD = 0.008  # m, of (33)
BAR, GRIP = np.array([0.25, 0.0, 1.55]), 0.30  # m, where the bar begins, and from hand to hand
BAR_MASS = 0.10  # kg
HOLE = np.array([0.27, 0.34, 1.50])  # m, the hole's middle; it is 10 cm deep
ALIGNED, INSERTED, DEPTH = (2.0, 4.0), (5.0, 8.0), 0.10  # s, s: the bar is aligned, then moved along y by so much


@dataclass(frozen=True)
class Bimanual:
    """Two tasks of two arms with the base held."""

    name: str = "suarez2020/bimanual"
    doc: str = "V-E, Fig. 18: bar insertion and un-plugging by lateral force, on a bench"
    robot: str = STANDARD
    world: str = "handled"
    seeds: int = 20
    controllers: Mapping[str, ControllerSpec] = field(
        default_factory=lambda: {
            "law": ControllerSpec(LAW, RATE, "(29)-(33) at the encoders' rate", {"threshold": THRESHOLD})
        }
    )
    cases: tuple[Case, ...] = (
        Case("unplug", "pulled apart by up to 2.5 N, loose at 1 to 2 N", 9.0, PULLED),
        Case("bar", "a bar in both hands, 5 mm of room in the hole on each side", 10.0, (8.5, 10.0)),
    )
    paper: Mapping[str, PaperNumber] = field(default_factory=dict)

    def reference(self, case: Case, model: Model) -> Reference:
        """Goals in frame i, or of the bar in W."""
        rest = suarez2020_arms(model, RATE).reference
        if case.name == "bar":
            known = {f"in_W_{arm}": [(0.0, 1.0)] for arm in SIDES}
            known |= {f"load_{arm}": [(0.0, BAR_MASS / 2)] for arm in SIDES}
            return Schedule(rest, known, _bar_ways())
        out = np.array([0.0, 0.05, 0.0])
        ways = {"left": [(0.0, INWARDS + out)], "right": [(0.0, (INWARDS + out) * MIRROR)]}
        for arm, mirror in (("left", np.ones(3)), ("right", MIRROR)):
            ways[arm] += [(1.5, ways[arm][0][1]), (2.5, INWARDS * mirror)]
        ramps = {f"r_{arm}_d": way for arm, way in ways.items()}
        steps = {f"roll_{arm}": [(0.0, ROLL)] for arm in SIDES}
        steps["grasped"] = [(WATCHED, 1.0)]
        return Schedule(rest, steps, ramps | {"f_grasp": [(PULLED[0], 0.0), (PULLED[1], -PULL)]})

    def disturbances(self, case: Case, model: Model, seed: int) -> list[Disturbance]:
        """The bench and what the arms handle."""
        if case.name == "unplug":
            return [Clamp(), Plug(PLUGGED, HOLD)]
        hands = [Grip(arm, "bar", (0.0, side * GRIP / 2, 0.0)) for arm, side in enumerate((1.0, -1.0))]
        return [Clamp(), *hands, Placement("bar", _triple(BAR)), Placement("hole", _triple(HOLE))]

    def metrics(self, case: Case, log: Log) -> dict[str, Metric]:
        """What the task was for."""
        rows = log.window(*case.judged)
        if case.name == "unplug":
            return _unplugged(log)
        bar = log["objects_W"]
        wanted = 0.5 * (log["p_left_d"] + log["p_right_d"])
        told = 0.5 * (log["p_left_W"] + log["p_right_W"])
        end = bar[-1, 1] + 0.25
        return {
            "bar_centre_error": Metric(rmse((bar[:, :3] - wanted)[rows]), "m"),
            "bar_estimate_error": Metric(rmse((bar[:, :3] - told)[rows]), "m"),
            "bar_in_hole": Metric(float(end - (HOLE[1] - 0.05)), "m"),
        }

    def plot(self, runs: Mapping[tuple[str, str], Mapping[str, Array]], folder: Path) -> list[Path]:
        """Forces and places."""
        figure, axes = panels(1, 2, f"{self.name}: on a bench", width=4.8)
        for (_, case), log in runs.items():
            time = log["time"][:, 0]
            if case == "unplug":
                axis = axes[0, 0]
                axis.plot(time, np.linalg.norm(log["f_tools_W"][:, :3], axis=1), color=COLOURS[0], label="pull, N")
                axis.plot(time, log["disconnected_left"][:, 0], color=COLOURS[1], label="told to be loose")
                axis.plot(time, -log["f_grasp"][:, 0], "k--", lw=1.0, label="reference, N")
                axis.set_xlim(3.0, 9.0)
                label(axis, "un-plugging", "force in N")
            else:
                axis = axes[0, 1]
                for index, colour in zip(range(3), COLOURS, strict=False):
                    wanted = 0.5 * (log["p_left_d"] + log["p_right_d"])[:, index]
                    axis.plot(time, 1e3 * (log["objects_W"][:, index] - wanted), color=colour, label="xyz"[index])
                axis.set_ylim(-20, 20)
                label(axis, "bar: centre minus its goal", "error in mm")
        return [save(figure, folder / "bimanual.png")]


SIDES = ("left", "right")
MIRROR = np.array([1.0, -1.0, 1.0])


def _bar_ways() -> dict[str, list[tuple[float, Array]]]:
    """Goals of both hands in W: the bar is aligned with the hole, then moved into it."""
    aligned = np.array([HOLE[0], 0.0, HOLE[2]])
    inside = aligned + np.array([0.0, DEPTH, 0.0])
    way = [(ALIGNED[0], BAR), (ALIGNED[1], aligned), (INSERTED[0], aligned), (INSERTED[1], inside)]
    hands = [(time, bar_goals(centre, np.array([0.0, 1.0, 0.0]), GRIP)) for time, centre in way]
    return {f"p_{arm}_d": [(time, both[i]) for time, both in hands] for i, arm in enumerate(SIDES)}


def _triple(vector: Array) -> tuple[float, float, float]:
    x, y, z = (float(v) for v in vector)
    return x, y, z


def _unplugged(log: Log) -> dict[str, Metric]:
    """When the plug came loose, how long until that was told, and whether it was told before."""
    pull = np.linalg.norm(log["f_tools_W"][:, :3], axis=1)
    told = np.flatnonzero(log["disconnected_left"][:, 0] > 0.5)
    loose = int(np.flatnonzero(pull > 0)[-1]) + 1
    early = bool(told.size and told[0] < loose)
    late = float((told[0] - loose) * log.period) if told.size and not early else None
    watched = log.window(WATCHED, log.time[min(loose, len(log.time) - 1)])
    apparent = np.linalg.norm(log["p_left_W"][watched] - log["p_left_W"][watched][:1], axis=1)
    return {
        "unplug_delay": Metric(late, "s"),
        "unplug_within_50ms": Metric(float(late is not None and late <= 0.05), "1"),
        "false_alarm": Metric(float(early), "1"),
        "unplug_pull": Metric(float(pull[loose - 1]), "N"),
        "apparent_motion": Metric(float(apparent.max()), "m"),
    }


EXPERIMENTS = (Bimanual(),)
