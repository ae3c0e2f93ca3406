"""Jacobians of few operations: vertex elimination on the graph of an expression.

The derivative of every operation is an edge of the graph; an inner vertex is eliminated by joining each edge into it
with each edge out of it, which costs (edges in) * (edges out) multiplications (Griewank and Walther, Evaluating
Derivatives, chapter 9). What is left leads from variables to results. Vertices with few edges go first, the others from
the results back: of the orders tried the cheapest for a Runge-Kutta step, where many actuators act through few forces.
"""

import heapq
from typing import Any

import casadi as ca

_FEW = 4  # multiplications; vertices that cost no more go first

Vertex = tuple[str, int]
"""Kind ("variable", "inner" or "result") and number."""


def value_and_jacobian(expression: Any, variables: Any) -> tuple[Any, Any]:
    """Value and Jacobian of a column where all variables are zero.

    Args:
        expression: SX, shape (m, 1), of the variables and anything else.
        variables: SX symbols, shape (n, 1).

    Returns:
        The value (m, 1), dense, and the Jacobian (m, n) with its structural zeros.
    """
    graph = _Graph()
    value = graph.add(expression, variables)
    graph.eliminate()
    jacobian = ca.SX(expression.numel(), variables.numel())
    for row in range(expression.numel()):
        for (_, column), entry in graph.into["result", row].items():
            jacobian[row, column] = entry
    return value, jacobian


class _Graph:
    """Operations that depend on the variables; `into` and `out` are the edges at each vertex, with derivatives."""

    def __init__(self) -> None:
        self.into: dict[Vertex, dict[Vertex, Any]] = {}
        self.out: dict[Vertex, set[Vertex]] = {}

    def add(self, expression: Any, variables: Any) -> Any:
        """Build the graph; returns the expression's value."""
        own = {v.element_hash() for v in ca.vertsplit(variables)}
        others = [s for s in ca.symvar(expression) if s.element_hash() not in own]
        function = ca.Function("f", [variables, ca.vertcat(*others)], [ca.cse(expression)])
        for number in range(variables.numel()):
            self._place(("variable", number))
        register: dict[int, tuple[Vertex | None, Any]] = {}
        value = ca.SX.zeros(expression.numel())
        for k in range(function.n_instructions()):
            op, inputs, outputs = (getattr(function, f"instruction_{part}")(k) for part in ("id", "input", "output"))
            if op == ca.OP_CONST:
                register[outputs[0]] = None, ca.SX(function.instruction_constant(k))
            elif op == ca.OP_INPUT:
                variable = inputs[0] == 0
                register[outputs[0]] = (("variable", inputs[1]), ca.SX(0)) if variable else (None, others[inputs[1]])
            elif op == ca.OP_OUTPUT:
                vertex, value[outputs[1]] = register[inputs[0]]
                self._place(("result", outputs[1]))
                if vertex is not None:
                    self._join(vertex, ("result", outputs[1]), ca.SX(1))
            else:
                register[outputs[0]] = self._operate(("inner", k), op, [register[i] for i in inputs])
        return value

    def eliminate(self) -> None:
        """Leave edges from variables to results only."""
        waiting = {vertex for vertex in self.into if vertex[0] == "inner"}
        heap = [self._priority(vertex) for vertex in waiting]
        heapq.heapify(heap)
        while heap:
            first = heapq.heappop(heap)
            vertex = first[-1]
            if vertex not in waiting or first != self._priority(vertex):
                continue  # done, or its edges have changed since
            waiting.remove(vertex)
            sources, targets = self.into.pop(vertex), self.out.pop(vertex)
            for target in sorted(targets):
                outer = self.into[target].pop(vertex)
                for source, inner in sources.items():
                    self._join(source, target, inner * outer)
            for source in sources:
                self.out[source].discard(vertex)
            for changed in (*sources, *targets):
                if changed in waiting:
                    heapq.heappush(heap, self._priority(changed))

    def _priority(self, vertex: Vertex) -> tuple[int, int, Vertex]:
        cost = len(self.into[vertex]) * len(self.out[vertex])
        return min(cost, _FEW + 1), -vertex[1], vertex

    def _operate(
        self, vertex: Vertex, op: int, arguments: list[tuple[Vertex | None, Any]]
    ) -> tuple[Vertex | None, Any]:
        """Result of an operation: its vertex, if it depends on the variables, and its value."""
        values = [value for _, value in arguments]
        result = _apply(op, values)
        if all(source is None for source, _ in arguments):
            return None, result
        self._place(vertex)
        for (source, _), derivative in zip(arguments, _derivatives(op, values), strict=True):
            if source is not None:
                self._join(source, vertex, derivative)
        return vertex, result

    def _place(self, vertex: Vertex) -> None:
        self.into[vertex], self.out[vertex] = {}, set()

    def _join(self, source: Vertex, target: Vertex, derivative: Any) -> None:
        """Add an edge, or to the one that is there."""
        if derivative.is_zero():
            return
        edges = self.into[target]
        edges[source] = edges[source] + derivative if source in edges else derivative
        self.out[source].add(target)


def _apply(op: int, values: list[Any]) -> Any:
    return ca.SX.binary(op, *values) if len(values) == 2 else ca.SX.unary(op, *values)


def _derivatives(op: int, values: list[Any]) -> list[Any]:
    """Derivatives of an operation by its arguments."""
    if op == ca.OP_MUL:
        return [values[1], values[0]]
    if op in (ca.OP_ADD, ca.OP_SUB):
        return [ca.SX(1), ca.SX(1 if op == ca.OP_ADD else -1)]
    symbols = [ca.SX.sym("s") for _ in values]
    derivatives = [ca.jacobian(_apply(op, symbols), s) for s in symbols]
    return ca.substitute(derivatives, symbols, values)
