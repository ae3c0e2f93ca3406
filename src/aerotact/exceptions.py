"""Errors: one base class; each message names the bad value, where it came from, and what would be valid."""

from collections.abc import Iterable
from pathlib import Path


class AerotactError(Exception):
    """Base of every error that aerotact raises on purpose; `exit_code` is what the command line returns."""

    exit_code = 1


class UnknownName(AerotactError):
    """A name that nothing answers to."""

    exit_code = 2

    def __init__(self, kind: str, name: str, valid: Iterable[str], where: str = "") -> None:
        place = f" in {where}" if where else ""
        super().__init__(f"unknown {kind} '{name}'{place}; valid: {', '.join(sorted(valid)) or 'none'}")


class RobotError(AerotactError):
    """A robot folder that cannot be used: names the file, the part and the remedy."""

    exit_code = 3

    def __init__(self, file: Path | str, part: str, fault: str, remedy: str) -> None:
        self.file, self.part, self.fault, self.remedy = str(file), part, fault, remedy
        super().__init__(f"{file}: {part}: {fault}; {remedy}")


class MissingCapability(AerotactError):
    """A law or an optimal control problem needs what the robot lacks."""

    exit_code = 3


class ProblemError(AerotactError):
    """An ocp file that cannot be used: names the file, the key and what would be valid."""

    exit_code = 4

    def __init__(self, file: Path | str, key: str, fault: str, remedy: str) -> None:
        super().__init__(f"{file}: {key}: {fault}; {remedy}")


class CodegenError(AerotactError):
    """Generated C could not be written, compiled or loaded."""

    exit_code = 5


class CompilerNotFound(CodegenError):
    """No C compiler on this machine."""

    def __init__(self, tried: Iterable[str]) -> None:
        super().__init__(
            f"no C compiler found (tried {', '.join(tried)}); install gcc or clang, or set the variable CC to one"
        )


class LibraryNotFound(CodegenError):
    """A library that a back end links is not on this machine."""

    def __init__(self, name: str, tried: Iterable[str], variable: str) -> None:
        super().__init__(
            f"the library {name} was not found (looked in {', '.join(tried)}); install it and set {variable} to its "
            "folder with include/ and lib/, or ACADOS_SOURCE_DIR to an acados that is built; or choose another back end"
        )


class InputError(AerotactError):
    """A value handed to the Python interface has the wrong name, shape or range."""

    exit_code = 2


class LoopError(AerotactError):
    """A closed loop could not be wired or had to stop; what was logged so far is kept."""

    exit_code = 6
