"""100,000 hostile steps of everything that is generated, optimised and again under the address and undefined-behaviour
sanitisers. What must hold in every step stands in hostile.c.jinja."""

from pathlib import Path
from typing import Any

import jinja2
import numpy as np
import pytest
from holding import hold
from native import PLAIN, SANITIZED, run

from aerotact.codegen.functions import number
from aerotact.codegen.mpc_project import mpc_block, mpc_project
from aerotact.codegen.precision import in_single_precision
from aerotact.codegen.project import CProject, block_project
from aerotact.controller import Status
from aerotact.dynamics.model import Model
from aerotact.laws import laws
from aerotact.mpc.ocp import Ocp, load_ocp
from aerotact.ports import Block, Layout

STEPS = 100_000
PHASE = 5_000  # hostile steps between two proofs of recovery
# Shares of the kinds of input, in the order of the C file: plausible, not finite, absurd, tiny, quaternion, jump,
# parameter, no input, no output, random bits.
EVEN = (0.1, 0.15, 0.1, 0.1, 0.1, 0.15, 0.1, 0.05, 0.05, 0.1)
MOSTLY_REFUSED = (0.001, 0.5, 0.3, 0.001, 0.02, 0.001, 0.001, 0.07, 0.001, 0.105)


def _fly(
    folder: Path,
    block: Block,
    model: Model,
    project: CProject,
    share: tuple[float, ...],
    flags: tuple[str, ...],
    steps: int = STEPS,
) -> dict[Status, int]:
    """How often each status was returned."""
    mpc, single = project.manifest.get("ocp") is not None, project.manifest["precision"] == "single"
    harness = _harness(block, model, share, steps, mpc=mpc, single=single)
    if single:
        harness = in_single_precision(harness)
    folder.mkdir(exist_ok=True)
    statuses, kinds = ([int(n) for n in line.split()] for line in run(folder, project, harness, flags).splitlines())
    assert sum(statuses) == sum(kinds) >= steps
    assert all(kinds)
    print(f"{block.name} of {model.robot.name}: {dict(zip(Status, statuses, strict=True))}")
    return dict(zip(Status, statuses, strict=True))


def _harness(block: Block, model: Model, share: tuple[float, ...], steps: int, *, mpc: bool, single: bool) -> str:
    template = jinja2.Environment(
        undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True
    ).from_string((Path(__file__).parent / "hostile.c.jinja").read_text())
    limited = block.limiter is not None
    # In the order of the commands: thrusts, tilts.
    lower, upper = (np.concatenate(v) for v in zip(model.thrust_limits, model.tilt_limits, strict=True))
    rate_lower, rate_upper = (
        np.concatenate(v) for v in zip(model.thrust_rate_limits, model.tilt_rate_limits, strict=True)
    )
    limits = {
        **{"lower": lower, "upper": upper, "rate_lower": rate_lower, "rate_upper": rate_upper},
        "lag": np.concatenate([model.time_constants, model.tilt_time_constants]),
        "hover": model.commands.default,
    }
    modelled = [*range(model.tilts, model.actuators.size), *range(model.tilts)]
    assert sum(share) == pytest.approx(1.0)
    at_hover = {"p_WB": model.state.unpack(model.hover_state)["p_WB"]}
    measurement = block.measurement.with_defaults({k: v for k, v in at_hover.items() if k in block.measurement})
    return template.render(
        name=block.name,
        NAME=block.name.upper(),
        groups=[_group(layout) for layout in (measurement, block.reference, block.parameters)],
        commands=model.commands.size if limited else 0,
        modelled=modelled,
        limits={key: [number(float(v)) for v in values] for key, values in limits.items()},
        share=[number(s) for s in share],
        seed=20190815,
        steps=steps,
        phase=PHASE,
        state_size=block.state.size,
        output_size=block.output.size,
        limited=limited,
        limiter_size=block.limiter_state.size,
        mpc=mpc,
        usable="1e-3" if single else "1e-4",
    )


def _group(layout: Layout) -> dict[str, Any]:
    fields = [
        (
            *(layout.slice(p.name).start, p.size, p.nodes, int(p.kind == "quaternion"), int(p.kind == "flag")),
            *(number(max(p.lower, -p.limit)), number(p.limit)),
        )
        for p in layout
    ]
    return {"fields": fields, "size": layout.size, "base": [number(v) for v in layout.default.tolist()]}


@pytest.mark.parametrize("flags", [PLAIN, SANITIZED], ids=["optimised", "sanitised"])
def test_block_keeps_its_promises(
    tmp_path: Path, block: Block, block_c: CProject, model: Model, flags: tuple[str, ...]
) -> None:
    counts = _fly(tmp_path, block, model, block_c, EVEN, flags)
    assert counts[Status.OK] > STEPS // 10
    assert counts[Status.BAD_INPUT] > STEPS // 3
    assert counts[Status.MAX_ITERATIONS] == counts[Status.INFEASIBLE] == counts[Status.DEADLINE] == 0


def test_law_of_tilting_rotors_keeps_its_promises(tmp_path: Path, tilting: Model) -> None:
    block = hold(tilting, 500.0)
    counts = _fly(tmp_path, block, tilting, block_project(block, tilting), EVEN, PLAIN)
    assert counts[Status.OK] > STEPS // 10
    assert counts[Status.BAD_INPUT] > STEPS // 3


def test_mpc_keeps_its_promises(tmp_path: Path, hexarotor_ocp: Ocp) -> None:
    project = mpc_project(hexarotor_ocp)
    counts = _fly(tmp_path, mpc_block(hexarotor_ocp), hexarotor_ocp.model, project, MOSTLY_REFUSED, PLAIN)
    _check_mpc(counts)


def test_mpc_of_a_short_horizon_keeps_its_promises_under_sanitisers(
    tmp_path: Path, models: dict[str, Model], short_problem: Path
) -> None:
    model = models["octorotor"]
    ocp = load_ocp(short_problem, model)
    counts = _fly(tmp_path, mpc_block(ocp), model, mpc_project(ocp), MOSTLY_REFUSED, SANITIZED)
    _check_mpc(counts)


def test_mpc_of_a_short_horizon_by_osqp_keeps_its_promises(
    tmp_path: Path, models: dict[str, Model], short_problem: Path
) -> None:
    path = tmp_path / "short_osqp.toml"
    path.write_text(short_problem.read_text().replace('backend = "aerotact"', 'backend = "osqp"'))
    model = models["octorotor"]
    ocp, steps = load_ocp(path, model), STEPS // 5
    _check_mpc(_fly(tmp_path, mpc_block(ocp), model, mpc_project(ocp), MOSTLY_REFUSED, PLAIN, steps), steps)


def test_law_in_single_precision_keeps_its_promises(tmp_path: Path, hexarotor: Model) -> None:
    block = laws()["ryll2019_admittance"](hexarotor, 500.0)
    project = block_project(block, hexarotor, "single")
    counts = _fly(tmp_path, block, hexarotor, project, EVEN, SANITIZED)
    assert counts[Status.OK] > STEPS // 10
    assert counts[Status.BAD_INPUT] > STEPS // 3


def test_mpc_in_single_precision_keeps_its_promises(
    tmp_path: Path, hexarotor_ocp: Ocp, models: dict[str, Model], short_problem: Path
) -> None:
    project = mpc_project(hexarotor_ocp, "single")
    _check_mpc(_fly(tmp_path / "long", mpc_block(hexarotor_ocp), hexarotor_ocp.model, project, MOSTLY_REFUSED, PLAIN))
    model = models["octorotor"]
    ocp, steps = load_ocp(short_problem, model), STEPS // 5
    project = mpc_project(ocp, "single")
    _check_mpc(_fly(tmp_path / "short", mpc_block(ocp), model, project, MOSTLY_REFUSED, SANITIZED, steps), steps)


def _check_mpc(counts: dict[Status, int], steps: int = STEPS) -> None:
    assert counts[Status.OK] > steps // 100
    assert counts[Status.BAD_INPUT] > steps // 2
    assert counts[Status.NUMERICAL] > 0 or steps < STEPS  # rare: the short runs may miss it
    assert counts[Status.DEADLINE] == 0
