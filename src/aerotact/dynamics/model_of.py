"""From a robot to the model that suits it."""

from aerotact.dynamics.model import Model
from aerotact.dynamics.multibody import Multibody
from aerotact.exceptions import RobotError
from aerotact.robot import Robot


def model_of(robot: Robot) -> Model:
    """The model of a robot: a rigid body, or a tree of bodies if robot.toml lists arms or passive joints.

    Raises:
        RobotError: rotors tilt on a robot with joints, for which there are no equations.
    """
    if not (robot.arms or robot.passive):
        return Model(robot)
    if robot.tilts:
        tilt = robot.tilts[0].joint
        raise RobotError(
            robot.folder / "robot.toml",
            "rotors",
            f"'{tilt}' tilts a rotor of a robot with arms",
            "list fixed rotors only",
        )
    return Multibody(robot)
