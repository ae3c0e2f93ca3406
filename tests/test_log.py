"""The log: what is written can be read again with its units, thinned but not changed."""

import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from aerotact.exceptions import UnknownName
from aerotact.log import Log, read_columns
from aerotact.ports import Port

ROWS = 1001
PORTS = (
    Port("time", 1, "s"),
    Port("q_WB", 4, "1", "W", kind="quaternion"),
    Port("v_WB", 3, "m/s", "W", "velocity of the base"),
    Port("thrust", 6, "N"),
    Port("pressure_2", 1, "Pa"),
    Port("radius_x", 1, "1"),
    Port("gain", 3, "1"),
)


@pytest.fixture
def log() -> Log:
    rng = np.random.default_rng(3)
    columns = {p.name: rng.normal(size=(ROWS, p.size)) for p in PORTS}
    columns["time"] = np.arange(ROWS)[:, None] * 1e-3
    head = {"controller": "law", "seed": 3, "robot": "tilt_hex"}
    statuses, estimators = {"OK": 9, "BAD_INPUT": 1}, {"state_estimator": {"OK": 10}}
    return Log(
        1e-3,
        columns,
        {p.name: p for p in PORTS},
        head,
        "plant stopped",
        2.5,
        np.zeros(10),
        statuses,
        estimators,
        every=10,
    )


def test_round_trip(log: Log, tmp_path: Path) -> None:
    file = log.save(tmp_path / "new" / "run.5", {})
    assert file == tmp_path / "new" / "run.5.parquet"
    found = read_columns(file)
    assert list(found) == [p.name for p in PORTS]
    np.testing.assert_array_equal(found["time"], log["time"][::10])
    for name in set(found) - {"time"}:
        np.testing.assert_array_equal(found[name], log[name][::10].astype(np.float32))


@pytest.mark.parametrize(("rate", "every"), [(1000.0, 1), (500.0, 2), (100.0, 10), (1.0, 1000), (1e6, 1)])
def test_thinning_keeps_every_nth_row(log: Log, tmp_path: Path, rate: float, every: int) -> None:
    found = read_columns(log.save(tmp_path / "run", {}, rate))
    np.testing.assert_array_equal(found["time"], log["time"][::every])


def test_columns_carry_unit_frame_and_doc(log: Log, tmp_path: Path) -> None:
    schema = pq.read_schema(log.save(tmp_path / "run", {}))
    assert schema.names == [
        "time",
        *(f"q_WB_{c}" for c in "wxyz"),
        *(f"v_WB_{c}" for c in "xyz"),
        *(f"thrust_{i}" for i in range(6)),
        "pressure_2",
        "radius_x",
        *(f"gain_{c}" for c in "xyz"),
    ]
    velocity = schema.field("v_WB_y").metadata
    assert velocity[b"unit"] == b"m/s"
    assert velocity[b"frame"] == b"W"
    assert velocity[b"doc"] == b"velocity of the base"
    assert json.loads(schema.metadata[b"aerotact"])["controller"] == "law"


def test_summary(log: Log, tmp_path: Path) -> None:
    log.save(tmp_path / "run", {"peak_force": 1.5, "airborne": None})
    assert json.loads((tmp_path / "run.json").read_text()) == {
        "controller": "law",
        "seed": 3,
        "robot": "tilt_hex",
        "fault": "plant stopped",
        "duration_s": 1.0,
        "wall_s": 2.5,
        "statuses": {"OK": 9, "BAD_INPUT": 1},
        "estimator_statuses": {"state_estimator": {"OK": 10}},
        "inner_statuses": {},
        "metrics": {"peak_force": 1.5, "airborne": None},
    }


def test_log_of_no_row_is_saved(log: Log, tmp_path: Path) -> None:
    log.columns = {name: values[:0] for name, values in log.columns.items()}
    found = read_columns(log.save(tmp_path / "run", {}))
    assert found["v_WB"].shape == (0, 3)
    assert json.loads((tmp_path / "run.json").read_text())["duration_s"] == 0.0


def test_window_is_half_open(log: Log) -> None:
    assert log.window(0.1, 0.3) == slice(100, 300)
    assert log.window(0.9995, 7.0) == slice(1000, 1001)
    assert log.window(2.0, 3.0) == slice(1001, 1001)


def test_rows_in_which_the_controller_stepped(log: Log) -> None:
    np.testing.assert_array_equal(log.stepped(slice(15, 42)), [20, 30, 40])
    np.testing.assert_array_equal(log.stepped(slice(40, 41)), [40])
    assert log.stepped(slice(41, 50)).size == 0


def test_unknown_signal_is_named(log: Log) -> None:
    assert "thrust" in log
    assert "thrust_cmd" not in log
    with pytest.raises(UnknownName, match=r"thrust_cmd.*valid: .*pressure_2"):
        log["thrust_cmd"]
