"""Precision: C written with doubles -> the same C with floats, for computers whose hardware has no doubles.

The templates and what is written from CasADi know doubles only. Here their text is read token by token: the type, the
literals and the functions of math.h become single; comments, strings and lines that speak of the clock stay, since a
float of seconds is too coarse to measure with. What such code would do with a double is never mixed in.
"""

import math
import re
import sys
from collections.abc import Mapping

from aerotact.codegen.functions import BINARY, UNARY

PRECISIONS = ("double", "single")
"""Scalar types of generated C, as ocp files name them."""


# Of math.h: what CasADi's operations need, and the templates.
_MATH = frozenset(re.findall(r"([a-z]\w*)\(", " ".join([*BINARY.values(), *UNARY.values()]))) | {"fabs", "fma"}
_TOKEN = re.compile(
    r"""
    (?P<comment>/\*.*?\*/)
    | (?P<text>"(?:\\.|[^"\\\n])*")
    | (?P<name>[A-Za-z_]\w*)
    | (?P<number>(?:\d+\.\d*|\.\d+)(?:[eE][+-]?\d+)?|\d+[eE][+-]?\d+)(?P<suffix>[fFlL]?)
    | (?P<other>\d\w*|.)
    """,
    re.VERBOSE | re.DOTALL,
)
_SMALL = re.compile(r"[1-9]e-?[1-9]\d*")
_CLOCK = re.compile(r"\b\w*(?:clock|deadline)\w*\b")
_DOUBLE_DIGITS = -math.log10(sys.float_info.epsilon)
_SINGLE_DIGITS = -math.log10(2.0**-23)
_WIDE = 30  # decimal exponents that are sure to be within the range of floats


def in_single_precision(text: str) -> str:
    """C of a header or source with floats in the place of doubles; text that is already so stays as it is."""
    lines = text.split("\n")
    clocked = {i for i, line in enumerate(lines) if _CLOCK.search(re.sub(r"/\*.*?\*/", "", line))}
    pieces = []
    line = 0
    for match in _TOKEN.finditer(text):
        token = match[0]
        pieces.append(token if line in clocked else _single(match))
        line += token.count("\n")
    return "".join(pieces)


def files_in_single_precision(files: Mapping[str, str]) -> dict[str, str]:
    """The same for every C file: path -> text."""
    return {path: in_single_precision(text) if path.endswith((".c", ".h")) else text for path, text in files.items()}


def _single(match: re.Match[str]) -> str:
    if match["name"]:
        name = match["name"]
        if name.startswith("DBL_"):
            return f"FLT_{name[4:]}"
        return "float" if name == "double" else f"{name}f" if name in _MATH else name
    if match["number"] and not match["suffix"]:
        return f"{_literal(match['number'])}f"
    return match[0]


def _literal(text: str) -> str:
    """A literal for floats.

    Those written as a power of ten, such as 1e-12, are ours: thresholds beside round-off, which keep their share of the
    digits, and guards against overflow, which keep within the range. All others are data.
    """
    if not _SMALL.fullmatch(text):
        return text
    mantissa, exponent = text[0], int(text[2:])
    if -4 <= exponent < _WIDE:
        return text
    if abs(exponent) > 2 * _DOUBLE_DIGITS:
        return f"{mantissa}e{math.copysign(_WIDE, exponent):.0f}"
    return f"{float(mantissa) * 10.0 ** (exponent * _SINGLE_DIGITS / _DOUBLE_DIGITS):.1e}"
