"""Saturation: a push of 20 N with the body pitched, weak rotors and a side wind; not in the paper."""

import os
import shutil
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from aerotact.codegen.build import cache_folder
from aerotact.dynamics.model import Model
from aerotact.exceptions import InputError
from aerotact.experiments.bodie2021.controllers import controllers
from aerotact.experiments.bodie2021.wall import CALIBRATE, DEPART, WALL
from aerotact.experiments.experiment import Case, ControllerSpec, PaperNumber
from aerotact.experiments.force_profile import ForceProfile, Ramp
from aerotact.experiments.reference import Together, WithFlags
from aerotact.experiments.trajectory import Move, Sampled, rest_to_rest
from aerotact.log import Log
from aerotact.metrics import Metric, in_band, push_force, rmse
from aerotact.plant.disturbance import Disturbance, Wind
from aerotact.plots import COLOURS, label, panels, save
from aerotact.ports import Array
from aerotact.reference import Reference
from aerotact.resources import find_robot

PITCH = 30.0  # degrees, nose down
PUSH = 20.0  # N
WIND = 6.0  # N, along y of W
THRUST = 12.0  # N, highest of a rotor group
PITCHED, ARRIVE = 7.0, 10.0  # s
RAMP = (11.0, 12.5)  # s, of the force
GUST = 15.0  # s, when the wind begins
END = 21.0  # s
JUDGED = (GUST + 1.0, END)  # s
MPC_GAINS = {"weight_tilt_rate": 1e-2}
"""Of the MPC: the push has a lever arm, so that a newton of the rotors moves the wall's force by a quarter of one only;
fast servos would shake the tip."""
_RANGE = 'ctrlrange="0.2 20"'


@cache
def weak_robot() -> str:
    """Folder of a tilt-rotor whose groups give 12 N: a copy of the robot in the cache, which all controllers are for.

    Raises:
        InputError: plant.xml does not say the range of thrust just once, as it should.
    """
    origin = find_robot("tilt_rotor")
    plant = (origin / "plant.xml").read_text(encoding="utf-8")
    if plant.count(_RANGE) != 1:
        raise InputError(f"{origin / 'plant.xml'} has {_RANGE} {plant.count(_RANGE)} times; valid: once")
    folder = cache_folder() / "robots" / f"tilt_rotor_{THRUST:g}N"
    folder.parent.mkdir(parents=True, exist_ok=True)
    fresh = Path(tempfile.mkdtemp(dir=folder.parent))
    (fresh / "plant.xml").write_text(plant.replace(_RANGE, f'ctrlrange="0.2 {THRUST:g}"'), encoding="utf-8")
    shutil.copy(origin / "robot.toml", fresh)
    return str(_moved(fresh, folder))


def _moved(fresh: Path, folder: Path) -> Path:
    folder.mkdir(exist_ok=True)
    for file in fresh.iterdir():
        os.replace(file, folder / file.name)  # at once, so that another process never reads half a file
    fresh.rmdir()
    return folder


@dataclass(frozen=True)
class Saturation:
    """The tool on a wall, the body pitched against it, so that the push has a lever arm about the body."""

    name: str = "bodie2021/saturation"
    doc: str = "a push of 20 N with the body pitched by 30 degrees, rotor groups of 12 N, and then a side wind of 6 N"
    world: str = "wall"
    seeds: int = 5
    controllers: Mapping[str, ControllerSpec] = field(
        default_factory=lambda: controllers(
            "D",
            {"K_ang": 30.0, "D_ang": 4.0},
            mpc=MPC_GAINS,
            law={"K_ang": 20.0, "D_ang": 3.5},
            estimators={"contact_observer": {"L_normal": 40.0}},
        )
    )
    cases: tuple[Case, ...] = (Case("push", "20 N, wind from 15 s on", END, JUDGED),)
    paper: Mapping[str, PaperNumber] = field(default_factory=dict)

    @property
    def robot(self) -> str:
        """The weak robot's folder."""
        return weak_robot()

    def reference(self, case: Case, model: Model) -> Reference:
        """Pitch in front of the wall, then go there and push."""
        p_WE, q_WE = model.hover_tool
        pitch_B = Rotation.from_rotvec([0.0, np.deg2rad(PITCH), 0.0])
        pitched = (pitch_B * Rotation.from_quat(q_WE, scalar_first=True)).as_quat(scalar_first=True)
        p_BE = model.robot.p_BE
        before = p_WE + pitch_B.apply(p_BE) - p_BE
        there = np.array([WALL, before[1], before[2]])
        moves = [Move(DEPART, PITCHED, before, pitched), Move(PITCHED, ARRIVE, there, pitched)]
        motion = Sampled(rest_to_rest(p_WE, q_WE, moves))
        return Together([WithFlags(motion, {"calibrate": CALIBRATE}), ForceProfile([Ramp(*RAMP, PUSH)])])

    def disturbances(self, case: Case, model: Model, seed: int) -> list[Disturbance]:
        """The wind."""
        return [Wind((0.0, WIND, 0.0), GUST, END + 1.0)]

    def metrics(self, case: Case, log: Log) -> dict[str, Metric]:
        """Attitude from the push on; force, tool and contact in the wind; how long commands lie on a limit."""
        pushed, windy = log.window(RAMP[0], END), log.window(*JUDGED)
        force, tool = push_force(log.columns), log["p_WE"] - log["p_WE_d"]
        angle = attitude_error(log.columns)
        return {
            "attitude_max": Metric(float(angle[pushed].max()), "rad"),
            "force_in_wind": Metric(rmse(force[windy] - PUSH), "N"),
            "force_mean": Metric(float(force[windy].mean()), "N"),
            "tool_in_wind": Metric(float(np.abs(tool[windy, 1:]).max()), "m"),
            "contact": Metric(float((force[windy] > 0.0).mean()), "1"),
            "at_thrust_limit": Metric(float((log["thrust_cmd"][pushed] >= THRUST - 1e-6).any(axis=1).mean()), "1"),
            "highest_thrust": Metric(float(log["thrust"].max()), "N"),
            "highest_tilt_rate": Metric(float(np.abs(log["tilt_rate_cmd"]).max()), "rad/s"),
        }

    def plot(self, runs: Mapping[tuple[str, str], Mapping[str, Array]], folder: Path) -> list[Path]:
        """Force, attitude, thrusts, tilt rates."""
        figure, axes = panels(2, 2, f"{self.name}: {PUSH:g} N at {PITCH:g} degrees, wind of {WIND:g} N from {GUST:g} s")
        for colour, ((name, _), log) in zip(COLOURS, runs.items(), strict=False):
            time = log["time"][:, 0]
            axes[0, 0].plot(time, in_band(push_force(log), 0.01), color=colour, label=name)
            axes[0, 1].plot(time, np.rad2deg(attitude_error(log)), color=colour)
            axes[1, 0].plot(time, log["thrust"].max(axis=1), color=colour)
            axes[1, 1].plot(time, np.abs(log["tilt_rate_cmd"]).max(axis=1), color=colour)
        axes[0, 0].plot(time, log["f_ref"][:, 0], "k:", label="wanted")
        label(axes[0, 0], "normal force behind 5 Hz", "force in N")
        label(axes[0, 1], "angle to the desired attitude", "error in degrees")
        label(axes[1, 0], "highest of the six thrusts", "thrust in N")
        label(axes[1, 1], "highest of the six tilt rates commanded", "rate in rad/s")
        axes[1, 0].axhline(THRUST, color="k", ls=":", lw=1)
        axes[0, 0].set_ylim(-1, 2 * PUSH)
        axes[0, 1].set_ylim(0, 20)
        for axis in axes.flat:
            axis.set_xlim(ARRIVE - 1, END)
        return [save(figure, folder / "saturation.png")]


def attitude_error(log: Mapping[str, Array]) -> Array:
    """Angle between the tool's attitude and the desired one, rad, shape (rows,)."""
    desired = Rotation.from_quat(log["q_WE_d"], scalar_first=True)
    return np.asarray((desired.inv() * Rotation.from_quat(log["q_WE"], scalar_first=True)).magnitude())


EXPERIMENTS = (Saturation(),)
