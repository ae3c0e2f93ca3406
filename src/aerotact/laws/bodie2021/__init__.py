"""bodie2021: active interaction force control for contact-based inspection (IEEE T-RO 37(3), 2021).

Variable axis-selective impedance and direct force control of a robot that can exert force and torque in all directions.
The modules follow the paper's parts: `impedance` (3)-(12), `confidence` (8), (13)-(17), `direct_force` (18)-(22), and
`intentional_interaction`, the whole law (22)-(26). Where the printed equations cannot stand, docs/errata.md says what
is implemented and why. All forces of the tool are by the robot on the environment.
"""

from aerotact.laws.bodie2021.intentional_interaction import bodie2021_impedance_force

LAWS = {"bodie2021_impedance_force": bodie2021_impedance_force}
