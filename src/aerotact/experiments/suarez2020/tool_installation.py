"""Tool installation with the standard configuration: a tool hooked by its bar, put on a pipe and back (VI-A)."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from aerotact.dynamics.model import Model
from aerotact.experiments.experiment import Case, ControllerSpec, PaperNumber
from aerotact.experiments.suarez2020.controllers import MPC, PLATFORM
from aerotact.experiments.suarez2020.flight_plan import STANDARD, with_arms
from aerotact.experiments.suarez2020.mission import ArmTask, Mission, Phase, Scene, Steering, Vector
from aerotact.log import Log
from aerotact.metrics import Metric, rmse
from aerotact.plant.disturbance import Disturbance
from aerotact.plant.hook import Hook
from aerotact.plant.placement import Placement
from aerotact.plots import COLOURS, label, panels, save
from aerotact.ports import Array
from aerotact.reference import Reference

BENCH, PIPE = np.array([1.2, -0.8, 1.0]), np.array([1.2, 0.8, 1.1])
"""Points of the axes on which the tool sits, m; world `pipe_and_bench`."""
BAR, HALF, GRASP = (0.0, 0.0, 0.25), 0.225, 0.15
"""The bar's middle in the tool's frame, half its length, and where the hooks take it to both sides, m."""
FLOOR = 0.016  # m from a hook's point up to the axis of the bar that it carries
MASS = 0.30  # kg, of the tool
UNDER = 0.065  # m below the bar on the way in and out
LIFT, RISE = 0.05, 0.12  # m that the arms and then the platform lift the tool
SEATED = 0.02  # m from its seat at which the tool counts as seated
LIFTED: Vector = (0.30, 0.0, -0.16)
READY: Vector = (0.24, 0.0, -0.32)
REACH, DROP = 0.28, 0.45  # m from the shoulders to the bar, ahead, and from the base down to the hooks
SIDES = {"left": 1.0, "right": -1.0}


def bar_end(scene: Scene, side: float) -> Array:
    """Where a hook is to take the bar, as it lies now, m in W."""
    return scene.p_W + Rotation.from_quat(scene.q_W, scalar_first=True).apply([0.0, side * GRASP, BAR[2]])


def below(side: float, depth: float, behind: float = 0.0) -> Steering:
    """To a point `depth` below the bar as it lies and `behind` it."""
    return lambda scene: bar_end(scene, side) - [behind, 0.0, depth]


def carried(side: float, goal: Array) -> Steering:
    """So that the bar's end comes to where it belongs with the tool's origin at `goal`."""
    end = goal + np.array([0.0, side * GRASP, BAR[2]])
    return lambda scene: scene.tools_W[_name(side)] + (end - bar_end(scene, side))


def with_base(side: float, offset: Vector) -> Steering:
    """The same with the goal fixed to the platform."""
    return lambda scene: carried(side, scene.p_WB + offset)(scene)


def _name(side: float) -> str:
    return next(name for name, value in SIDES.items() if value == side)


def _steered(make: Callable[[float], Steering], load: float) -> dict[str, ArmTask]:
    return {name: ArmTask(r=READY, steer=make(side), load=load) for name, side in SIDES.items()}


def _still(r: Vector) -> dict[str, ArmTask]:
    return {name: ArmTask(r=r) for name in SIDES}


def before(seat: Array, up: float = 0.0) -> Vector:
    """Where the platform hovers to work on a seat, m."""
    x, y, z = (float(v) for v in seat + np.array([-REACH, 0.0, BAR[2] - FLOOR + DROP + up]))
    return x, y, z


def _hooks_at(depth: float, behind: float = 0.0) -> Callable[[Scene], bool]:
    """Both hooks are within 2 cm of where they should be."""

    def there(scene: Scene) -> bool:
        gaps = [below(side, depth, behind)(scene) - scene.tools_W[name] for name, side in SIDES.items()]
        return max(float(np.linalg.norm(gap)) for gap in gaps) < 0.02

    return there


def take(number: int, seat: Array) -> list[Phase]:
    """Hooks under the bar, up with it, and the platform up."""
    lift = np.array([0.0, 0.0, LIFT])
    held = tuple(seat + lift - before(seat))
    return [
        Phase(number, "hooks below the bar", 3.0, _steered(lambda s: below(s, UNDER), 0.0), until=_hooks_at(UNDER)),
        Phase(
            number,
            "lift",
            4.0,
            _steered(lambda s: carried(s, seat + lift), MASS / 2),
            until=lambda scene: bool(scene.p_W[2] > seat[2] + 0.8 * LIFT),
        ),
        Phase(number, "up", 4.0, _steered(lambda s: with_base(s, held), MASS / 2), before(seat, RISE), 3.0),
    ]


def put(number: int, seat: Array) -> list[Phase]:
    """The platform down, the tool onto its seat, the hooks down and out."""
    lift = np.array([0.0, 0.0, LIFT])
    held = tuple(seat + lift - before(seat))
    return [
        Phase(number, "down", 6.0, _steered(lambda s: with_base(s, held), MASS / 2), before(seat), 4.0),
        Phase(
            number,
            "onto the seat",
            3.0,
            _steered(lambda s: carried(s, seat - [0.0, 0.0, 0.015]), MASS / 2),
            until=lambda scene: bool(np.linalg.norm(scene.p_W - seat) < SEATED),
        ),
        Phase(number, "unload", 4.0, _steered(lambda s: below(s, FLOOR + 0.02), 0.0)),
        Phase(number, "hooks below the bar", 3.0, _steered(lambda s: below(s, UNDER), 0.0), until=_hooks_at(UNDER)),
        Phase(number, "hooks out", 4.0, _steered(lambda s: below(s, UNDER, 0.07), 0.0)),
    ]


def installation(model: Model) -> Mission:
    """The twelve phases; take-off and landing, left to a pilot, are a rise and a descent."""
    arms = with_arms(model)
    start = np.array(arms.hover_state[:3])
    landed = (float(start[0]), float(start[1]), float(start[2]) - 0.4)
    home = (float(start[0]), float(start[1]), float(start[2]))
    way = before(BENCH, RISE)
    held = tuple(BENCH + np.array([0.0, 0.0, LIFT]) - before(BENCH))
    carry = _steered(lambda s: with_base(s, held), MASS / 2)
    return Mission(
        arms,
        (
            Phase(1, "take-off", 3.0, _still(LIFTED), home),
            Phase(2, "to the tool bench", 7.0, _still(READY), (way[0] - 0.4, way[1], way[2]), 6.0),
            Phase(2, "approach", 4.0, _still(READY), before(BENCH), 3.0),
            *take(3, BENCH),
            Phase(4, "to the workspace", 9.0, carry, before(PIPE, RISE + 0.1), 8.0),
            Phase(5, "approach slowly", 4.0, carry, before(PIPE, RISE), 3.0),
            *put(6, PIPE),
            Phase(7, "inspection", 5.0, _steered(lambda s: below(s, UNDER, 0.07), 0.0)),
            *take(8, PIPE),
            Phase(9, "back to the tool bench", 9.0, carry, before(BENCH, RISE), 8.0),
            *put(10, BENCH),
            Phase(11, "away", 4.0, _still(READY), (way[0] - 0.4, way[1], way[2]), 3.0),
            Phase(11, "to the landing point", 6.0, _still(READY), home, 5.0),
            Phase(12, "arms up", 2.0, _still(LIFTED)),
            Phase(12, "land", 4.0, _still(LIFTED), landed, 3.0),
        ),
    )


END = 125.0
LAW = ControllerSpec(
    "suarez2020_tools", PLATFORM.rate, "velocity control (24) under a scripted operator", inner=PLATFORM
)


@dataclass(frozen=True)
class ToolInstallation:
    """The tool goes from a bench onto a pipe and back."""

    name: str = "suarez2020/tool-installation"
    doc: str = "VI-A, Figs. 19-21, 25: twelve phases, a tool hooked by its bar, put on a pipe and brought back"
    robot: str = STANDARD
    world: str = "pipe_and_bench"
    seeds: int = 10
    controllers: Mapping[str, ControllerSpec] = field(default_factory=lambda: {"law": LAW, "mpc": MPC})
    cases: tuple[Case, ...] = (Case("mission", "all twelve phases", END, (0.0, END)),)
    paper: Mapping[str, PaperNumber] = field(default_factory=dict)

    def reference(self, case: Case, model: Model) -> Reference:
        """The mission."""
        return installation(model)

    def disturbances(self, case: Case, model: Model, seed: int) -> list[Disturbance]:
        """Both arms' hooks and the tool's bar; where the robot starts, and the tool."""
        start = model.hover_state[:3]
        return [
            *(Hook(arm, "tool", BAR, HALF, floor=FLOOR) for arm in range(2)),
            Placement("base", (float(start[0]), float(start[1]), float(start[2])), spread=0.1),
        ]

    def metrics(self, case: Case, log: Log) -> dict[str, Metric]:
        """Whether all went well, how well the tool sat, and how much it and the platform swayed."""
        phase, p_W = log["phase"][:, 0], log["objects_W"][:, :3]
        waiting, over = phase == 7, phase >= 11
        installed = float(np.linalg.norm(p_W[waiting] - PIPE, axis=1).max()) if waiting.any() else None
        returned = float(np.linalg.norm(p_W[over] - BENCH, axis=1).max()) if over.any() else None
        fine = phase[-1] == 12 and not log["mission_failed"][-1, 0] and max(installed or 1, returned or 1) < SEATED
        carrying = (phase == 4) | (phase == 9)
        error = log["p_WB"] - log["p_WB_r"]
        tilted = float(_tilt(log["objects_W"][carrying, 3:7]).max()) if carrying.any() else None
        return {
            "done": Metric(float(fine), "1"),
            "last_phase": Metric(float(phase[-1]), "1"),
            "off_pipe": Metric(installed, "m"),
            "off_bench": Metric(returned, "m"),
            "tilt_of_tool": Metric(tilted, "rad"),
            "base_error": Metric(rmse(error), "m"),
            "mission_time": Metric(float(log.time[np.argmax(phase == 12)]) if over.any() else None, "s"),
        }

    def plot(self, runs: Mapping[tuple[str, str], Mapping[str, Array]], folder: Path) -> list[Path]:
        """Fig. 21: the platform's way and the tool's, with the phases."""
        figure, axes = panels(2, 1, f"{self.name}: bench at y = -0.8 m, pipe at y = 0.8 m", width=9.0)
        for colour, ((controller, _), log) in zip(COLOURS, runs.items(), strict=False):
            time, phase = log["time"][:, 0], log["phase"][:, 0]
            for axis, style in ((1, "-"), (2, "--")):
                axes[0, 0].plot(time, log["p_WB"][:, axis], style, color=colour, label=f"{controller}, {'xyz'[axis]}")
                axes[1, 0].plot(
                    time, log["objects_W"][:, axis], style, color=colour, label=f"{controller}, {'xyz'[axis]}"
                )
            for row in np.flatnonzero(np.diff(phase)) + 1:
                axes[0, 0].axvline(time[row], color="0.8", lw=0.6)
                axes[0, 0].text(time[row], 2.25, f"{phase[row]:.0f}", fontsize=7, color=colour)
        axes[0, 0].set_ylim(-1.0, 2.4)
        label(axes[0, 0], "platform, numbers of the phases", "position in m")
        label(axes[1, 0], "tool", "position in m")
        return [save(figure, folder / "tool_installation.png")]


def _tilt(q_W: Array) -> Array:
    """Angle between the tool's z and the vertical, rad."""
    up = Rotation.from_quat(q_W, scalar_first=True).apply([0.0, 0.0, 1.0])
    return np.asarray(np.arccos(np.clip(up[:, 2], -1.0, 1.0)))


EXPERIMENTS = (ToolInstallation(),)
