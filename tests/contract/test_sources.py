"""What the source tree promises: no robot by name outside experiments, and imports that run one way."""

import ast
import re
from pathlib import Path

import pytest

from aerotact.robot import load_robot

ROOT = Path(__file__).parents[2]
PACKAGE = ROOT / "src" / "aerotact"
MODULES = sorted(PACKAGE.rglob("*.py"))
ROBOTS = sorted(p.parent.name for p in ROOT.glob("models/*/robot.toml"))

# Each row may import from the rows above it, and its own.
ORDER = (
    ("exceptions", "resources", "ports", "__init__"),
    ("plant_file", "robot_file"),
    ("arms",),
    ("robot",),
    ("dynamics", "gains", "discovery"),
    ("laws", "estimation"),
    ("mpc",),
    ("codegen",),
    ("controller", "qp"),
    ("plant",),
    ("log", "reference", "sight", "recorder", "loop", "metrics", "plots"),
    ("experiments",),
    ("flight",),
    ("check_joints", "check", "compare", "report", "sweep"),
    ("bench",),
    ("terminal", "cli", "__main__"),
)
RANK = {noun: rank for rank, row in enumerate(ORDER) for noun in row}
# The plant knows nothing of who flies it.
FORBIDDEN = {"plant": {"laws", "estimation", "mpc", "codegen", "controller"}}


def _noun(module: Path) -> str:
    return module.relative_to(PACKAGE).parts[0].removesuffix(".py")


def _imported(module: Path) -> set[str]:
    """First-level nouns of aerotact that a module imports, anywhere in it."""
    found = set()
    for node in ast.walk(ast.parse(module.read_text())):
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{module}: relative import"
            names = [
                f"{node.module}.{alias.name}" if node.module == "aerotact" else str(node.module) for alias in node.names
            ]
        found |= {name.split(".")[1] for name in names if name.startswith("aerotact.")}
    return {name for name in found if not name.startswith("__")}


@pytest.mark.parametrize("module", MODULES, ids=lambda m: str(m.relative_to(PACKAGE)))
def test_module_imports_only_upstream_nouns(module: Path) -> None:
    noun = _noun(module)
    assert noun in RANK, f"{noun} has no place in the order; valid: {', '.join(RANK)}"
    for imported in _imported(module):
        assert imported in RANK, f"{imported} has no place in the order; valid: {', '.join(RANK)}"
        assert RANK[imported] <= RANK[noun], f"{noun} imports {imported}, which is downstream"
        assert imported not in FORBIDDEN.get(noun, ()), f"{noun} must not know {imported}"


def test_the_scan_sees_imports() -> None:
    assert {"robot", "ports"} <= _imported(PACKAGE / "dynamics" / "model.py")
    assert "mpc" in _imported(PACKAGE / "codegen" / "mpc_project.py")
    assert len(MODULES) > 30


def test_no_robot_is_named_outside_experiments_and_examples() -> None:
    names = {n for robot in ROBOTS for n in (robot, robot.replace("_", "-"), robot.replace("_", " "))}
    assert names
    words = re.compile("|".join(map(re.escape, sorted(names))), flags=re.IGNORECASE)
    exempt = ("experiments",)  # an experiment has its robot
    files = [p for p in PACKAGE.rglob("*") if p.suffix in (".py", ".jinja", ".xml") and _noun(p) not in exempt]
    assert len(files) > 40
    for file in files:
        found = words.search(file.read_text())
        assert found is None, f"{file.relative_to(ROOT)} names the robot {found.group()}"


@pytest.mark.parametrize("name", ROBOTS)
def test_robot_has_a_page_and_sources(name: str) -> None:
    folder = ROOT / "models" / name
    assert len((folder / "README.md").read_text()) > 500
    assert all(rotor.actuator for rotor in load_robot(folder).rotors)
