"""Joint compliance: torque and position steps of one joint on a bench (suarez2020 Fig. 16), and a blow on the tool."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from aerotact.dynamics.model import Model
from aerotact.experiments.experiment import Case, ControllerSpec, PaperNumber
from aerotact.experiments.suarez2020.schedule import Schedule
from aerotact.laws.suarez2020.joint_control import suarez2020_joint_control
from aerotact.log import Log
from aerotact.metrics import Metric, rmse
from aerotact.plant.clamp import Clamp
from aerotact.plant.disturbance import Disturbance, ToolForce
from aerotact.plant.placement import Placement
from aerotact.plots import label, panels, save
from aerotact.ports import Array
from aerotact.reference import Reference

LAW, RATE = "suarez2020_joint_control", 50.0
STEP, BACK = 2.0, 5.0  # s
LOW, HIGH = -0.3, -0.8  # N m, of the elbow against the block above the tool
BENT, STRETCHED = np.radians(-90.0), np.radians(-60.0)  # of the elbow
BLOW, LASTS = (0.0, 0.0, 3.0), 0.02  # N, s
BELOW = 0.008 + 0.02 + 0.0005  # m from the tool up to the block's middle: tip's radius, half the block, a gap
STIFFNESS, ELBOW, ENCODER = 1.48, 3, 1  # N m/rad of the left elbow, and its places in `servo` and among the encoders


@dataclass(frozen=True)
class JointCompliance:
    """The left elbow; both arms L-shaped, the base held."""

    name: str = "suarez2020/joint-compliance"
    doc: str = "Fig. 16: torque and position steps of an elbow on a bench, and a blow of 0.06 N s on the tool"
    robot: str = "dual_arm_standard"
    world: str = "block"
    seeds: int = 5
    controllers: Mapping[str, ControllerSpec] = field(
        default_factory=lambda: {"law": ControllerSpec(LAW, RATE, "(14)-(22); the paper gives no gains")}
    )
    cases: tuple[Case, ...] = (
        Case("torque", "the tool below a block, the elbow's torque -0.3, -0.8, -0.3 N m", 8.0, (STEP, BACK)),
        Case("position", "in the air, the elbow at -90, -60, -90 degrees", 8.0, (STEP, BACK)),
        Case("blow", "3 N for 20 ms on the tool, upwards", 6.0, (STEP, BACK)),
    )
    paper: Mapping[str, PaperNumber] = field(
        default_factory=lambda: {"servo_lag": PaperNumber(0.05, "s", "(17), identified by experiment")}
    )

    def reference(self, case: Case, model: Model) -> Reference:
        """Steps of the elbow; the shoulder's pitch is held by position."""
        rest = suarez2020_joint_control(model, RATE).reference
        if case.name == "torque":
            steps = [(0.0, (0.0, LOW)), (STEP, (0.0, HIGH)), (BACK, (0.0, LOW))]
            return Schedule(rest, {"by_position": [(0.0, (1.0, 0.0))], "torque_d": steps})
        if case.name == "position":
            return Schedule(rest, {"joint_d": [(0.0, (0.0, BENT)), (STEP, (0.0, STRETCHED)), (BACK, (0.0, BENT))]})
        return Schedule(rest)

    def disturbances(self, case: Case, model: Model, seed: int) -> list[Disturbance]:
        """The bench; the block above the tool; the blow."""
        found: list[Disturbance] = [Clamp()]
        if case.name == "torque":
            x, y, z = model.hover_tool[0]
            found.append(Placement("block", (x, y, z + BELOW)))
        if case.name == "blow":
            found.append(ToolForce(BLOW, STEP, STEP + LASTS))
        return found

    def metrics(self, case: Case, log: Log) -> dict[str, Metric]:
        """How fast, how far beyond, how exact; of the blow what the spring makes of it."""
        columns, time = log.columns, log.time
        torque, angle = elbow_torque(columns), columns["joint"][:, ELBOW]
        end = log.window(BACK - 1.0, BACK)
        if case.name == "torque":
            heard = columns["torque_est"][:, ENCODER]
            return {
                "torque_rise": Metric(rise_time(time, torque, STEP, LOW, HIGH), "s"),
                "torque_overshoot": Metric(overshoot(torque[log.window(STEP, BACK)], LOW, HIGH), "1"),
                "torque_error": Metric(rmse(torque[end] - HIGH), "N m"),
                "torque_estimate_error": Metric(rmse((heard - torque)[end]), "N m"),
            }
        if case.name == "position":
            step = log.window(STEP, BACK)
            return {
                "position_rise": Metric(rise_time(time, angle, STEP, BENT, STRETCHED), "s"),
                "position_overshoot": Metric(overshoot(angle[step], BENT, STRETCHED), "1"),
                "position_error": Metric(rmse(angle[end] - STRETCHED), "rad"),
                "position_sag": Metric(float(np.abs(columns["servo"][end, ELBOW] - angle[end]).mean()), "rad"),
                "servo_lag": Metric(servo_lag(columns, log.period), "s"),
            }
        after = log.window(STEP, STEP + 1.5)
        frequency, ratio = ringing(time[after], torque[after])
        return {
            "blow_deflection": Metric(float(np.ptp(torque[after]) / STIFFNESS), "rad"),
            "blow_frequency": Metric(frequency, "rad/s"),
            "blow_damping": Metric(ratio, "1"),
            "blow_servo_travel": Metric(float(np.ptp(columns["servo"][after, ELBOW])), "rad"),
        }

    def plot(self, runs: Mapping[tuple[str, str], Mapping[str, Array]], folder: Path) -> list[Path]:
        """Torque, angles of shaft and link, deflection."""
        figure, axes = panels(1, 3, f"{self.name}: left elbow", width=4.0)
        for (_, case), log in runs.items():
            time, servo, link = log["time"][:, 0], log["servo"][:, ELBOW], log["joint"][:, ELBOW]
            if case == "torque":
                axes[0, 0].plot(time, log["torque_d"][:, ENCODER], "k--", label="reference")
                axes[0, 0].plot(time, log["torque_est"][:, ENCODER], label="measured, (15)", lw=0.8)
                axes[0, 0].plot(time, elbow_torque(log), label="spring")
                axes[0, 0].set_ylim(-1.0, 0.4)
                label(axes[0, 0], "torque control, tool against a block", "torque in N m")
            elif case == "position":
                axes[0, 1].plot(time, np.degrees(log["joint_d"][:, ENCODER]), "k--", label="reference")
                axes[0, 1].plot(time, np.degrees(servo), label="servo shaft")
                axes[0, 1].plot(time, np.degrees(link), label="output link")
                axes[0, 1].set_ylim(-105, -25)
                label(axes[0, 1], "position control, in the air", "angle in degrees")
            else:
                near = (time > STEP - 0.2) & (time < STEP + 1.5)
                axes[0, 2].plot(time[near], np.degrees(servo - link)[near], label="deflection")
                axes[0, 2].plot(time[near], np.degrees(servo - servo[0])[near], label="servo's travel")
                label(axes[0, 2], "blow of 0.06 N s on the tool", "angle in degrees")
        return [save(figure, folder / "joint_compliance.png")]


def elbow_torque(log: Mapping[str, Array]) -> Array:
    """Torque of the left elbow's spring, N m, from the true angles."""
    return np.asarray(STIFFNESS * (log["servo"][:, ELBOW] - log["joint"][:, ELBOW]))


def rise_time(time: Array, value: Array, start: float, low: float, high: float) -> float:
    """s from a step at `start` until 90 % of it are done; NaN if that never happens."""
    done = (time >= start) & ((value - low) / (high - low) >= 0.9)
    return float(time[np.argmax(done)] - start) if done.any() else float("nan")


def overshoot(value: Array, low: float, high: float) -> float:
    """Largest excess over a step, as a share of it."""
    return float(max(0.0, ((value - high) / (high - low)).max()))


def servo_lag(log: Mapping[str, Array], period: float) -> float:
    """T_s of (17), s, by least squares of theta_rate T_s = theta_cmd - theta over the run, where the servo is slow
    enough not to be cut."""
    theta, wanted = log["servo"][:, ELBOW], log["servo_cmd"][:, ELBOW]
    rate = np.gradient(theta, period)
    moving = (np.abs(rate) > 0.05) & (np.abs(wanted - theta) < 0.3)
    return float(np.sum(rate[moving] * (wanted - theta)[moving]) / np.sum(rate[moving] ** 2))


def ringing(time: Array, value: Array) -> tuple[float, float]:
    """Frequency, rad/s, and damping ratio of a decaying oscillation, from its first extremes on the same side."""
    swing = value - value[-1]
    peaks = np.flatnonzero((swing[1:-1] > swing[:-2]) & (swing[1:-1] >= swing[2:]) & (swing[1:-1] > 0)) + 1
    peaks = peaks[swing[peaks] > 0.02 * swing.max()]
    if len(peaks) < 2:
        return float("nan"), float("nan")
    first, second = peaks[np.argmax(swing[peaks]) :][:2]
    decrement = np.log(swing[first] / swing[second])
    return float(2 * np.pi / (time[second] - time[first])), float(decrement / np.hypot(2 * np.pi, decrement))


EXPERIMENTS = (JointCompliance(),)
