"""Ports, layouts and blocks: packing, defaults, and what is refused."""

import casadi as ca
import numpy as np
import pytest

from aerotact.exceptions import InputError, UnknownName
from aerotact.ports import BlockBuilder, Layout, Port

LAYOUT = Layout(
    [
        Port("mass", 1, "kg", default=(2.0,)),
        Port("q_WB", 4, "1", "W", kind="quaternion"),
        Port("path", 3, "m", "W", nodes=2, default=(1.0, 2.0, 3.0)),
    ]
)


def test_default_of_a_quaternion_is_no_rotation_and_of_a_preview_the_same_at_each_node() -> None:
    np.testing.assert_array_equal(LAYOUT.default, [2, 1, 0, 0, 0, 1, 2, 3, 1, 2, 3])
    assert LAYOUT.size == 11
    assert Layout().default.shape == (0,)


def test_default_of_another_size_is_refused() -> None:
    with pytest.raises(InputError, match="port p: default has 2 numbers; valid: 3"):
        Port("p", 3, "m", default=(1.0, 2.0))


@pytest.mark.parametrize(
    ("port", "labels"),
    [
        (Port("q", 4, "1", kind="quaternion"), ("w", "x", "y", "z")),
        (Port("p", 3, "m"), ("x", "y", "z")),
        (Port("thrust", 2, "N"), ("0", "1")),
    ],
)
def test_labels(port: Port, labels: tuple[str, ...]) -> None:
    assert port.labels == labels


def test_pack_and_unpack_are_inverse_and_keep_nodes_in_rows() -> None:
    flat = np.arange(11.0)
    named = LAYOUT.unpack(flat)
    np.testing.assert_array_equal(named["path"], [[5, 6, 7], [8, 9, 10]])
    np.testing.assert_array_equal(LAYOUT.pack(named), flat)


def test_unpack_gives_views() -> None:
    flat = LAYOUT.default
    LAYOUT.unpack(flat)["path"][1, 2] = 9.0
    assert flat[10] == 9.0


def test_split_has_one_column_a_node() -> None:
    x = ca.SX.sym("x", LAYOUT.size)
    path = ca.Function("f", [x], [LAYOUT.split(x)["path"]])(np.arange(11.0)).full()
    np.testing.assert_array_equal(path, [[5, 8], [6, 9], [7, 10]])


def test_one_number_fills_a_vector_but_no_quaternion() -> None:
    np.testing.assert_array_equal(LAYOUT.pack({"path": 7.0})[5:], np.full(6, 7.0))
    with pytest.raises(InputError, match="port q_WB: 1 numbers given; valid: 4"):
        LAYOUT.pack({"q_WB": 1.0})


def test_wrong_sizes_and_names_are_refused() -> None:
    with pytest.raises(InputError, match=r"port path: 3 numbers given; valid: 6 \(m\)"):
        LAYOUT.pack({"path": [1.0, 2.0, 3.0]})
    with pytest.raises(UnknownName, match="unknown port 'weight'; valid: mass, path, q_WB"):
        LAYOUT.pack({"weight": 1.0})
    with pytest.raises(UnknownName, match="unknown port 'weight'"):
        LAYOUT["weight"]
    with pytest.raises(InputError, match="port mass stands twice"):
        Layout([Port("mass", 1, "kg"), Port("mass", 1, "kg")])


def test_other_defaults_leave_the_layout_as_it_was() -> None:
    changed = LAYOUT.with_defaults({"path": np.tile([4.0, 5.0, 6.0], 2)})
    np.testing.assert_array_equal(changed.default[5:], [4, 5, 6, 4, 5, 6])
    np.testing.assert_array_equal(LAYOUT.default[5:], [1, 2, 3, 1, 2, 3])


def test_membership_and_order() -> None:
    assert [p.name for p in LAYOUT] == ["mass", "q_WB", "path"]
    assert len(LAYOUT) == 3
    assert "path" in LAYOUT
    assert "weight" not in LAYOUT


def _builder() -> BlockBuilder:
    b = BlockBuilder("filter", "aerotact", 100.0, "first-order filter")
    low = b.state("low", 2, "N")
    b.update("low", low + b.parameter("share", 1, "1", 0.25) * (b.measurement("force", 2, "N") - low))
    b.output("smooth", low, "N")
    return b


def test_block_is_a_pure_function_of_its_ports() -> None:
    block = _builder().build()
    z_next, u = (v.full().ravel() for v in block.step([1.0, 2.0], [5.0, 2.0], [], block.parameters.default))
    np.testing.assert_array_equal(z_next, [2.0, 2.0])
    np.testing.assert_array_equal(u, [1.0, 2.0])
    assert block.limiter is None
    assert block.limiter_state.size == 0


def test_parameters_of_a_block_can_be_replaced() -> None:
    block = _builder().build()
    assert block.with_parameters({"share": 0.5}).parameters.default == [0.5]
    assert block.parameters.default == [0.25]


def test_state_without_update_and_update_without_state_are_refused() -> None:
    forgotten = _builder()
    forgotten.state("extra", 1, "1")
    with pytest.raises(InputError, match=r"block filter: states \['low', 'extra'\] and updates \['low'\]"):
        forgotten.build()
    invented = _builder()
    invented.update("extra", 1)
    with pytest.raises(InputError, match=r"updates \['extra', 'low'\] must be the same names"):
        invented.build()


def test_preview_output_goes_node_by_node() -> None:
    b = BlockBuilder("turn", "aerotact", 100.0, "")
    b.output("out", 2 * b.reference("path", 3, "m", nodes=2), "m")
    block = b.build()
    assert (block.output["out"].size, block.output["out"].nodes) == (3, 2)
    u = block.step([], [], np.arange(6.0), [])[1].full().ravel()
    np.testing.assert_array_equal(block.output.unpack(u)["out"], [[0, 2, 4], [6, 8, 10]])
