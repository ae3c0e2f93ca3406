"""Who flies the robots of suarez2020. The paper gives the laws' structure and no gains; ours are the laws' defaults."""

from aerotact.experiments.experiment import ControllerSpec

RATE = 250.0
"""Hz of the platform's loops: that of the autopilot's estimates ('Aerial platform')."""
SERVO_RATE = 50.0
"""Hz of the arms' control ('Dual arm control program')."""

PLATFORM = ControllerSpec("suarez2020_base", RATE, "four nested loops, swing feedback, arms held")
"""The platform alone."""
TOOLS = ControllerSpec(
    "suarez2020_tools",
    SERVO_RATE,
    "inverse kinematics that follow goals in W, (23), on the same platform",
    {"speed": 0.5},
    inner=PLATFORM,
)
"""Arms that make up for the platform's motion, on the platform."""
PID = ControllerSpec("suarez2020_base", RATE, "the same without swing feedback", {"K_swing": 0.0})
ATTITUDE_HOLD = ControllerSpec(
    "suarez2020_base",
    RATE,
    "attitude and height held only",
    {"K_swing": 0.0, "K_p": [0.0, 0.0, 2.0], "K_v": [0.0, 0.0, 4.0], "K_vi": [0.0, 0.0, 1.5]},
)
MPC = ControllerSpec(
    "dual_arm_tools",
    None,
    "base and arms planned together over 0.97 s at 50 Hz, around the attitude and rate loops",
    inner=ControllerSpec("suarez2020_attitude", RATE, "attitude and rate loops"),
)
