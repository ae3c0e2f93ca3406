"""Disturbance: pushed in free flight by a stick and by a small wall (bodie2021 V-A, Table V, Fig. 7)."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from matplotlib.lines import Line2D

from aerotact.dynamics.model import Model
from aerotact.experiments.bodie2021.controllers import TABLE_IV, controllers
from aerotact.experiments.bodie2021.wall import CALIBRATE, ForceSteps
from aerotact.experiments.experiment import Case, ControllerSpec, PaperNumber
from aerotact.experiments.reference import Hold, Together, WithFlags
from aerotact.log import Log
from aerotact.metrics import Metric, in_band
from aerotact.plant.disturbance import Disturbance
from aerotact.plant.hand_push import HandPush
from aerotact.plots import COLOURS, label, panels, save
from aerotact.ports import Array
from aerotact.reference import Reference

# The push is not printed. A hand brings stick or wall to 5 mm before the tip, goes on by 85 mm within 2 s and back
# within 2 s, half a cosine each; the tool is pushed as long as it is touched.
FAR, GAP, DEPTH = 0.4, 0.005, 0.08  # m
START, STOP, END = 6.0, 10.0, 10.5  # s
WAY = ((3.5, 0.0), (5.5, FAR - GAP), (START, FAR - GAP), (START + 2.0, FAR + DEPTH), (STOP, FAR - GAP))
TOUCHED = 0.05  # N, in the band of the sensor's filter

# Table V: (name, seen by the camera, m_free, m_wall, k). A PD controller is the law with the real inertia.
ROWS = (
    ("1s5", False, 5.0, 0.25, 135.57),
    ("2spd", False, 1.0, 1.0, 100.25),
    ("3wpd", True, 1.0, 1.0, 93.46),
    ("4w1", True, 5.0, 1.0, 92.09),
    ("5w0.5", True, 5.0, 0.5, 47.64),
    ("6w0.25", True, 5.0, 0.25, 4.05),
    ("7w0.1", True, 5.0, 0.1, -5.57),
)


def _case(name: str, seen: bool, m_free: float, m_wall: float) -> Case:
    pd = m_free == 1.0
    what = "PD" if pd else f"m_free {m_free:g}, m_wall {m_wall:g}"
    values = {"m_free": m_free, "m_wall": m_wall, "J_v": 1.0 if pd else 5.0}
    return Case(name, f"{'wall' if seen else 'stick'}, {what}", END, (START, STOP), values)


def _impedance() -> ControllerSpec:
    """The MPC that has the law's target dynamics, with the law's gains and an observer as slow as the law's.

    The surface is what moves here, and its speed is not known: a damper towards the surface as it stands now would
    foretell that a push ends once the tool yields to it.
    """
    gains = {name: TABLE_IV["A"][name] for name in ("K_lin", "D_lin", "K_ang", "D_ang", "d_min", "d_max")}
    observer = {"contact_observer": {"L": TABLE_IV["A"]["K_I_lin"], "K_I": TABLE_IV["A"]["K_I_ang"]}}
    surface = {"stiffness": 500.0, "damping": 0.0}
    return ControllerSpec("tilt_rotor_impedance", None, "the law's impedance under limits", gains | surface, observer)


@dataclass(frozen=True)
class Pushed:
    """The robot hovers without a wanted force; its tool is pushed back along its axis and let go."""

    name: str = "bodie2021/disturbance"
    doc: str = "V-A, Table V, Fig. 7: pushed in free flight by a stick or a small wall; stiffness by m_wall"
    robot: str = "tilt_rotor"
    world: str = "pushers"
    seeds: int = 5
    controllers: Mapping[str, ControllerSpec] = field(default_factory=lambda: controllers("A") | {"mpc": _impedance()})
    cases: tuple[Case, ...] = tuple(_case(*row[:4]) for row in ROWS)
    paper: Mapping[str, PaperNumber] = field(
        default_factory=lambda: {f"k_{row[0]}": PaperNumber(row[4], "N/m", "Table V") for row in ROWS}
    )

    def reference(self, case: Case, model: Model) -> Reference:
        """Hover."""
        return Together((WithFlags(Hold(*model.hover_tool), {"calibrate": CALIBRATE}), ForceSteps(())))

    def disturbances(self, case: Case, model: Model, seed: int) -> list[Disturbance]:
        """The hand with what it holds."""
        x, y, z = model.hover_tool[0]
        body = "small_wall" if case.doc.startswith("wall") else "stick"
        return [HandPush(body, (float(x) + FAR, float(y), float(z)), WAY)]

    def metrics(self, case: Case, log: Log) -> dict[str, Metric]:
        """Slope of the line through force and position, and the largest of both."""
        position, force = push_curve(log.columns, log.period)
        return {
            f"k_{case.name}": Metric(float(np.polyfit(position, force, 1)[0]), "N/m"),
            f"force_{case.name}": Metric(float(force.max()), "N"),
            f"moved_{case.name}": Metric(float(position.max()), "m"),
        }

    def plot(self, runs: Mapping[tuple[str, str], Mapping[str, Array]], folder: Path) -> list[Path]:
        """Fig. 7c for each controller, and Table V as bars."""
        return [_figure_7(self, runs, folder), _stiffness(self, runs, folder)]


def push_curve(log: Mapping[str, Array], period: float) -> tuple[Array, Array]:
    """Position and force of the tool along the push while it is touched, in the band of the sensor's filter.

    Args:
        log: columns of a run.
        period: s between rows.

    Returns:
        Displacement from where the tool was before the push, m, and force on the tool, N: against the tool's axis.
    """
    time = log["time"][:, 0]
    before = (time >= START - 0.5) & (time < START)
    moved = log["p_WE"][before, 0].mean() - log["p_WE"][:, 0]
    position, force = in_band(moved, period), in_band(-log["f_contact_W"][:, 0], period)
    rows = (time >= START) & (time < STOP) & (force > TOUCHED)
    return position[rows], force[rows]


def _figure_7(experiment: Pushed, runs: Mapping[tuple[str, str], Mapping[str, Array]], folder: Path) -> Path:
    labels = list(dict.fromkeys(controller for controller, _ in runs))
    figure, axes = panels(
        1, len(labels), f"{experiment.name}: force and position, as in Fig. 7c", height=3.6, width=4.8
    )
    colours = dict(zip((row[0] for row in ROWS), (*COLOURS, "#b08900"), strict=True))
    for axis, controller in zip(axes[0], labels, strict=True):
        for case in experiment.cases:
            if (controller, case.name) not in runs:
                continue
            log = runs[controller, case.name]
            position, force = push_curve(log, float(log["time"][1, 0] - log["time"][0, 0]))
            axis.plot(1e3 * position, force, color=colours[case.name], label=f"{case.name[0]}  {case.doc}")
            if position.size:
                ends = np.array([position.min(), position.max()])
                fit = np.polyfit(position, force, 1)
                axis.plot(1e3 * ends, np.polyval(fit, ends), color=colours[case.name], ls=":", lw=1.0)
        label(axis, controller, "force in N", "position in mm")
        axis.get_legend().remove()
    lines = [Line2D([], [], color=colours[c.name], label=f"{c.name[0]}  {c.doc}") for c in experiment.cases]
    figure.legend(handles=[*lines, Line2D([], [], color="k", ls=":", label="line fit")], loc="outside right center")
    return save(figure, folder / "fig7.png")


def _stiffness(experiment: Pushed, runs: Mapping[tuple[str, str], Mapping[str, Array]], folder: Path) -> Path:
    labels = list(dict.fromkeys(controller for controller, _ in runs))
    figure, axes = panels(1, 1, f"{experiment.name}: slope of the line fits, Table V", width=7.5, height=3.0)
    names, axis = [row[0] for row in ROWS], axes[0, 0]
    places, width = np.arange(len(names)), 0.8 / (len(labels) + 1)
    axis.bar(places, [row[4] for row in ROWS], width, color="0.6", label="paper")
    for number, (controller, colour) in enumerate(zip(labels, COLOURS, strict=False), 1):
        found = [n for n in names if (controller, n) in runs]
        slopes = []
        for name in found:
            log = runs[controller, name]
            curve = push_curve(log, float(log["time"][1, 0] - log["time"][0, 0]))
            slopes.append(np.polyfit(*curve, 1)[0])
        axis.bar([names.index(n) + number * width for n in found], slopes, width, color=colour, label=controller)
    axis.set_xticks(places + width * len(labels) / 2, names)
    axis.axhline(0, color="k", lw=0.6)
    axis.set_yscale("symlog", linthresh=20.0)
    label(axis, "s: stick, w: wall; linear below 20 N/m, logarithmic above", "k in N/m", "row of Table V")
    return save(figure, folder / "table5.png")


EXPERIMENTS = (Pushed(),)
