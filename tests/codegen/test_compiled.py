"""The compiled C of every law, estimator and problem equals CasADi's evaluation of what it was written from."""

from collections.abc import Callable
from typing import Any

import numpy as np
from native import Native, evaluate
from sampling import sample

from aerotact.codegen.mpc_project import mpc_block
from aerotact.codegen.project import CProject, limit_function
from aerotact.mpc.ocp import Ocp
from aerotact.ports import Array, Block, Layout

TOLERANCE = 1e-10  # relative to each number
SAMPLES = 40


def _compare(native: Native, name: str, function: Any, inputs: Callable[[], list[Array]]) -> None:
    compared = 0
    for _ in range(SAMPLES):
        values = inputs()
        for got, expected in zip(native(name, function, values), evaluate(function, values), strict=True):
            np.testing.assert_allclose(got, expected, rtol=TOLERANCE, atol=1e-300, err_msg=name)
            compared += np.isfinite(expected).sum()
    assert compared > 0


def _positive(layout: Layout, rng: np.random.Generator) -> Array:
    """Parameters near their defaults, none below zero."""
    return np.abs(sample(layout, rng, spread=0.1))


def test_block_equals_casadi(block: Block, block_c: CProject, native: Callable[[CProject], Native]) -> None:
    rng = np.random.default_rng(3)
    library = native(block_c)

    def inputs() -> list[Array]:
        z, y, r = (sample(layout, rng) for layout in (block.state, block.measurement, block.reference))
        return [z, y, r, _positive(block.parameters, rng)]

    _compare(library, f"{block.name}_law", block.step, inputs)
    declared = [f"{block.name}_law"]
    if block.limiter is not None:
        size = block.limiter_state.size

        def commands() -> list[Array]:
            return [sample(block.limiter_state, rng), rng.uniform(-5.0, 30.0, size)]

        _compare(library, f"{block.name}_limit", limit_function(block.limiter), commands)
        declared.append(f"{block.name}_limit")
    assert library.declared == declared


def test_mpc_equals_casadi(ocp: Ocp, mpc_c: CProject, native: Callable[[CProject], Native]) -> None:
    rng = np.random.default_rng(4)
    model, targets, fallback = ocp.model, ocp.targets.block, ocp.fallback

    def block_inputs(block: Block) -> Callable[[], list[Array]]:
        return lambda: [
            sample(block.state, rng),
            sample(block.measurement, rng),
            sample(block.reference, rng),
            _positive(block.parameters, rng),
        ]

    def state() -> Array:
        return sample(model.state, rng)

    def control() -> Array:
        return rng.uniform(-80.0, 80.0, model.control.size)

    def stage() -> Array:
        return sample(ocp.targets.stage, rng)

    def weights() -> Array:
        return _positive(targets.parameters, rng)

    limiter = mpc_block(ocp).limiter
    tested: dict[str, tuple[Any, Callable[[], list[Array]]]] = {
        "prepare": (targets.step, block_inputs(targets)),
        "linearise_terminal": (ocp.linearise_terminal, lambda: [state(), stage(), weights()]),
        "retract": (ocp.retract, lambda: [state(), rng.normal(size=model.tangent_size)]),
        "difference": (ocp.difference, lambda: [state(), state()]),
        "rest": (ocp.rest, lambda: [state()]),
        "command": (ocp.command, lambda: [state(), control(), stage()]),
        "limit": (limit_function(limiter), lambda: [state()[13:], rng.uniform(-5.0, 30.0, model.rotors)]),
        "fallback": (fallback.step, block_inputs(fallback)),
    }
    library = native(mpc_c)
    assert library.declared == [f"{ocp.name}_{part}" for part in tested]
    for part, (function, inputs) in tested.items():
        _compare(library, f"{ocp.name}_{part}", function, inputs)
