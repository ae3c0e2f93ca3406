"""Log: what happened in one run, column by column, kept as a Parquet file and a JSON summary."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from aerotact.exceptions import UnknownName
from aerotact.ports import Array, Port

LOG_RATE = 100.0  # Hz, of the file; metrics are taken at the physics' rate


@dataclass
class Log:
    """Signals of one run at the physics' rate; what changes more slowly is held.

    Attributes:
        period: s between rows.
        columns: signal -> array of shape (rows, size); `time` in s is one of them.
        ports: signal -> port with unit and frame.
        head: controller, robot, hashes, seed and what else tells the run; goes into both files.
        fault: why the run ended early, or empty.
        wall: s of wall clock that the run took.
        solve_times: s of each controller step; of nested controllers the outermost's.
        statuses: name -> count of what the controller returned; of nested ones the outermost.
        estimator_statuses: estimator -> name -> count of what it returned.
        every: rows from one step of the controller to the next; of nested ones the slowest's.
        inner_statuses: inner controller -> name -> count of what it returned.
    """

    period: float
    columns: dict[str, Array]
    ports: dict[str, Port]
    head: dict[str, Any]
    fault: str = ""
    wall: float = 0.0
    solve_times: Array = field(default_factory=lambda: np.zeros(0))
    statuses: dict[str, int] = field(default_factory=dict)
    estimator_statuses: dict[str, dict[str, int]] = field(default_factory=dict)
    every: int = 1
    inner_statuses: dict[str, dict[str, int]] = field(default_factory=dict)

    def __getitem__(self, signal: str) -> Array:
        if signal not in self.columns:
            raise UnknownName("signal", signal, self.columns, "the log")
        return self.columns[signal]

    def __contains__(self, signal: object) -> bool:
        return signal in self.columns

    @property
    def time(self) -> Array:
        """Times of the rows, s, shape (rows,)."""
        return self["time"][:, 0]

    def window(self, start: float, stop: float) -> slice:
        """Rows with start <= time < stop."""
        first, last = np.searchsorted(self.time, [start - 1e-9, stop - 1e-9])
        return slice(int(first), int(last))

    def stepped(self, rows: slice) -> Array:
        """Indices of those rows in which the controller stepped, so that none of its outputs is old."""
        indices = np.arange(len(self.time))[rows]
        return indices[indices % self.every == 0]

    def save(self, stem: Path, metrics: Mapping[str, Any], rate: float = LOG_RATE) -> Path:
        """Write `<stem>.parquet`, thinned to `rate` Hz in single precision, and `<stem>.json`; returns the former."""
        stem.parent.mkdir(parents=True, exist_ok=True)
        every = max(1, round(1.0 / (rate * self.period)))
        arrays, fields = [], []
        for name, values in self.columns.items():
            port = self.ports[name]
            labels = port.labels if values.shape[1] > 1 else ("",)
            for label, column in zip(labels, values[::every].T, strict=True):
                kind = pa.float64() if name == "time" else pa.float32()
                arrays.append(pa.array(column, type=kind))
                meta = {"signal": name, "unit": port.unit, "frame": port.frame, "doc": port.doc}
                fields.append(pa.field(f"{name}_{label}" if label else name, kind, metadata=meta))
        head = {"aerotact": json.dumps(self.head, sort_keys=True)}
        path = stem.with_name(f"{stem.name}.parquet")
        pq.write_table(pa.Table.from_arrays(arrays, schema=pa.schema(fields, metadata=head)), path, compression="zstd")
        summary = {
            **self.head,
            "fault": self.fault,
            "duration_s": float(self.time[-1]) if len(self.time) else 0.0,
            "wall_s": self.wall,
            "statuses": self.statuses,
            "estimator_statuses": self.estimator_statuses,
            "inner_statuses": self.inner_statuses,
            "metrics": dict(metrics),
        }
        text = json.dumps(summary, indent=2, sort_keys=True) + "\n"
        stem.with_name(f"{stem.name}.json").write_text(text, encoding="utf-8")
        return path


def read_columns(path: Path) -> dict[str, Array]:
    """Signals of a log file, joined again: signal -> array (rows, size)."""
    table = pq.read_table(path)
    joined: dict[str, list[Array]] = {}
    for field_ in table.schema:
        signal = field_.metadata[b"signal"].decode()
        joined.setdefault(signal, []).append(table[field_.name].to_numpy().astype(float))
    return {name: np.stack(columns, axis=1) for name, columns in joined.items()}
