"""Laws and estimators of robots with joints in generated C: equal to CasADi, and their examples do what they should."""

import subprocess
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from native import Native, evaluate

from aerotact.codegen.project import CProject, block_project
from aerotact.controller import Controller, Status
from aerotact.dynamics.model_of import model_of
from aerotact.dynamics.multibody import Multibody
from aerotact.estimation import estimators
from aerotact.laws import laws
from aerotact.robot import load_robot

MODELS = Path(__file__).parents[2] / "models"
RATE = 250.0
BLOCKS = ("suarez2020_base", "suarez2020_attitude", "suarez2020_position", "joint_estimator", "multibody_observer")


@pytest.fixture(scope="module", params=["dual_arm_long_reach", "dual_arm_standard"])
def arms(request: pytest.FixtureRequest) -> Multibody:
    model = model_of(load_robot(MODELS / request.param))
    assert isinstance(model, Multibody)
    return model


@pytest.mark.parametrize("name", BLOCKS)
def test_c_equals_casadi(arms: Multibody, name: str, native: Callable[[CProject], Native]) -> None:
    block = {**laws(), **estimators()}[name](arms, RATE)
    library, rng = native(block_project(block, arms)), np.random.default_rng(5)
    layouts = (block.state, block.measurement, block.reference, block.parameters)
    for _ in range(20):
        inputs = [v.default + rng.uniform(-0.1, 0.1, v.size) for v in layouts[:3]] + [block.parameters.default]
        found, wanted = library(f"{name}_law", block.step, inputs), evaluate(block.step, inputs)
        for a, b in zip(found, wanted, strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-12)


# The example of a law holds the model of all joints, 16 times over: minutes of compiling.
@pytest.mark.parametrize(
    "name",
    [
        pytest.param("suarez2020_base", marks=pytest.mark.slow),
        pytest.param("suarez2020_attitude", marks=pytest.mark.slow),
        "joint_estimator",
    ],
)
def test_example_runs(arms: Multibody, name: str, tmp_path: Path) -> None:
    """The generated example closes the loop with the model of all joints, by make, and returns 0."""
    block_project({**laws(), **estimators()}[name](arms, RATE), arms).write(tmp_path / name)
    done = subprocess.run(["make", "-C", str(tmp_path / name), "run"], capture_output=True, text=True, check=False)
    print(done.stdout[-300:])
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]


@pytest.mark.parametrize("name", ["suarez2020_base", "suarez2020_attitude"])
def test_hostile_inputs_give_finite_commands_within_limits(arms: Multibody, name: str) -> None:
    law, rng = Controller(block_project(laws()[name](arms, RATE), arms)), np.random.default_rng(6)
    groups = ("measurement", "reference", "parameters")
    sane = {group: law.flat(group).copy() for group in groups}
    sane["measurement"][:] = laws()[name](arms, RATE).measurement.default
    (low, high), (servo_low, servo_high) = arms.thrust_limits, arms.servo_limits
    poison = (np.nan, np.inf, -np.inf, 1e300, -1e9, 1e-320, 50.0)
    found: Counter[Status] = Counter()
    for step in range(3000):
        for group in groups:
            law.flat(group)[:] = sane[group]
        if step % 3:
            victim = law.flat(groups[rng.integers(3)])
            victim[rng.integers(victim.size)] = poison[rng.integers(len(poison))]
        if step % 3 == 1:
            law.flat("measurement")[:] += rng.normal(size=sane["measurement"].size)
        found[law.step()] += 1
        thrust, servo = law.output["thrust_cmd"], law.output["servo_cmd"]
        assert np.isfinite(thrust).all()
        assert np.isfinite(servo).all()
        assert ((thrust >= low - 1e-9) & (thrust <= high + 1e-9)).all()
        assert ((servo >= servo_low - 1e-9) & (servo <= servo_high + 1e-9)).all()
    print(name, dict(found))
    assert found[Status.BAD_INPUT] > 500
    assert found[Status.OK] >= 1000
