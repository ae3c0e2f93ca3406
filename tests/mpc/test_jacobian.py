"""Jacobians by vertex elimination equal CasADi's, at fewer operations where a few forces move much."""

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest

from aerotact.mpc.jacobian import value_and_jacobian

EXPRESSIONS: dict[str, Callable[[Any, Any], Any]] = {
    "sums and products": lambda v, p: ca.vertcat(v[0] * v[1] * p[0] - v[2], (v[0] - p[1]) * (v[0] + v[3] * p[2])),
    "functions": lambda v, p: ca.vertcat(
        ca.sin(p[0] + v[0]) / (2 + ca.cos(v[1] * p[1] + 1)),
        ca.sqrt(4 + v[2] + p[1] ** 2),
        ca.exp(v[3]) ** 3,
    ),
    "selection": lambda v, p: ca.vertcat(
        ca.if_else(p[0] + v[0] > 0, v[1] * p[1], v[2] / p[1]), ca.fmin(p[2] + v[3], p[0]), ca.fabs(p[1] + v[0])
    ),
    "variables and constants": lambda v, p: ca.vertcat(v[0], 3, p[1], -v[3], v[1] + 2),
    "one value in two rows": lambda v, p: ca.vertcat(v[0] * p[0], v[0] * p[0], (v[0] * p[0] + v[1]) ** 2),
}


def _operations(*results: Any) -> int:
    function = ca.Function("f", ca.symvar(ca.veccat(*results)), ca.cse(list(results)))
    moves = (ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CONST)
    return sum(function.instruction_id(k) not in moves for k in range(function.n_instructions()))


@pytest.mark.parametrize("name", EXPRESSIONS)
def test_it_equals_casadis(name: str) -> None:
    v, p = ca.SX.sym("v", 4), ca.SX.sym("p", 3)
    expression = EXPRESSIONS[name](v, p)
    at_zero = ca.substitute([expression, ca.jacobian(expression, v)], [v], [ca.SX.zeros(4)])
    ours, theirs = ca.Function("f", [p], list(value_and_jacobian(expression, v))), ca.Function("f", [p], at_zero)
    for point in np.random.default_rng(5).normal(size=(10, 3)):
        for got, expected in zip(ours(point), theirs(point), strict=True):
            assert np.isfinite(expected.full()).all()
            np.testing.assert_allclose(got.full(), expected.full(), rtol=1e-13, atol=1e-13)


def test_what_does_not_depend_is_a_structural_zero() -> None:
    v, p = ca.SX.sym("v", 2), ca.SX.sym("p")
    _, jacobian = value_and_jacobian(ca.vertcat(p * v[0], p * p), v)
    assert jacobian.sparsity().nnz() == 1


def test_a_narrow_waist_costs_little() -> None:
    """Twelve variables act on eight results through two numbers."""
    v, p = ca.SX.sym("v", 12), ca.SX.sym("p", 12)
    waist = ca.vertcat(ca.dot(p, ca.sin(v + p)), ca.dot(p, ca.cos(v + p)))
    results = ca.vertcat(*[ca.exp(waist[0] * k) * ca.sin(waist[1] + k) for k in range(1, 9)])
    value, jacobian = value_and_jacobian(results, v)
    plain = ca.substitute(ca.jacobian(results, v), v, ca.SX.zeros(12))
    assert _operations(value, jacobian) < 0.8 * _operations(value, plain)
