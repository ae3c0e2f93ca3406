"""Terminal: how commands speak, show progress and write what they are asked for."""

import os
import sys
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from aerotact.exceptions import InputError

FILE_WIDTH = 160  # columns of a table that goes into a file or a pipe

console = Console(width=None if sys.stdout.isatty() or "COLUMNS" in os.environ else FILE_WIDTH)
errors = Console(stderr=True)


def say(line: str) -> None:
    """One line, whatever its length, as it is."""
    console.print(line, markup=False, highlight=False, soft_wrap=True)


def make_folder(folder: Path) -> None:
    """Make it, unless it is there.

    Raises:
        InputError: it cannot be made or written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: cannot be made: {error}; valid: a folder that you own") from error
    if not os.access(folder, os.W_OK):
        raise InputError(f"{folder}: cannot be written; valid: a folder that you own")


def write(file: Path, text: str) -> None:
    """Write a text file and its folder.

    Raises:
        InputError: it cannot be written.
    """
    make_folder(file.parent)
    try:
        file.write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError(f"{file}: cannot be written: {error}; valid: a file in a folder that you own") from error


def progress_bar() -> Progress:
    """A bar that is gone when the work is done."""
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    return Progress(*columns, console=console, transient=True)
