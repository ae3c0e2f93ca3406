"""Report: a comparison as one page that carries its figures in itself."""

import base64
import html
from collections.abc import Sequence
from pathlib import Path

from aerotact import __version__
from aerotact.compare import Comparison, comparison_rows
from aerotact.experiments.experiment import Experiment

_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; color: #222; max-width: 1100px; margin: 2em auto; padding: 0 1em; }
h1 { font-size: 1.4em; } h2 { font-size: 1.1em; margin-top: 2em; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { padding: .25em .8em; border-bottom: 1px solid #ddd; text-align: right; }
th:first-child, td:first-child { text-align: left; } tr:hover { background: #f6f8fa; }
img { max-width: 100%; max-height: 32em; } dt { font-weight: 600; } .fault { color: #b00020; }
"""


def write_report(comparison: Comparison, experiment: Experiment, figures: Sequence[Path], file: Path) -> Path:
    """Write the page.

    Args:
        comparison: what was found.
        experiment: whose controllers, cases and paper numbers are explained.
        figures: PNG files, shown in order.
        file: the HTML file.
    """
    header, rows = comparison_rows(comparison)
    text = html.escape
    head = "".join(f"<th>{text(h)}</th>" for h in header)
    body = "".join("<tr>" + "".join(f"<td>{text(c)}</td>" for c in row) + "</tr>" for row in rows)
    specs = "".join(
        f"<dt>{text(label)}</dt><dd><code>{text(s.block)}</code>: {text(s.doc)}</dd>"
        for label, s in experiment.controllers.items()
    )
    cases = "".join(f"<dt>{text(c.name)}</dt><dd>{text(c.doc)}</dd>" for c in experiment.cases)
    places = "".join(
        f"<li><code>{text(n)}</code> = {p.value:g} {text(p.unit)}: {text(p.place)}</li>"
        for n, p in experiment.paper.items()
    )
    faults = "".join(
        f'<p class="fault">Ended early, not in the means: {text(fault)}</p>' for fault in comparison.faults
    )
    pictures = "".join(f'<p><img alt="{text(f.stem)}" src="data:image/png;base64,{_encode(f)}"></p>' for f in figures)
    seeds = ", ".join(map(str, comparison.seeds))
    shown = f"<h2>Figures: seed {comparison.seeds[0]}</h2>{pictures}" if pictures else ""
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(
        f"<!doctype html><html lang=en><meta charset=utf-8><title>{text(comparison.experiment)}</title>"
        f"<style>{_STYLE}</style><h1>{text(comparison.experiment)}</h1><p>{text(experiment.doc)}. Mean ± standard "
        f"deviation over the seeds {seeds}. aerotact {__version__}.</p>{faults}<table><thead><tr>{head}</tr></thead>"
        f"<tbody>{body}</tbody></table>{shown}<h2>Controllers</h2><dl>{specs}</dl><h2>Cases</h2>"
        f"<dl>{cases}</dl>{f'<h2>The paper</h2><ul>{places}</ul>' if places else ''}</html>\n",
        encoding="utf-8",
    )
    return file


def _encode(file: Path) -> str:
    return base64.b64encode(file.read_bytes()).decode()
