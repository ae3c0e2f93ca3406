"""suarez2020: compliant bimanual aerial manipulation, standard and long reach configurations (IEEE Access 8, 2020).

The platform flies on four nested controllers ('Aerial platform', Figure 15); the arms' reaction is compensated. The
arms: `compliant_joint` (14)-(22), `cartesian_motion` (23)-(24), `contact_force` (25)-(28), `bimanual` (29)-(33), and
`arm_control`, which joins them. One module a part; every law of the package is found through its module's `LAWS`. Where
the printed equations cannot stand, docs/errata.md says what is implemented and why. Forces of arms that are controlled,
`f_<arm>_d` and `f_<arm>_W`, are by the robot on the environment; `f_tools_W_r` is of the environment on the robot.
"""

from aerotact.discovery import collect

LAWS = collect(__name__, "LAWS")
