"""Undulating wall: 42 random contacts on a mapped, doubly curved wall with 10 N each (bodie2021 V-F, Figs. 14-17)."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from aerotact.dynamics.model import Model
from aerotact.experiments.bodie2021.contact_series import ContactSeries, judge, tool_errors
from aerotact.experiments.bodie2021.controllers import controllers
from aerotact.experiments.bodie2021.disturbed import drawn_machine
from aerotact.experiments.bodie2021.violins import violins
from aerotact.experiments.contact_pose import ContactPose
from aerotact.experiments.experiment import Case, ControllerSpec, PaperNumber
from aerotact.experiments.surface_map import map_surfaces
from aerotact.log import Log
from aerotact.metrics import Metric, in_band, push_force, rmse
from aerotact.plant.disturbance import Disturbance
from aerotact.plant.plant import Plant
from aerotact.plots import COLOURS, label, panels, save
from aerotact.ports import Array
from aerotact.reference import Reference
from aerotact.robot import load_robot

WORLD = "undulating_wall"
CONTACTS, STRIPS = 42, 6
FORCE, DURATION = 10.0, 5.0  # N, s
SERIES = ContactSeries(CONTACTS // STRIPS, FORCE, DURATION, transfer=2.5, stand_off=0.25)
JUDGED = 2.5  # s, before the force ramps down
NEAR = 0.05  # m, from the surface: Fig. 16's data
DRAW = 2  # seed of the contacts; like the paper's, they have one on the springy spot


@cache
def contacts(robot: str) -> tuple[tuple[ContactPose, ...], ...]:
    """The 42 contacts as a planner finds them on its map: strips of the wall from -y to +y, each from below upwards."""
    drawn = map_surfaces(Plant(load_robot(robot), WORLD)).random_contacts(CONTACTS, DRAW)
    across = sorted(drawn, key=lambda contact: float(contact.p_WE[1]))
    strips = [across[i : i + SERIES.count] for i in range(0, CONTACTS, SERIES.count)]
    return tuple(tuple(sorted(strip, key=lambda contact: float(contact.p_WE[2]))) for strip in strips)


def _controllers() -> dict[str, ControllerSpec]:
    """The MPC is told that the wall gives way, by parameters alone.

    Robot and tile swing against each other at 1.5 to 13 Hz, hardly damped. What the swing does to the force must not
    pass for a disturbance along the normal, so that one is looked for more slowly than on a rigid wall.
    """
    found = controllers("F", mpc={"approach_speed": 0.01, "force_rate": 20.0})
    return found | {"mpc": replace(found["mpc"], estimators={"contact_observer": {"L_normal": 3.0}})}


@dataclass(frozen=True)
class UndulatingWall:
    """Seven contacts a flight, six flights."""

    name: str = "bodie2021/undulating-wall"
    doc: str = "V-F, Figs. 14-17: 42 random contacts on an undulating wall with springy spots, 10 N for 5 s each"
    robot: str = "tilt_rotor"
    world: str = WORLD
    seeds: int = 5
    controllers: Mapping[str, ControllerSpec] = field(default_factory=_controllers)
    cases: tuple[Case, ...] = tuple(
        Case(f"strip{i + 1}", f"{SERIES.count} contacts of the strip", SERIES.end, (SERIES.pressed(0)[0], SERIES.end))
        for i in range(STRIPS)
    )
    paper: Mapping[str, PaperNumber] = field(
        default_factory=lambda: {"held": PaperNumber(1.0, "1", "V-F: 'in all 42 trials'")}
    )

    def reference(self, case: Case, model: Model) -> Reference:
        """To the strip's contacts one after the other."""
        strip = contacts(self.robot)[self.cases.index(case)]
        return SERIES.reference(model.hover_tool, strip)

    def disturbances(self, case: Case, model: Model, seed: int) -> list[Disturbance]:
        """A machine with errors of its own."""
        return drawn_machine(seed)

    def metrics(self, case: Case, log: Log) -> dict[str, Metric]:
        """Over the contacts of a strip: share that was held, errors of force, tool and attitude, peaks."""
        found = [judge(log.columns, SERIES, number, JUDGED) for number in range(SERIES.count)]
        true, band = (np.concatenate([getattr(c, name) for c in found]) - FORCE for name in ("force", "band"))
        across = np.concatenate([c.across for c in found])
        return {
            "held": Metric(float(np.mean([c.held for c in found])), "1"),
            "force_error": Metric(float(np.abs(true).mean()), "N"),
            "force_error_band": Metric(float(np.abs(band).mean()), "N"),
            "force_bias": Metric(float(true.mean()), "N"),
            "tool_across": Metric(rmse(across), "m"),
            "attitude_max": Metric(float(max(c.attitude.max() for c in found)), "rad"),
            "contact_peak": Metric(float(max(c.peak for c in found)), "N"),
            "contact_airborne": Metric(float(np.mean([c.airborne for c in found])), "1"),
        }

    def plot(self, runs: Mapping[tuple[str, str], Mapping[str, Array]], folder: Path) -> list[Path]:
        """Figs. 15, 16 and 17 for each controller."""
        labels = list(dict.fromkeys(controller for controller, _ in runs))
        found = {name: trials(log for (n, _), log in runs.items() if n == name) for name in labels}
        return [_figure_15(self, found, folder), _figure_16(self, found, folder), _figure_17(self, found, folder)]


@dataclass(frozen=True)
class Trial:
    """One contact as the figures show it.

    Attributes:
        pitch: of the tool's axis as planned, degrees; negative is downwards.
        time: since a force is wanted, s, of
        force: behind 5 Hz, N.
        across: distance of the tool from its desired axis while it is near the surface, m.
        error: of the force behind 5 Hz in the judged time, N.
        held: as judged.
    """

    pitch: float
    time: Array
    force: Array
    across: Array
    error: Array
    held: bool


def trials(logs: Iterable[Mapping[str, Array]]) -> list[Trial]:
    """All contacts of a controller's flights, by pitch."""
    found = []
    for log in logs:
        time = log["time"][:, 0]
        band = in_band(push_force(log), float(time[1] - time[0]))
        off = np.linalg.norm(tool_errors(log)[0], axis=1)
        for number in range(SERIES.count):
            start, stop = SERIES.pressed(number)
            rows = (time >= start - 1.0) & (time < stop + 1.5)
            near = rows & (log["surface_distance"][:, 0] < NEAR)
            desired = Rotation.from_quat(log["q_WE_d"][np.searchsorted(time, start)], scalar_first=True)
            pitch = float(np.degrees(np.arcsin(desired.as_matrix()[2, 2])))
            contact = judge(log, SERIES, number, JUDGED)
            found.append(Trial(pitch, time[rows] - start, band[rows], off[near], contact.band - FORCE, contact.held))
    return sorted(found, key=lambda trial: trial.pitch)


Trials = Mapping[str, Sequence[Trial]]


def _figure_15(experiment: UndulatingWall, found: Trials, folder: Path) -> Path:
    title = f"{experiment.name}: force behind 5 Hz from the first force command, as in Fig. 15"
    figure, axes = panels(len(found), 1, title, width=7.5)
    for axis, (controller, series) in zip(axes[:, 0], found.items(), strict=True):
        worst = max(series, key=lambda trial: float(np.abs(trial.error).mean()))
        for trial in series:
            axis.plot(trial.time, trial.force, color="k", lw=0.5, alpha=0.35)
        axis.plot(worst.time, worst.force, color=COLOURS[1], label=f"largest error, at {worst.pitch:.0f} degrees")
        axis.axhline(FORCE, color="k", ls="--", lw=1.0)
        axis.axvspan(
            SERIES.held(0)[1] - JUDGED - SERIES.pressed(0)[0], SERIES.held(0)[1] - SERIES.pressed(0)[0], alpha=0.08
        )
        held = sum(trial.held for trial in series)
        axis.set(xlim=(-1.0, DURATION + 1.5), ylim=(-2.0, 2.2 * FORCE))
        label(axis, f"{controller}: {held} of {len(series)} held", "force in N", "time in s; judged where shaded")
    return save(figure, folder / "fig15.png")


def _figure_16(experiment: UndulatingWall, found: Trials, folder: Path) -> Path:
    title = f"{experiment.name}: tool error across its axis, within {100 * NEAR:g} cm of the wall, as in Fig. 16"
    samples = {name: [1e3 * trial.across for trial in series] for name, series in found.items()}
    return _by_pitch(title, found, samples, "error in mm", folder / "fig16.png")


def _figure_17(experiment: UndulatingWall, found: Trials, folder: Path) -> Path:
    title = f"{experiment.name}: force error behind 5 Hz in the last {JUDGED:g} s of the full force, as in Fig. 17"
    samples = {name: [trial.error for trial in series] for name, series in found.items()}
    return _by_pitch(title, found, samples, "error in N", folder / "fig17.png")


def _by_pitch(title: str, found: Trials, samples: Mapping[str, list[Array]], unit: str, file: Path) -> Path:
    """One violin a contact in the order of their pitch, a row of them for each controller; all rows with one scale."""
    figure, axes = panels(len(found), 1, title, width=9.0, height=2.2)
    for axis, (controller, series), colour in zip(axes[:, 0], found.items(), COLOURS, strict=False):
        violins(
            axis, {controller: {str(i): v for i, v in enumerate(samples[controller])}}, [*map(str, range(len(series)))]
        )
        for body in axis.collections:
            body.set_color(colour)
        axis.set_xticks(range(0, len(series), 3), [f"{trial.pitch:.0f}" for trial in series[::3]])
        axis.get_legend().remove()
        label(axis, controller, unit, "pitch of the tool, degrees; negative is downwards")
    low, high = (f(f(axis.get_ylim()) for axis in axes.flat) for f in (min, max))
    for axis in axes.flat:
        axis.set_ylim(low, high)
    return save(figure, file)


EXPERIMENTS = (UndulatingWall(),)
