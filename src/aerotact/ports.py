"""Port, Layout, Block: what flows between sensors, estimators, laws, controllers and the plant, and in which shape.

A Block is a pure function

    (z_next, u) = step(z, y, r, p)

of an internal state z, a measurement y, a reference r and parameters p. Each of the five vectors is a Layout of named
ports that carry unit and frame, so that the generated C struct, the log's column and the loop's wiring agree by name.
"""

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from aerotact.exceptions import InputError, UnknownName

Array = NDArray[Any]
"""Array of float64."""


@dataclass(frozen=True)
class Port:
    """A named slice of a vector.

    Attributes:
        name: the field's name in C, the column's name in a log, the signal's name in a loop.
        size: numbers per node.
        unit: SI unit ("1" if none).
        frame: W world, B base body, E tool (end effector), "" if it has none.
        doc: one line.
        kind: "quaternion" ports (wxyz) are normalised on entry; "flag" ports are 0 or 1.
        nodes: 1, or the number of horizon nodes of a preview (row-major, node by node).
        default: initial or default value, `size` numbers, the same at each node.
        limit: magnitude beyond which a value is refused as BAD_INPUT.
        lower: value below which it is refused too.
    """

    name: str
    size: int
    unit: str
    frame: str = ""
    doc: str = ""
    kind: Literal["vector", "quaternion", "flag"] = "vector"
    nodes: int = 1
    default: tuple[float, ...] = ()
    limit: float = 1e6
    lower: float = -math.inf

    def __post_init__(self) -> None:
        if not self.default:
            value = (1.0, 0.0, 0.0, 0.0) if self.kind == "quaternion" else (0.0,) * self.size
            object.__setattr__(self, "default", value)
        if len(self.default) != self.size:
            raise InputError(f"port {self.name}: default has {len(self.default)} numbers; valid: {self.size}")

    @property
    def total(self) -> int:
        """Numbers in all nodes."""
        return self.size * self.nodes

    @property
    def labels(self) -> tuple[str, ...]:
        """A short label per component: w x y z, x y z, or numbers from 0."""
        if self.kind == "quaternion":
            return ("w", "x", "y", "z")
        if self.size == 3:
            return ("x", "y", "z")
        return tuple(str(i) for i in range(self.size))


class Layout:
    """An ordered set of ports and where each lies in the flat vector."""

    def __init__(self, ports: Iterable[Port] = ()) -> None:
        self.ports = tuple(ports)
        self._slices: dict[str, slice] = {}
        start = 0
        for port in self.ports:
            if port.name in self._slices:
                raise InputError(f"port {port.name} stands twice in one layout")
            self._slices[port.name] = slice(start, start + port.total)
            start += port.total
        self.size = start

    def __iter__(self) -> Iterator[Port]:
        return iter(self.ports)

    def __len__(self) -> int:
        return len(self.ports)

    def __contains__(self, name: object) -> bool:
        return name in self._slices

    def __getitem__(self, name: str) -> Port:
        self.slice(name)
        return next(port for port in self.ports if port.name == name)

    def slice(self, name: str) -> slice:
        """Where the port lies.

        Raises:
            UnknownName: no such port.
        """
        if name not in self._slices:
            raise UnknownName("port", name, self._slices)
        return self._slices[name]

    @property
    def default(self) -> Array:
        """Default value of the whole vector, shape (size,)."""
        return np.concatenate([np.tile(p.default, p.nodes) for p in self.ports] or [np.zeros(0)])

    def pack(self, values: Mapping[str, ArrayLike]) -> Array:
        """Flat vector from named values; what is not named has its default.

        Raises:
            UnknownName: a name that is no port.
            InputError: a value of the wrong size.
        """
        flat = self.default
        for name, value in values.items():
            array = np.asarray(value, dtype=float).ravel()
            where = self.slice(name)
            port = self[name]
            if array.size == 1 and port.total > 1 and port.kind == "vector":
                array = np.full(port.total, array[0])
            if array.size != port.total:
                raise InputError(f"port {name}: {array.size} numbers given; valid: {port.total} ({port.unit})")
            flat[where] = array
        return flat

    def unpack(self, flat: ArrayLike) -> dict[str, Array]:
        """Named values from the flat vector, views of it if it is an array of floats; previews (nodes, size)."""
        array = np.asarray(flat)
        vector = (array if array.dtype == np.float32 else np.asarray(array, dtype=float)).ravel()
        return {
            p.name: vector[self._slices[p.name]].reshape((p.nodes, p.size) if p.nodes > 1 else (p.size,))
            for p in self.ports
        }

    def split(self, vector: Any) -> dict[str, Any]:
        """Named slices of a CasADi column vector; a preview becomes a matrix of shape (size, nodes)."""
        parts = {}
        for p in self.ports:
            part = vector[self._slices[p.name]]
            parts[p.name] = ca.reshape(part, p.size, p.nodes) if p.nodes > 1 else part
        return parts

    def with_defaults(self, values: Mapping[str, ArrayLike]) -> "Layout":
        """The same layout with other defaults.

        Raises:
            UnknownName: a name that is no port.
            InputError: a value of the wrong size.
        """
        unpacked = self.unpack(self.pack(values))
        return Layout(
            replace(p, default=tuple(float(v) for v in np.atleast_2d(unpacked[p.name])[0])) if p.name in values else p
            for p in self.ports
        )


@dataclass(frozen=True)
class Block:
    """A law or an estimator: layouts and one CasADi function `step(z, y, r, p) -> (z_next, u)`.

    Attributes:
        name: C prefix and name on the command line.
        source: paper key, or "aerotact" for what no paper gives.
        rate: Hz at which `step` is to be called; it is compiled in.
        step: the function, flat vectors in and out.
        limiter: for controllers, `limit(z, u) -> (z_next, u)`: brings any finite command, the first outputs, within the
            actuators' limits.
        limiter_state: layout of the limiter's own state.
    """

    name: str
    source: str
    doc: str
    rate: float
    state: Layout
    measurement: Layout
    reference: Layout
    parameters: Layout
    output: Layout
    step: Any
    limiter: Any = None
    limiter_state: Layout = field(default_factory=Layout)

    def with_parameters(self, values: Mapping[str, ArrayLike]) -> "Block":
        """The same block with other default parameters (shapes as declared; a scalar fills its port)."""
        return replace(self, parameters=self.parameters.with_defaults(values))


class BlockBuilder:
    """Collects ports as symbols, then closes them into a Block."""

    def __init__(self, name: str, source: str, rate: float, doc: str) -> None:
        self._head: dict[str, Any] = {"name": name, "source": source, "rate": rate, "doc": doc}
        self._ports: dict[str, list[Port]] = {k: [] for k in ("state", "measurement", "reference", "parameters")}
        self._symbols: dict[str, list[Any]] = {k: [] for k in self._ports}
        self._next: dict[str, Any] = {}
        self._outputs: list[tuple[Port, Any]] = []
        self._limiter: Block | None = None

    def _add(self, group: str, port: Port) -> Any:
        symbol = ca.SX.sym(port.name, port.size, port.nodes)
        self._ports[group].append(port)
        self._symbols[group].append(symbol)
        return symbol

    def state(self, name: str, size: int, unit: str, **rest: Any) -> Any:
        """Symbol of an internal state; must get its next value by `update`."""
        return self._add("state", Port(name, size, unit, **rest))

    def measurement(self, name: str, size: int, unit: str, **rest: Any) -> Any:
        """Symbol of a measurement."""
        return self._add("measurement", Port(name, size, unit, **rest))

    def reference(self, name: str, size: int, unit: str, **rest: Any) -> Any:
        """Symbol of a reference, shape (size, nodes)."""
        return self._add("reference", Port(name, size, unit, **rest))

    def parameter(self, name: str, size: int, unit: str, default: ArrayLike, **rest: Any) -> Any:
        """Symbol of a parameter that can be changed at run time."""
        value = np.broadcast_to(np.asarray(default, dtype=float), (size,))
        return self._add("parameters", Port(name, size, unit, default=tuple(float(v) for v in value), **rest))

    def update(self, name: str, value: Any) -> None:
        """Next value of a state."""
        self._next[name] = value

    def output(self, name: str, value: Any, unit: str, **rest: Any) -> None:
        """An output port; its size is that of the value."""
        value = ca.SX(value)
        self._outputs.append((Port(name, int(value.shape[0]), unit, nodes=int(value.shape[1]), **rest), value))

    def limit_with(self, limiter: Block) -> None:
        """Guard the command, the first outputs, with an actuator limiter (see dynamics.actuators)."""
        self._limiter = limiter

    def build(self) -> Block:
        """Close the block.

        Raises:
            InputError: a state without an update, an update without a state, or first outputs that are not the
                limiter's.
        """
        states = [p.name for p in self._ports["state"]]
        if set(states) != set(self._next):
            raise InputError(
                f"block {self._head['name']}: states {states} and updates {sorted(self._next)} must be the same names"
            )
        if self._limiter is not None:
            limited = [(p.name, p.size) for p in self._limiter.output]
            first = [(p.name, p.size) for p, _ in self._outputs[: len(limited)]]
            if first != limited:
                raise InputError(f"block {self._head['name']}: first outputs are {first}; valid: {limited}, as limited")
        flat = {k: ca.vertcat(*[ca.vec(s) for s in v]) if v else ca.SX(0, 1) for k, v in self._symbols.items()}
        z_next = ca.vertcat(*[self._next[n] for n in states]) if states else ca.SX(0, 1)
        u = ca.vertcat(*[ca.vec(v) for _, v in self._outputs])
        z_next, u = ca.cse([z_next, u])
        step = ca.Function(
            "step",
            [flat["state"], flat["measurement"], flat["reference"], flat["parameters"]],
            [ca.densify(z_next), ca.densify(u)],
            ["z", "y", "r", "p"],
            ["z_next", "u"],
        )
        return Block(
            **self._head,
            state=Layout(self._ports["state"]),
            measurement=Layout(self._ports["measurement"]),
            reference=Layout(self._ports["reference"]),
            parameters=Layout(self._ports["parameters"]),
            output=Layout(p for p, _ in self._outputs),
            step=step,
            limiter=self._limiter.step if self._limiter else None,
            limiter_state=self._limiter.state if self._limiter else Layout(),
        )
