"""Constants of a compiled project arrive as they were written: compilers have been seen to spoil them."""

import casadi as ca
import numpy as np

from aerotact.codegen.project import block_project
from aerotact.controller import Controller, Status
from aerotact.dynamics.model import Model
from aerotact.ports import BlockBuilder

# Six equal numbers with zeros behind them: GCC 12 for AVX-512 turned the zeros into that number.
PATTERN = (8.175,) * 6 + (0.0,) * 6 + (1.0,)


def test_defaults_arrive_as_written(hexarotor: Model) -> None:
    b = BlockBuilder("constants", "example", 500.0, "constants of a pattern that has been spoilt")
    wanted = b.reference("wanted", 13, "1", default=PATTERN)
    gain = b.parameter("gain", 13, "1", PATTERN)
    kept = b.state("kept", 13, "1", default=PATTERN)
    heard = b.measurement("w_B", 3, "rad/s")
    b.update("kept", kept)
    b.output("first", ca.vertcat(kept, wanted, gain) + 0 * heard[0], "1", default=PATTERN * 3)
    controller = Controller(block_project(b.build(), hexarotor))
    np.testing.assert_array_equal(controller.reference["wanted"], PATTERN)
    np.testing.assert_array_equal(controller.parameters["gain"], PATTERN)
    controller.measurement["w_B"][:] = np.nan  # the stand-in is the default
    assert controller.step() is Status.BAD_INPUT
    np.testing.assert_array_equal(controller.output["first"], PATTERN * 3)
    controller.measurement["w_B"][:] = 0.0
    assert controller.step() is Status.OK
    np.testing.assert_array_equal(controller.output["first"], PATTERN * 3)
