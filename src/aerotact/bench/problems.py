"""Problems: what is raced. Two of the benchmark's own, and every ocp file of the project.

H  hexarotor with fixed, tilted rotors: 19 numbers of state (18 coordinates), 6 thrust rates.
O  hexarotor with tilting rotors that presses a stick against a wall: 25 numbers (24 coordinates), 12 thrust and tilt
   rates; the contact force is a softplus of the penetration, in the dynamics and in the residuals.

Both have a uniform grid of 50 ms, Gauss-Newton weights and simple bounds; the last node counts as one second. Their
stage parameters are the references, so that steps of any size can be commanded.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import casadi as ca
import numpy as np

from aerotact.dynamics import so3
from aerotact.dynamics.model_of import model_of
from aerotact.exceptions import AerotactError, InputError
from aerotact.mpc.constraints import Bounds
from aerotact.mpc.ocp import load_ocp
from aerotact.mpc.transcription import Statement, Transcription, transcribe
from aerotact.ports import Array
from aerotact.resources import find_problem, robot_folders
from aerotact.robot import load_robot

STEPS, INTERVAL, RATE = 20, 0.05, 100.0
GRAVITY = 9.81  # m/s^2
WALL, STICK, STIFFNESS, SOFTNESS = 1.0, 0.55, 500.0, 0.002  # m, m, N/m, m
_POSE_WEIGHTS = (100.0,) * 3 + (20.0,) * 3 + (5.0,) * 3 + (1.0,) * 3  # position, attitude, velocity, angular velocity


@dataclass(frozen=True)
class Problem:
    """A problem to race on.

    Attributes:
        name, doc: "H", "O", or an ocp file's stem; one line.
        transcription: the functions of the real-time iteration.
        rate: Hz at which it is solved.
        parameters: that all stages share, shape (parameter_size,).
        start: state at hover, shape (nx,).
        hold: samples from one step of the reference to the next, so that bounds are active in 70 to 90 % of samples.
        draw: random generator -> one stage's parameters, a large step away, shape (stage_size,).
        contact: state -> force on the tool, N, or None where the problem has no contact.
    """

    name: str
    doc: str
    transcription: Transcription
    rate: float
    parameters: Array
    start: Array
    hold: int
    draw: Callable[[np.random.Generator], Array]
    contact: Callable[[Array], float] | None = None

    @property
    def control_range(self) -> Array:
        """Width of the controls' bounds, shape (nu,); 1 where there is none. Errors of the first control are in it."""
        width = self.transcription.bounds.u_upper - self.transcription.bounds.u_lower
        return np.where(np.isfinite(width), width, 1.0)


def make_problem(name: str, steps: int | None = None) -> Problem:
    """A problem by name; `steps` intervals of the same length instead of its own number.

    Raises:
        UnknownName: neither "H", "O" nor an ocp file.
        InputError: a horizon below one interval, or one for an ocp file, whose grid is its own.
    """
    if steps is not None and steps < 1:
        raise InputError(f"horizon is {steps}; valid: at least 1 interval")
    if name == "H":
        return _hexarotor(steps or STEPS)
    if name == "O":
        return _tilting_rotors(steps or STEPS)
    if steps is not None:
        raise InputError(f"horizon is {steps}, but '{name}' has its own grid; valid: H or O with a horizon")
    return _ocp_file(name)


def _step_of_pose(rng: np.random.Generator, angle: float) -> Array:
    """Random position (3,), m, and attitude (4,) turned by up to `angle` rad."""
    half = rng.uniform(-angle, angle) / 2
    axis = rng.standard_normal(3)
    q = np.concatenate([[np.cos(half)], np.sin(half) * axis / np.linalg.norm(axis)])
    return np.concatenate([rng.uniform(-1.5, 1.5, 3), q])


def _statement(
    name: str,
    steps: int,
    mass: float,
    J: Array,
    wrench: Callable[[Any], tuple[Any, Any]],
    external: Callable[[Any, Any], tuple[Any, Any, Any]],
    actuators: tuple[Array, Array, Array],
    rates: tuple[Array, Array],
    force_weight: float | None,
) -> Statement:
    """A rigid body whose actuator states integrate the controls.

    Args:
        name: C prefix.
        steps: intervals.
        mass, J: kg; diagonal of the inertia, kg m^2, shape (3,).
        wrench: actuator states -> force and torque of the rotors in B.
        external: (position, R_WB) -> contact force magnitude, its force in W, its torque in B.
        actuators: hover value, lower and upper bound of the actuator states, each (nu,).
        rates: bound and weight of the controls, each (nu,).
        force_weight: of the contact force's residual; None if there is none.
    """
    hover, lower, upper = actuators
    rate_limit, rate_weight = rates
    nu = len(hover)
    inertia = ca.DM(J)

    def derivative(x: Any, rate: Any, _stage: Any) -> Any:
        q, v, w = x[3:7], x[7:10], x[10:13]
        R = so3.rotation(q)
        f_B, tau_B = wrench(x[13:])
        _, f_W, tau_contact = external(x[0:3], R)
        acceleration = (ca.mtimes(R, f_B) + f_W) / mass - ca.DM([0, 0, GRAVITY])
        angular = (tau_B + tau_contact - ca.cross(w, inertia * w)) / inertia
        return ca.vertcat(v, so3.quaternion_rate(q, w), acceleration, angular, rate)

    def tracking(x: Any, stage: Any) -> tuple[Any, Array]:
        error = 2 * so3.product(so3.conjugate(stage[3:7]), x[3:7])[1:4]
        values = [x[0:3] - stage[0:3], error, x[7:13], x[13:] - ca.DM(hover)]
        weights = [*_POSE_WEIGHTS, *(0.01,) * nu]
        if force_weight is not None:
            values.append(external(x[0:3], so3.rotation(x[3:7]))[0] - stage[7])
            weights.append(force_weight)
        return ca.vertcat(*values), np.array(weights)

    def terms(x: Any, u: Any, stage: Any, _parameters: Any) -> tuple[Any, Any]:
        values, weights = tracking(x, stage)
        return ca.vertcat(values, u), ca.DM(np.concatenate([weights, rate_weight]))

    def terminal_terms(x: Any, stage: Any, _parameters: Any) -> tuple[Any, Any]:
        values, weights = tracking(x, stage)
        return values, ca.DM(weights)

    times = INTERVAL * np.arange(steps + 1)
    return Statement(
        name=name,
        nx=13 + nu,
        ndx=12 + nu,
        nu=nu,
        stage_size=7 if force_weight is None else 8,
        parameter_size=0,
        times=times,
        gains=np.full((steps, nu), INTERVAL),
        derivative=derivative,
        retract=_retract,
        local=_local,
        rest=lambda x: ca.vertcat(x[0:7], ca.SX.zeros(6), x[13:]),
        terms=terms,
        terminal_terms=terminal_terms,
        command=lambda x, u, _: x[13:] + INTERVAL * u,
        bounds=Bounds(tuple(range(13, 13 + nu)), lower, upper, -rate_limit, rate_limit),
        damping=0.0,
    )


def _retract(x: Any, dx: Any) -> Any:
    return ca.vertcat(x[0:3] + dx[0:3], so3.retract(x[3:7], dx[3:6]), x[7:] + dx[6:])


def _local(x_from: Any, x_to: Any) -> Any:
    return ca.vertcat(x_to[0:3] - x_from[0:3], so3.local(x_from[3:7], x_to[3:7]), x_to[7:] - x_from[7:])


def _arm_angles() -> tuple[Array, Array]:
    """Cosine and sine of the six arms' directions, with exact zeros."""
    angle = np.arange(6) * np.pi / 3
    c, s = np.cos(angle), np.sin(angle)
    return np.where(np.abs(c) < 1e-12, 0.0, c), np.where(np.abs(s) < 1e-12, 0.0, s)


def _hexarotor(steps: int) -> Problem:
    """H: 2 kg, arms of 0.4 m, rotors turned by 30 degrees about their arm and 10 degrees across it."""
    mass = 2.0
    c, s = _arm_angles()
    across, tilt = np.radians(10), np.radians(30)
    columns = []
    for i in range(6):
        side = (-1) ** i
        along, normal = np.sin(across), np.cos(across) * np.array([-np.sin(side * tilt), np.cos(side * tilt)])
        d = np.array([c[i] * along - s[i] * normal[0], s[i] * along + c[i] * normal[0], normal[1]])
        r = 0.4 * np.array([c[i], s[i], 0.0])
        columns.append(np.concatenate([d, np.cross(r, d) + side * 0.017 * d]))
    allocation = np.array(columns).T
    hover = np.linalg.solve(allocation, [0, 0, mass * GRAVITY, 0, 0, 0])
    matrix = ca.sparsify(ca.DM(np.where(np.abs(allocation) < 1e-14, 0.0, allocation)))

    def wrench(thrust: Any) -> tuple[Any, Any]:
        both = ca.mtimes(matrix, thrust)
        return both[0:3], both[3:6]

    statement = _statement(
        "bench_h",
        steps,
        mass,
        np.array([0.0115, 0.0114, 0.0194]),
        wrench,
        lambda _p, _R: (0, ca.DM.zeros(3), ca.DM.zeros(3)),
        (hover, np.full(6, 0.2), np.full(6, 12.0)),
        (np.full(6, 60.0), np.full(6, 1e-4)),
        None,
    )
    return Problem(
        "H",
        "hexarotor with fixed tilted rotors in free flight, 18 coordinates, 6 thrust rates",
        transcribe(statement),
        RATE,
        np.zeros(0),
        _at_origin(hover),
        150,
        partial(_step_of_pose, angle=1.0),
    )


def _tilting_rotors(steps: int) -> Problem:
    """O: 5 kg, arms of 0.3 m, a stick of 0.55 m, a wall at x = 1 m."""
    mass = 5.0
    c, s = _arm_angles()

    def wrench(actuators: Any) -> tuple[Any, Any]:
        thrust, tilt = actuators[0:6], actuators[6:12]
        f_B, tau_B = ca.SX.zeros(3), ca.SX.zeros(3)
        for i in range(6):
            direction = ca.vertcat(s[i] * ca.sin(tilt[i]), -c[i] * ca.sin(tilt[i]), ca.cos(tilt[i]))
            f = direction * thrust[i]
            f_B = f_B + f
            tau_B = tau_B + ca.cross(ca.DM([0.3 * c[i], 0.3 * s[i], 0]), f) + (-1) ** i * 0.015 * f
        return f_B, tau_B

    def external(p: Any, R: Any) -> tuple[Any, Any, Any]:
        force = _wall_force(p[0] + STICK * R[0, 0])
        f_B = -force * R[0, :].T
        return force, ca.vertcat(-force, 0, 0), ca.cross(ca.DM([STICK, 0, 0]), f_B)

    hover = np.concatenate([np.full(6, mass * GRAVITY / 6), np.zeros(6)])
    statement = _statement(
        "bench_o",
        steps,
        mass,
        np.array([0.08, 0.08, 0.14]),
        wrench,
        external,
        (hover, np.repeat([0.5, -np.pi], 6), np.repeat([20.0, np.pi], 6)),
        (np.repeat([80.0, 6.0], 6), np.repeat([1e-4, 1e-2], 6)),
        1.0,
    )
    x = ca.SX.sym("x", 25)
    contact = ca.Function("contact", [x], [external(x[0:3], so3.rotation(x[3:7]))[0]])

    def draw(rng: np.random.Generator) -> Array:
        stage = _step_of_pose(rng, 0.6)
        stage[0] = rng.uniform(-0.1, 0.7)  # in half of the steps the tip would be behind the wall
        return np.append(stage, rng.uniform(0, 10))

    return Problem(
        "O",
        "hexarotor with tilting rotors and a stick at a wall, 24 coordinates, 12 thrust and tilt rates",
        transcribe(statement),
        RATE,
        np.zeros(0),
        _at_origin(hover),
        75,
        draw,
        lambda state: float(contact(state)),
    )


def _wall_force(tip: Any) -> Any:
    """Force of the wall on a tip at this distance from the origin, N; smooth, safe for any distance."""
    z = (tip - WALL) / SOFTNESS
    return STIFFNESS * SOFTNESS * (ca.fmax(z, 0) + ca.log1p(ca.exp(ca.fmin(z, -z))))


def _at_origin(actuators: Array) -> Array:
    return np.concatenate([np.zeros(3), [1.0], np.zeros(9), actuators])


def _ocp_file(name: str) -> Problem:
    """The transcription of an ocp file for the first robot that it fits, with steps of its targets."""
    find_problem(name)
    ocp, fault = None, None
    for robot in robot_folders():
        try:
            ocp = load_ocp(name, model_of(load_robot(robot)))
            break
        except AerotactError as error:
            fault = error
    if ocp is None:
        raise InputError(f"problem '{name}' fits no robot: {fault}")
    model, layout = ocp.model, ocp.targets.stage
    p_WE, q_WE = model.hover_tool
    hover = model.state.split(model.hover_state)["thrust"]

    def draw(rng: np.random.Generator) -> Array:
        pose = _step_of_pose(rng, 1.0)
        turned = np.array(so3.product(ca.DM(pose[3:]), ca.DM(q_WE))).ravel()
        known = {"p_WE_d": p_WE + pose[:3], "q_WE_d": turned, "p_WE_r": p_WE + pose[:3], "q_WE_r": turned}
        values = {**known, "thrust_trim": hover}
        return layout.pack({port: value for port, value in values.items() if port in layout})

    return Problem(
        ocp.name,
        ocp.file.problem.doc,
        ocp,
        ocp.rate,
        ocp.targets.block.parameters.default,
        np.array(model.hover_state),
        125,
        draw,
    )
