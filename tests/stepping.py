"""Blocks stepped by name, and flights of the symbolic model (RK4, rotor lag, held commands) without any plant."""

from collections.abc import Callable, Mapping
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from aerotact.dynamics import so3
from aerotact.dynamics.model import Model
from aerotact.ports import Array, Block, Layout


def known(layout: Layout, values: Mapping[str, ArrayLike]) -> Array:
    """The layout's vector from those values that it has ports for."""
    return layout.pack({k: v for k, v in values.items() if k in layout})


class Runner:
    """A block with its state; the command passes the limiter, if the block has one."""

    def __init__(self, block: Block) -> None:
        self.block = block
        self.z = block.state.default
        self.z_limiter = block.limiter_state.default

    def __call__(self, y: Mapping[str, ArrayLike], r: Mapping[str, ArrayLike] | None = None) -> dict[str, Array]:
        b = self.block
        z, u = b.step(self.z, known(b.measurement, y), known(b.reference, r or {}), b.parameters.default)
        self.z = z.full().ravel()
        out = b.output.unpack(u.full())
        if b.limiter is not None:
            size = b.limiter.size1_out(1)
            z_limiter, command = b.limiter(self.z_limiter, u[:size], [], [])
            self.z_limiter = z_limiter.full().ravel()
            out = b.output.unpack(ca.vertcat(command, u[size:]).full())
        return out


def run_through(block: Block, measurement: Array, chunk: int = 500) -> tuple[dict[str, Array], dict[str, Array]]:
    """States and outputs by name, one row a sample, for measurements of one row a sample and default references."""
    rows = len(measurement) // chunk * chunk
    many = block.step.mapaccum(chunk)
    references, parameters = (np.tile(v.default[:, None], chunk) for v in (block.reference, block.parameters))
    z, states, outputs = ca.DM(block.state.default), [], []
    for start in range(0, rows, chunk):
        part, out = many(z, measurement[start : start + chunk].T, references, parameters)
        z = part[:, -1]
        states.append(part.full().T)
        outputs.append(out.full().T)
    return _columns(block.state, np.vstack(states)), _columns(block.output, np.vstack(outputs))


def _columns(layout: Layout, rows: Array) -> dict[str, Array]:
    return {p.name: rows[:, layout.slice(p.name)] for p in layout}


class Flight:
    """The model in flight from hover, with a wrench of the environment at the tool's tip; f_W, tau_W in N and N m."""

    def __init__(self, model: Model, period: float = 0.002) -> None:
        self.model = model
        self.x = model.hover_state.copy()
        self.f_W, self.tau_W = np.zeros(3), np.zeros(3)
        x, c, w = ca.SX.sym("x", model.state.size), ca.SX.sym("c", model.commands.size), ca.SX.sym("w", 6)
        self._step = ca.Function("step", [x, c, w], [_after(model, x, c, w, period)])
        said = _signals(model, x, w)
        self._names = list(said)
        self._signals = ca.Function("signals", [x, w], list(said.values()))

    def step(self, thrust_cmd: ArrayLike, tilt_cmd: ArrayLike | None = None) -> None:
        """One period under commands; tilts are told to stay as in hover if they are told nothing."""
        tilt = self.model.robot.hover_tilt if tilt_cmd is None else tilt_cmd
        command = np.concatenate([np.asarray(thrust_cmd), np.asarray(tilt)])
        self.x = self._step(self.x, command, self._wrench).full().ravel()

    def signals(self) -> dict[str, Array]:
        """What perfect sensors would say, the tool's pose, and the true wrench about the centre of mass, `truth`."""
        values = self._signals(self.x, self._wrench)
        return {n: v.full().ravel() for n, v in zip(self._names, values, strict=True)}

    @property
    def _wrench(self) -> Array:
        return np.concatenate([self.f_W, self.tau_W])


class ClosedLoop:
    """Observer, law, limiter and the model's flight as one function, from hover; `alter` changes what the law hears."""

    def __init__(
        self, model: Model, law: Block, observer: Block, alter: Callable[[dict[str, Any]], dict[str, Any]] | None = None
    ) -> None:
        self.model, self.law, self.x = model, law, model.hover_state.copy()
        layouts = (model.state, observer.state, law.state, law.limiter_state)
        z = [ca.SX.sym(f"z{i}", layout.size) for i, layout in enumerate(layouts)]
        w, r = ca.SX.sym("w", 6), ca.SX.sym("r", law.reference.size)
        said = _signals(model, z[0], w)
        z_observer, estimate = observer.step(
            z[1],
            _vector(observer.measurement, said),
            ca.DM(observer.reference.default),
            ca.DM(observer.parameters.default),
        )
        said |= observer.output.split(estimate)
        told = alter(said) if alter else said
        z_law, out = law.step(z[2], _vector(law.measurement, told), r, ca.DM(law.parameters.default))
        said |= law.output.split(out)
        z_limiter, command = law.limiter(z[3], out[: model.commands.size], ca.DM(0, 1), ca.DM(0, 1))
        said |= model.commands.split(command)
        x_next = _after(model, z[0], command, w, 1 / law.rate)
        self._start = np.concatenate([layout.default for layout in layouts])
        self._names = {n: int(v.shape[0]) for n, v in said.items()}
        after = ca.vertcat(x_next, z_observer, z_law, z_limiter)
        self._step = ca.Function("loop", [ca.vertcat(*z), w, r], [after, ca.densify(ca.vertcat(*said.values()))])

    def run(self, seconds: float, wrench: ArrayLike = (0.0,) * 6, references: Array | None = None) -> dict[str, Array]:
        """Signals by name, one row a step, from state `x` under a constant wrench at the tip."""
        chunk = int(seconds * self.law.rate)
        if references is None:
            references = np.tile(self.law.reference.default, (chunk, 1))
        start = np.concatenate([self.x, self._start[self.x.size :]])
        wrenches = np.tile(np.asarray(wrench, dtype=float)[:, None], chunk)
        _, rows = self._step.mapaccum(chunk)(start, wrenches, references.T)
        ends = np.cumsum(list(self._names.values()))[:-1]
        return dict(zip(self._names, np.split(rows.full().T, ends, axis=1), strict=True))


def _after(model: Model, x: Any, command: Any, wrench: Any, period: float, substeps: int = 2) -> Any:
    """x after a command held for `period` seconds with the wrench at the tip, (6,) in W."""
    h = period / substeps

    def slope(x: Any) -> Any:
        return model.derivative(x, model.rates(x, command), _about_com(model, x, wrench))

    for _ in range(substeps):
        k1 = slope(x)
        k2 = slope(x + h / 2 * k1)
        k3 = slope(x + h / 2 * k2)
        k4 = slope(x + h * k3)
        x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        x = ca.vertcat(x[0:3], so3.unit(x[3:7]), x[7:])
    return x


def _about_com(model: Model, x: Any, wrench: Any) -> Any:
    """f_ext_W and tau_ext_B of a wrench at the tip."""
    R_WB = so3.rotation(x[3:7])
    p_CE_W = ca.mtimes(R_WB, ca.DM(model.robot.p_BE - model.robot.p_BC))
    return ca.vertcat(wrench[0:3], ca.mtimes(R_WB.T, wrench[3:6] + ca.cross(p_CE_W, wrench[0:3])))


def _signals(model: Model, x: Any, wrench: Any) -> dict[str, Any]:
    s, robot, p = model.state.split(x), model.robot, _about_com(model, x, wrench)
    a_WB, dw = model.accelerations(x, p)
    w, p_BI = s["w_B"], ca.DM(robot.p_BI)
    force = ca.mtimes(so3.rotation(s["q_WB"]).T, a_WB + ca.DM([0, 0, robot.gravity]))
    force += ca.cross(dw, p_BI) + ca.cross(w, ca.cross(w, p_BI))
    p_WE, q_WE = model.tool_pose(x)
    measured = {f"{port.name}_measured": s[port.name] for port in model.actuators}
    return {**s, **measured, "specific_force_B": force, "p_WE": p_WE, "q_WE": q_WE, "truth": p}


def _vector(layout: Layout, said: dict[str, Any]) -> Any:
    return ca.vertcat(*[said[p.name] for p in layout])


def rotation(q: ArrayLike) -> Array:
    """R_AB of q_AB, wxyz."""
    return np.asarray(so3.rotation(ca.DM(np.asarray(q))).full())


def random_unit(rng: np.random.Generator) -> Array:
    """A random attitude, wxyz."""
    q = rng.normal(size=4)
    return q / np.linalg.norm(q)


def random_state(model: Model, rng: np.random.Generator) -> Array:
    """A random x with thrusts and tilts within their range."""
    limits = {"thrust": model.thrust_limits, "tilt": model.tilt_limits}
    return model.state.pack(
        {
            "p_WB": rng.normal(size=3),
            "q_WB": random_unit(rng),
            "v_WB": rng.normal(size=3),
            "w_B": rng.normal(size=3),
            **{port.name: rng.uniform(*limits[port.name]) for port in model.actuators},
        }
    )
