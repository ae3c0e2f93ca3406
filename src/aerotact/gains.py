"""Gains of robot.toml -> default parameters of a block, each checked by name, unit and shape."""

from aerotact.exceptions import InputError, RobotError
from aerotact.ports import Array, Block
from aerotact.robot import Robot


def with_robot_gains(block: Block, robot: Robot) -> Block:
    """The block with the robot's own gains, [gains.<block.name>] of its robot.toml, as default parameters.

    Args:
        block: a law or an estimator.
        robot: whose gains are taken; parameters that it does not name keep the block's defaults.

    Raises:
        RobotError: a gain that is no parameter of the block, or has another unit or shape.
    """
    file = robot.folder / "robot.toml"
    values: dict[str, Array] = {}
    for name, gain in robot.gains(block.name).items():
        part = f"gains.{block.name}.{name}"
        if name not in block.parameters:
            valid = ", ".join(p.name for p in block.parameters) or "none"
            raise RobotError(file, part, f"'{block.name}' has no parameter '{name}'", f"name one of: {valid}")
        port = block.parameters[name]
        if gain.unit != port.unit:
            raise RobotError(file, part, f"unit is '{gain.unit}'", f"give it in '{port.unit}'")
        values[name] = gain.array
    try:
        return block.with_parameters(values)
    except InputError as error:
        raise RobotError(
            file, f"gains.{block.name}", str(error), "give one number, or one for each component"
        ) from error
