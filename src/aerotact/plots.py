"""Plots: one look for every figure, drawn without a display."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure

mpl.rcParams.update(
    {
        "font.size": 9,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.grid": True,
        "grid.alpha": 0.25,
        "grid.linewidth": 0.6,
        "lines.linewidth": 1.3,
        "legend.frameon": False,
        "legend.fontsize": 8,
        "axes.titlesize": 9,
        "axes.titlelocation": "left",
    }
)
COLOURS = ("#0b6e99", "#d1495b", "#5c8001", "#8e5ea2", "#e07a1f", "#444444")


def panels(rows: int, columns: int, title: str, height: float = 2.5, width: float = 4.2) -> tuple[Figure, Any]:
    """A figure and its axes as an array (rows, columns); sizes in inches a panel."""
    figure = Figure(figsize=(width * columns, height * rows + 0.5), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False)
    figure.suptitle(title, x=0.01, ha="left", fontsize=11)
    return figure, axes


def save(figure: Figure, file: Path) -> Path:
    """Write a PNG at 150 dots an inch."""
    file.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(file, dpi=150)
    return file


def label(axis: Any, title: str, y: str, x: str = "time in s", legend: Sequence[Any] | None = None) -> None:
    """Title, axis labels with units, and a legend if it has entries."""
    axis.set_title(title)
    axis.set_xlabel(x)
    axis.set_ylabel(y)
    handles = legend if legend is not None else axis.get_legend_handles_labels()[0]
    if handles:
        axis.legend(handles=handles, loc="upper right")
