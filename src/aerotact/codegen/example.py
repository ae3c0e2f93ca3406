"""The example that every C project carries: the model of the robot at hover, and what its sensors would say, as C."""

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from aerotact.codegen.functions import emit, number, signature
from aerotact.dynamics import so3
from aerotact.dynamics.model import Model
from aerotact.estimation.point_patch import RADIUS
from aerotact.exceptions import CodegenError
from aerotact.ports import Array, Layout

SECONDS = 4.0
SUBSTEPS = 4
OFFSET = np.array([0.05, 0.0, 0.0])
AHEAD = 1.0  # m, from the tool to a plate
_JUDGED = {"p_WB": "m", "p_WE_r": "m", "f_ext_W": "N", "f_push_B": "N", "f_dist_W": "N", "n_W": "1"}


@dataclass(frozen=True)
class Example:
    """What the templates of `example/` need beside the block itself."""

    context: dict[str, Any]
    source: str
    header: str


def signals(model: Model, x: Any) -> dict[str, Any]:
    """Every measurement by name, without noise, of the undisturbed model in state x (a CasADi column).

    The only thing in reach is a plate 1 m ahead of the tool, at right angles to it.
    """
    s = model.state.split(x)
    a_WB, dw_B = model.accelerations(x, ca.DM.zeros(model.disturbance.size))
    lever = ca.DM(model.robot.p_BI)
    R_BW = so3.rotation(s["q_WB"]).T
    w_B = s["w_B"]
    gravity_W = ca.DM([0, 0, -model.robot.gravity])
    specific_force = ca.mtimes(R_BW, a_WB - gravity_W) + ca.cross(dw_B, lever) + ca.cross(w_B, ca.cross(w_B, lever))
    p_WE, q_WE = model.tool_pose(x)
    v_WE, w_E = model.tool_twist(x)
    zero = ca.DM.zeros(3)
    return {
        **{name: s[name] for name in ("p_WB", "q_WB", "v_WB", "w_B", "joint", "joint_rate") if name in s},
        **{f"{port.name}_measured": s[port.name] for port in model.actuators if port.name in s},
        **model.sensed(x),
        "accelerometer_B": specific_force,
        "specific_force_B": specific_force,
        "gyro_B": w_B,
        "mocap_p_WB": s["p_WB"],
        "mocap_q_WB": s["q_WB"],
        "mocap_fresh": ca.DM(1),
        **dict.fromkeys(("f_ext_W", "tau_ext_B", "f_tool_W", "tau_tool_W", "f_dist_W", "tau_dist_B", "f_tip_W"), zero),
        **dict.fromkeys(("contact", "normal_force", "friction"), ca.DM(0)),
        "p_WE": p_WE,
        "q_WE": q_WE,
        "v_WE": v_WE,
        "w_E": w_E,
        **_force_torque(model, w_B, dw_B, ca.mtimes(R_BW, a_WB - gravity_W)),
        "patch_points": ca.DM(500),
        "patch_mean_E": ca.DM([0, 0, AHEAD]),
        "patch_covariance_E": ca.DM([RADIUS**2 / 4, 0, 0, RADIUS**2 / 4, 0, 0]),
        "surface_distance": ca.DM(AHEAD),
        "n_W": -so3.rotation(q_WE)[:, 2],
        "surface_valid": ca.DM(1),
    }


def _force_torque(model: Model, w_B: Any, dw_B: Any, specific_force_B: Any) -> dict[str, Any]:
    """What the force/torque sensor says of the point mass that it carries, from the specific force at B's origin."""
    sensor = model.robot.force_torque
    if sensor is None:
        return {}
    lever = ca.DM(sensor.p_BS + sensor.R_BS @ sensor.p_SD)
    at_mass = specific_force_B + ca.cross(dw_B, lever) + ca.cross(w_B, ca.cross(w_B, lever))
    force = ca.mtimes(ca.DM(sensor.R_BS).T, sensor.distal_mass * at_mass)
    return {"f_sensor_S": force, "tau_sensor_S": ca.cross(ca.DM(sensor.p_SD), force)}


def make_example(
    name: str, model: Model, rate: float, measurement: Layout, reference: Layout, output: Layout, limited: bool
) -> Example:
    """C of the model at `rate` Hz under held commands, its measurements, and the references of hover.

    Raises:
        CodegenError: a measurement port that no sensor gives.
    """
    x0 = model.hover_state
    x = ca.SX.sym("x", model.state.size)
    known = signals(model, x)
    unknown = [p.name for p in measurement if p.name not in known]
    if unknown:
        raise CodegenError(f"{name}: no signal {', '.join(unknown)}; known: {', '.join(sorted(known))}")
    measure = ca.vertcat(*[known[p.name] for p in measurement])
    judged = "p_WE" if any(p.name.startswith("p_WE") for p in reference) else "p_WB"
    functions = [
        (ca.Function("measure", [x], [ca.densify(measure)]), f"{name}_example_measure", ["x"], ["y"]),
    ]
    if limited:
        command = ca.SX.sym("command", model.commands.size)
        after = _held_step(model, x, command, 1.0 / rate)
        functions.append((ca.Function("plant", [x, command], [after]), f"{name}_example_plant", ["x", "c"], ["x_next"]))
        functions.append((ca.Function("tool", [x], [ca.densify(known[judged])]), f"{name}_example_tool", ["x"], ["at"]))
    at_hover = {k: np.ravel(v.full()) for k, v in _evaluate(known, x, x0).items()}
    wanted = {"p_WE_d": "p_WE", "q_WE_d": "q_WE", "p_WB_r": "p_WB", "q_WB_r": "q_WB"}
    constants = {p.name: at_hover[wanted[p.name]] for p in reference if p.name in wanted}
    estimate = next((n for n in _JUDGED if n in output), "")
    if limited:
        goal = at_hover[judged]
    else:
        # Nothing is judged of a block whose outputs are none of these, but that every step is OK.
        goal = np.zeros(3) if not estimate or _JUDGED[estimate] == "N" else at_hover.get(estimate, at_hover[judged])
    beside = limited and "p_WB" in measurement  # what does not know its place cannot come back to it
    start = x0 + np.concatenate([OFFSET if beside else np.zeros(3), np.zeros(x0.size - 3)])
    header = "\n".join(
        [
            f"/* The model of {model.robot.name}, for the example. */",
            f"#ifndef {name.upper()}_PLANT_H\n#define {name.upper()}_PLANT_H",
            '#ifdef __cplusplus\nextern "C" {\n#endif',
            *[signature(n, a, r) + ";" for _, n, a, r in functions],
            *[
                f"static const double {name}_example_{key}[{value.size}] = "
                f"{{{', '.join(map(number, value.tolist()))}}};"
                for key, value in constants.items()
            ],
            "#ifdef __cplusplus\n}\n#endif\n#endif\n",
        ]
    )
    source = "\n".join(
        [
            f'#include "{name}_plant.h"\n\n#include <math.h>\n',
            *[emit(f, n, a, r, lambda _: "") for f, n, a, r in functions],
        ]
    )
    context = {
        "nx": x0.size,
        "beside": beside,
        # The commands are the first fields of the output.
        "command": "(const double *)&output" if len(model.commands) > 1 else "output.thrust_cmd",
        "x0": [number(v) for v in start],
        "goal": [number(v) for v in goal.tolist()],
        "steps": round(SECONDS * rate),
        "measurement_size": measurement.size,
        "reference": [{"name": p.name, "nodes": p.nodes} for p in reference if p.name in constants],
        "estimate": estimate,
        "unit": _JUDGED.get(estimate, "m"),
    }
    return Example(context, source, header)


def _evaluate(expressions: dict[str, Any], x: Any, value: Array) -> dict[str, Any]:
    results = ca.Function("f", [x], list(expressions.values()))(value)
    return dict(zip(expressions, results, strict=True))


def _held_step(model: Model, x: Any, command: Any, period: float) -> Any:
    """State after `period` under held commands: Runge-Kutta of order four, the actuators' lag in the derivative."""
    zero = ca.DM.zeros(model.disturbance.size)

    def f(state: Any) -> Any:
        return model.derivative(state, model.rates(state, command), zero)

    h = period / SUBSTEPS
    for _ in range(SUBSTEPS):
        k1 = f(x)
        k2 = f(x + h / 2 * k1)
        k3 = f(x + h / 2 * k2)
        k4 = f(x + h * k3)
        x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return ca.vertcat(x[0:3], so3.unit(x[3:7]), x[7:])
