"""The page of a comparison: it carries all that it shows, and its text cannot break it."""

import base64
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import pytest

from aerotact.compare import Comparison, comparison_rows
from aerotact.experiments import find_experiment
from aerotact.flight import Result
from aerotact.report import write_report

PIXEL = base64.b64decode("iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAQAAAC1HAwCAAAAC0lEQVR42mNk+A8AAQUBAScY42YAAAAASUVORK5CYII=")
EXPERIMENT = find_experiment("ryll2019/property-shaping")


class _Page(HTMLParser):
    """Tags that are open, rows of the table, and whatever a tag refers to."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.rows: list[list[str]] = []
        self.references: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.references += [value or "" for name, value in attrs if name in ("src", "href", "srcset", "data", "action")]
        if tag not in ("meta", "img"):
            self.open.append(tag)
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append("")

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] in ("td", "th"):
            self.rows[-1][-1] += data


@pytest.fixture
def comparison() -> Comparison:
    statistics = {"steady_K6": {"mean": 0.1957, "std": 0.0004, "unit": "m"}}
    results = (Result("mpc", "K6", 1, {}, "a <b> & 'c'", None),)
    return Comparison(EXPERIMENT.name, (0, 1), {"steady_K6": 0.19}, {"law": statistics, "mpc": {}}, results)


def test_page_is_one_file_that_refers_to_nothing(comparison: Comparison, tmp_path: Path) -> None:
    figure = tmp_path / "figure <1>.png"
    figure.write_bytes(PIXEL)
    file = write_report(comparison, EXPERIMENT, [figure, figure], tmp_path / "new" / "report.html")
    text = file.read_text(encoding="utf-8")
    page = _Page(text)
    assert page.open == []
    assert len(page.references) == 2
    for reference in page.references:
        kind, data = reference.split(",")
        assert kind == "data:image/png;base64"
        assert base64.b64decode(data) == PIXEL
    assert not re.search(r"https?:|//|@import|url\(", re.sub(r'src="[^"]*"', "", text))


def test_page_shows_the_table_the_faults_and_the_paper(comparison: Comparison, tmp_path: Path) -> None:
    text = write_report(comparison, EXPERIMENT, [], tmp_path / "report.html").read_text(encoding="utf-8")
    header, rows = comparison_rows(comparison)
    assert _Page(text).rows == [header, *rows]
    assert "195.70 ± 0.40" in text
    assert "a &lt;b&gt; &amp; &#x27;c&#x27;" in text
    assert "<h2>Figures" not in text
    for case in EXPERIMENT.cases:
        assert case.doc in text
    for number in EXPERIMENT.paper.values():
        assert f"{number.value:g} {number.unit}" in text


def test_page_of_an_experiment_without_numbers_of_the_paper(comparison: Comparison, tmp_path: Path) -> None:
    tour = find_experiment("ryll2019/free-flight")
    plain = replace(comparison, experiment=tour.name, results=())
    text = write_report(plain, tour, [], tmp_path / "report.html").read_text(encoding="utf-8")
    assert "The paper" not in text
    assert 'class="fault"' not in text
