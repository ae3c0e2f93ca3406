"""suarez2020: compliant bimanual aerial manipulation, standard and long reach (IEEE Access 8, 2020).

Arms: `compliant_joint` (14)-(22), `cartesian_motion` (23)-(24), `contact_force` (25)-(28), `bimanual` (29)-(33),
`arm_control`, which joins them. Where the printed equations cannot stand, docs/errata.md says what is implemented.
Forces of the tools are by the robot on the environment.
"""

from aerotact.laws.suarez2020.bench_arms import suarez2020_arms
from aerotact.laws.suarez2020.joint_control import suarez2020_joint_control

LAWS = {"suarez2020_arms": suarez2020_arms, "suarez2020_joint_control": suarez2020_joint_control}
