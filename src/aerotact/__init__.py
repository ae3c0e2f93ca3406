"""aerotact: from the MuJoCo model of an aerial robot to standalone C controllers for touching the world."""

__version__ = "0.1.0"
