"""suarez2020: compliant bimanual aerial manipulation, standard and long reach (IEEE Access 8, 2020).

Platform ('Aerial platform', Figure 15): `attitude`, `base`; forces of the tools are there of the environment on the
robot. Arms: `compliant_joint` (14)-(22), `cartesian_motion` (23)-(24), `contact_force` (25)-(28), `bimanual` (29)-(33),
`arm_control`, which joins them; forces of the tools are there by the robot on the environment. A module's laws are in
its `LAWS`. Where the printed equations cannot stand, docs/errata.md says what is implemented.
"""

from aerotact.discovery import collect

LAWS = collect(__name__, "LAWS")
