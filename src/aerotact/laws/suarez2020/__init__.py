"""suarez2020: compliant bimanual aerial manipulation, standard and long reach configurations (IEEE Access 8, 2020).

The platform flies on four nested controllers ('Aerial platform', Figure 15); the arms' reaction is compensated. One
module a part; every law of the package is found through its module's `LAWS`. Where the printed equations cannot stand,
docs/errata.md says what is implemented and why. Forces of the tools are of the environment on the robot.
"""

from aerotact.discovery import collect

LAWS = collect(__name__, "LAWS")
