"""Violins: distributions of several controllers beside each other, as in bodie2021's Figs. 11, 12, 16 and 17."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.patches import Patch

from aerotact.plots import COLOURS
from aerotact.ports import Array


def violins(axis: Any, series: Mapping[str, Mapping[str, Array]], groups: Sequence[str]) -> None:
    """One group a place on the x axis, in it one violin a controller, with its mean.

    Args:
        axis: of matplotlib; gets a legend.
        series: controller -> group -> samples, shape (n,).
        groups: in their order along x.
    """
    width = 0.8 / len(series)
    for number, (colour, samples) in enumerate(zip(COLOURS, series.values(), strict=False)):
        places = [i for i, group in enumerate(groups) if group in samples]
        if not places:
            continue
        shift = (number - (len(series) - 1) / 2) * width
        drawn = axis.violinplot(
            [samples[groups[i]] for i in places], np.array(places) + shift, widths=0.9 * width, showextrema=False
        )
        for body in drawn["bodies"]:
            body.set(facecolor=colour, edgecolor=colour, alpha=0.55)
        means = [float(np.mean(samples[groups[i]])) for i in places]
        axis.plot(np.array(places) + shift, means, ls="none", marker="o", ms=2.5, color="k")
    axis.axhline(0.0, color="k", lw=0.8, ls=":")
    axis.set_xticks(range(len(groups)), groups)
    names = zip(COLOURS, series, strict=False)
    axis.legend(handles=[Patch(color=colour, alpha=0.55, label=name) for colour, name in names], loc="upper left")
