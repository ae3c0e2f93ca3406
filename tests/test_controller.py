"""Controller: views of the C structs, defaults, statuses, and nothing shared between two of them."""

import numpy as np
import pytest
from native import evaluate

from aerotact.codegen.project import CProject
from aerotact.controller import Controller, Status
from aerotact.exceptions import InputError, UnknownName
from aerotact.mpc.ocp import Ocp
from aerotact.ports import Block


@pytest.fixture
def mpc(mpc_c: CProject, ocp: Ocp) -> Controller:
    controller = Controller(mpc_c)
    controller.measurement["p_WB"][:] = ocp.model.hover_state[:3]
    return controller


def test_defaults_are_those_of_the_block(block: Block, block_c: CProject) -> None:
    controller = Controller(block_c)
    np.testing.assert_array_equal(controller.flat("parameters")[: block.parameters.size], block.parameters.default)
    np.testing.assert_array_equal(controller.flat("reference")[: block.reference.size], block.reference.default)
    assert controller.rate == block.rate
    assert controller.name == block.name
    assert controller.workspace_bytes > 8 * (block.state.size + block.output.size)


def test_step_equals_casadi_through_the_named_views(block: Block, block_c: CProject) -> None:
    controller = Controller(block_c)
    for name, value in block.measurement.unpack(block.measurement.default).items():
        controller.measurement[name][:] = value
    assert controller.step() is Status.OK
    defaults = [b.default for b in (block.state, block.measurement, block.reference, block.parameters)]
    expected = block.output.unpack(evaluate(block.step, defaults)[1])
    assert list(controller.output) == [p.name for p in block.output]
    for name, value in expected.items():
        if name != "thrust_cmd":  # passes the limiter
            np.testing.assert_allclose(controller.output[name], value, rtol=1e-10, atol=1e-12)


def test_views_are_the_memory_of_the_structs(mpc: Controller) -> None:
    mpc.reference["p_WE_d"][3, 2] = 7.0
    assert (mpc.flat("reference") == 7.0).sum() == 1
    mpc.flat("measurement")[0] = 5.0
    assert mpc.measurement["p_WB"][0] == 5.0


def test_memory_is_aligned_for_doubles(mpc: Controller) -> None:
    for group in ("measurement", "reference", "parameters", "output"):
        assert mpc.flat(group).ctypes.data % 8 == 0
        assert mpc.flat(group).flags.c_contiguous


def test_two_controllers_share_a_library_but_no_state(mpc_c: CProject, ocp: Ocp) -> None:
    first, second = Controller(mpc_c), Controller(mpc_c)
    assert first.library == second.library
    for controller in (first, second):
        controller.measurement["p_WB"][:] = ocp.model.hover_state[:3]
    first.parameters["M_EP"][:] = 0.0
    assert first.step() is Status.NUMERICAL
    assert second.step() is Status.OK
    assert first.statistics.status is Status.NUMERICAL
    assert (first.statistics.failures, second.statistics.failures) == (1, 0)


def test_reset_forgets_the_past_and_keeps_the_parameters(mpc: Controller) -> None:
    mpc.set_parameters({"weight_rate": 2e-5})
    mpc.measurement["f_tool_W"][:] = [2.0, 0.0, 0.0]
    first = [mpc.step(), mpc.output["thrust_cmd"].copy(), mpc.output["p_WE_r"].copy()]
    for _ in range(20):
        mpc.step()
    assert not np.array_equal(mpc.output["p_WE_r"], first[2])
    mpc.reset()
    assert mpc.parameters["weight_rate"][0] == 2e-5
    assert mpc.step() is first[0]
    np.testing.assert_array_equal(mpc.output["thrust_cmd"], first[1])
    np.testing.assert_array_equal(mpc.output["p_WE_r"], first[2])


def test_set_parameters_fills_ports_and_refuses_what_does_not_fit(mpc: Controller) -> None:
    mpc.set_parameters({"K_EP": 50.0, "M_ER": [0.1, 0.2, 0.3]})
    np.testing.assert_array_equal(mpc.parameters["K_EP"], [50.0, 50.0, 50.0])
    np.testing.assert_array_equal(mpc.parameters["M_ER"], [0.1, 0.2, 0.3])
    before = mpc.flat("parameters").copy()
    with pytest.raises(UnknownName, match=r"unknown port 'K'; valid: .*K_EP"):
        mpc.set_parameters({"D_EP": 1.0, "K": 1.0})
    with pytest.raises(InputError, match="port K_EP: 2 numbers given; valid: 3"):
        mpc.set_parameters({"D_EP": 1.0, "K_EP": [1.0, 2.0]})
    np.testing.assert_array_equal(mpc.flat("parameters"), before)


def test_inputs_are_not_changed_by_a_step(mpc: Controller) -> None:
    mpc.measurement["q_WB"][:] = [1.05, 0.0, 0.0, 0.0]  # is normalised inside
    before = {g: mpc.flat(g).copy() for g in ("measurement", "reference", "parameters")}
    assert mpc.step() is Status.OK
    for group, value in before.items():
        np.testing.assert_array_equal(mpc.flat(group), value)


def test_slightly_long_quaternion_gives_the_command_of_its_rotation(mpc: Controller) -> None:
    mpc.measurement["q_WB"][:] = [0.8, 0.0, 0.0, 0.6]
    mpc.step()
    command = mpc.output["thrust_cmd"].copy()
    mpc.reset()
    mpc.measurement["q_WB"][:] *= 1.09
    assert mpc.step() is Status.OK
    np.testing.assert_allclose(mpc.output["thrust_cmd"], command, rtol=1e-9)
    for length in (0.89, 1.11):
        mpc.measurement["q_WB"][:] = [length, 0.0, 0.0, 0.0]
        assert mpc.step() is Status.BAD_INPUT


def test_statistics_describe_the_last_solve(mpc: Controller) -> None:
    mpc.measurement["p_WB"][0] += 0.5
    assert mpc.step() is Status.OK
    statistics = mpc.statistics
    assert statistics.status is Status.OK
    assert statistics.qp_iterations > 5
    assert 0.0 <= statistics.qp_feasibility < 1e-6
    mpc.measurement["p_WB"][0] = np.nan
    assert mpc.step() is Status.BAD_INPUT
    assert mpc.statistics.qp_iterations == 0
    assert mpc.statistics.failures == 1
