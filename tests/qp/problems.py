"""Random OCP QPs of a given shape. A problem is a dictionary of the arrays of the generated header's data structure."""

import numpy as np
from shapes import Shape

from aerotact.ports import Array

Problem = dict[str, Array]
KINDS = ("plain", "tight", "degenerate", "badly scaled", "saturated", "infeasible")
_GRADIENT = {"plain": 1.0, "tight": 5.0, "saturated": 100.0}  # size of the linear cost; 3 otherwise
_ROOM = 0.05  # least distance of a bound to the trajectory that makes the problem feasible


def random_problem(rng: np.random.Generator, shape: Shape, kind: str) -> Problem:
    """A problem that is feasible unless `kind` is infeasible (which soft rows may prevent: ask the judge)."""
    problem = _dynamics(rng, shape) | _cost(rng, shape, _GRADIENT.get(kind, 3.0))
    x, u = _trajectory_and_control_bounds(rng, shape, problem, kind)
    _bound_states(rng, shape, problem, x, kind)
    _bound_rows(rng, shape, problem, x, u, kind)
    if kind == "badly scaled":
        _spoil_units(rng, shape, problem)
    if kind == "infeasible":
        _contradict(rng, shape, problem)
    return problem


def _dynamics(rng: np.random.Generator, shape: Shape) -> Problem:
    nx, nu, steps = shape.pattern.nx, shape.pattern.nu, shape.pattern.steps
    A, B = np.zeros((steps, nx, nx)), np.zeros((steps, nx, nu))
    for k in range(steps):
        if k and rng.random() < 0.5:
            A[k], B[k] = A[k - 1], B[k - 1]
            continue
        A[k] = np.eye(nx) + 0.3 * rng.standard_normal((nx, nx)) / np.sqrt(nx)
        A[k] /= max(1.0, 0.98 * np.abs(np.linalg.eigvals(A[k])).max())
        B[k] = 0.5 * rng.standard_normal((nx, nu))
    if shape.fixed_A is not None and shape.fixed_B is not None:
        step = rng.uniform(0.02, 0.2)
        A = np.where(np.isnan(shape.fixed_A), A, shape.fixed_A)
        B = np.where(np.isnan(shape.fixed_B), B, step * shape.fixed_B)
    return {"A": A, "B": B, "b": 0.1 * rng.standard_normal((steps, nx)), "x0": rng.standard_normal(nx)}


def _cost(rng: np.random.Generator, shape: Shape, gradient: float) -> Problem:
    """Half of them diagonal with states that cost nothing, the others of any rank and with cross terms."""
    nx, nu, steps = shape.pattern.nx, shape.pattern.nu, shape.pattern.steps
    Q, R, S = np.zeros((steps + 1, nx, nx)), np.zeros((steps, nu, nu)), np.zeros((steps, nu, nx))
    diagonal = rng.random() < 0.5
    for k in range(steps + 1):
        if diagonal:
            Q[k] = np.diag(rng.uniform(0.0, 2.0, nx) * (rng.random(nx) < 0.7))
            if k < steps:
                R[k] = np.diag(10.0 ** rng.uniform(-5.0, 0.0, nu))
            continue
        rank = int(rng.integers(1, nx + nu + 1))
        root = rng.standard_normal((rank, nx + nu))
        H = root.T @ root / rank
        Q[k] = H[:nx, :nx]
        if k < steps:
            S[k], R[k] = H[nx:, :nx], H[nx:, nx:] + 10.0 ** rng.uniform(-6.0, -1.0) * np.eye(nu)
    q, r = gradient * rng.standard_normal((steps + 1, nx)), 0.1 * gradient * rng.standard_normal((steps, nu))
    return {"Q": Q, "R": R, "S": S, "q": q, "r": r}


def _trajectory_and_control_bounds(
    rng: np.random.Generator, shape: Shape, problem: Problem, kind: str
) -> tuple[Array, Array]:
    """Bounds on the controls, and a trajectory inside them; degenerate ones touch it, some from both sides."""
    size = (shape.pattern.steps, shape.pattern.nu)
    lower, upper = -rng.uniform(0.2, 2.0, size), rng.uniform(0.2, 2.0, size)
    if kind != "saturated":
        lower[rng.random(size) < 0.1] = -np.inf
        upper[rng.random(size) < 0.1] = np.inf
    u = np.clip(0.5 * rng.standard_normal(size), np.maximum(lower, -3.0), np.minimum(upper, 3.0))
    if kind == "degenerate":
        touching = rng.random(size) < 0.5
        upper[touching] = u[touching]
        equal = touching & (rng.random(size) < 0.2)
        lower[equal] = u[equal]
    problem["lbu"], problem["ubu"] = lower, upper
    x = np.zeros((size[0] + 1, shape.pattern.nx))
    x[0] = problem["x0"]
    for k in range(size[0]):
        x[k + 1] = problem["A"][k] @ x[k] + problem["B"][k] @ u[k] + problem["b"][k]
    return x, u


def _bound_states(rng: np.random.Generator, shape: Shape, problem: Problem, x: Array, kind: str) -> None:
    bounded = list(shape.pattern.bounded)
    if not bounded:
        return
    values, room = x[:, bounded], 0.0 if kind == "degenerate" else _ROOM
    lower, upper = values - rng.uniform(room, 1.0, values.shape), values + rng.uniform(room, 1.0, values.shape)
    if kind == "degenerate":
        touching = rng.random(values.shape) < 0.3
        lower[touching] = values[touching]
        lower, upper = lower - 1e-12, upper + 1e-12
    lower[rng.random(values.shape) < 0.15] = -np.inf
    upper[rng.random(values.shape) < 0.15] = np.inf
    soft = np.array(shape.pattern.soft_bounds)
    shift = rng.uniform(-1.0, 1.0, values.shape) * soft  # so that some are violated
    problem["lbx"], problem["ubx"] = lower + shift, upper + shift
    if soft.any():
        problem["soft_x_lin"], problem["soft_x_quad"] = _penalties(rng, values.shape)


def _bound_rows(rng: np.random.Generator, shape: Shape, problem: Problem, x: Array, u: Array, kind: str) -> None:
    steps, general = shape.pattern.steps, shape.pattern.general
    if not general:
        return
    C = rng.standard_normal((steps + 1, general, shape.pattern.nx))
    D = rng.standard_normal((steps, general, shape.pattern.nu))
    values = np.einsum("kij,kj->ki", C, x)
    values[:steps] += np.einsum("kij,kj->ki", D, u)
    room = 1e-12 if kind == "degenerate" else _ROOM
    lower, upper = values - rng.uniform(room, 2.0, values.shape), values + rng.uniform(room, 2.0, values.shape)
    lower[rng.random(values.shape) < 0.3] = -np.inf
    upper[rng.random(values.shape) < 0.3] = np.inf
    soft = np.array(shape.pattern.soft_rows)
    problem |= {"C": C, "D": D, "lg": lower + soft, "ug": upper + soft}
    if soft.any():
        problem["soft_g_lin"], problem["soft_g_quad"] = _penalties(rng, values.shape)


def _penalties(rng: np.random.Generator, size: tuple[int, ...]) -> tuple[Array, Array]:
    """Linear and quadratic slack penalties, a third of them without the quadratic part."""
    quadratic = 10.0 ** rng.uniform(-1.0, 3.0, size) * (rng.random(size) < 0.7)
    return 10.0 ** rng.uniform(-1.0, 3.0, size), quadratic


def _spoil_units(rng: np.random.Generator, shape: Shape, problem: Problem) -> None:
    """Other units of cost and, where the structure of A and B allows it, of states and controls: factors up to 1e6."""
    nx, nu, bounded = shape.pattern.nx, shape.pattern.nu, list(shape.pattern.bounded)
    free = shape.fixed_A is None
    tx = 10.0 ** rng.uniform(-3.0, 3.0, nx) if free else np.ones(nx)
    tu = 10.0 ** rng.uniform(-3.0, 3.0, nu) if free else np.ones(nu)
    cost, tb = 10.0 ** rng.uniform(-4.0, 4.0), tx[bounded]
    factors = {
        **{"A": tx[:, None] / tx, "B": tx[:, None] / tu, "b": tx, "x0": tx, "C": 1.0 / tx, "D": 1.0 / tu},
        **{"Q": cost / tx[:, None] / tx, "R": cost / tu[:, None] / tu, "S": cost / tu[:, None] / tx},
        **{"q": cost / tx, "r": cost / tu, "lbu": tu, "ubu": tu, "lbx": tb, "ubx": tb},
        **{"soft_x_lin": cost / tb, "soft_x_quad": cost / tb**2, "soft_g_lin": cost, "soft_g_quad": cost},
    }
    for name, factor in factors.items():
        if name in problem:
            problem[name] = problem[name] * factor


def _contradict(rng: np.random.Generator, shape: Shape, problem: Problem) -> None:
    """Crossed control bounds, or a hard row that controls of limited size cannot reach."""
    states = [i for i, soft in enumerate(shape.pattern.soft_bounds) if not soft]
    rows = [i for i, soft in enumerate(shape.pattern.soft_rows) if not soft]
    k, how = int(rng.integers(1, shape.pattern.steps + 1)), int(rng.integers(3))
    if (how == 0 and states) or (how == 1 and rows):
        problem["lbu"], problem["ubu"] = np.maximum(problem["lbu"], -2.0), np.minimum(problem["ubu"], 2.0)
        name, i = ("x", rng.choice(states)) if how == 0 else ("g", rng.choice(rows))
        problem[f"lb{name}" if how == 0 else "lg"][k, i] = 1e3
        problem[f"ub{name}" if how == 0 else "ug"][k, i] = np.inf
    else:
        problem["lbu"][k - 1, 0], problem["ubu"][k - 1, 0] = 0.1, 0.0
