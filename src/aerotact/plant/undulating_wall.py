"""UndulatingWall: a doubly curved wall of spring-borne tiles, written as a world (`worlds/undulating_wall.xml`).

After the wooden wall of bodie2021 (Section V-F, Fig. 14), 1.8 m wide and 1 m high. Its shape is a sum of two sinusoids,
the same on every machine. Each tile is a height field on a slide along the wall's depth, borne by a spring;
stiffness differs from tile to tile, and one springy tile gives way by 25 mm at 10 N. Tiles are rigid in themselves.

    python -m aerotact.plant.undulating_wall      # writes the world anew
"""

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from aerotact.ports import Array

FILE = Path(__file__).resolve().parent / "worlds" / "undulating_wall.xml"

FACE = 1.0  # m, x of the wall's mean plane; it looks along -x
Y, Z = (-0.9, 0.9), (0.7, 1.7)  # m
TILES = (6, 5)  # along y and z
CELL = 0.02  # m, step of the height fields
SPRINGY = (4, 3)  # the tile that gives way
SPRINGY_STIFFNESS = 400.0  # N/m
STIFFNESS = (3e3, 3e4)  # N/m, lowest and highest of the other tiles
DAMPING_RATIO = 0.1
MASS = 0.36  # kg a tile: 0.3 m x 0.2 m of plywood, 10 mm thick
FRICTION = 0.5
_SEED = 42


def elevation(y: ArrayLike, z: ArrayLike) -> Array:
    """How far the wall stands out towards the robot from its mean plane, m.

    Args:
        y, z: in W, m, of shapes that broadcast.
    """
    y, z = np.asarray(y, dtype=float), np.asarray(z, dtype=float)
    return np.asarray(
        0.045 * np.sin(5.0 * y + 0.6) * np.cos(4.0 * (z - 1.1)) + 0.03 * np.sin(6.0 * (z - 1.0) + 1.5 * y)
    )


def stiffness() -> Array:
    """Stiffness of each tile along the wall's depth, N/m, shape TILES; even in the logarithm, save the springy one."""
    low, high = np.log(STIFFNESS)
    values = np.exp(np.random.default_rng(_SEED).uniform(low, high, TILES))
    values[SPRINGY] = SPRINGY_STIFFNESS
    return np.asarray(values.round(-1))


def _tile(i: int, j: int, spring: float) -> tuple[str, str]:
    """Height field and body of the tile in column i and row j: its x is W's z, its y is W's y, its z points out."""
    (y0, y1), (z0, z1) = (
        np.linspace(*span, n + 1)[k : k + 2] for span, n, k in zip((Y, Z), TILES, (i, j), strict=True)
    )
    rows, columns = round((y1 - y0) / CELL) + 1, round((z1 - z0) / CELL) + 1
    heights = elevation(np.linspace(y0, y1, rows)[:, None], np.linspace(z0, z1, columns))
    low, high = float(heights.min()), float(heights.max())
    numbers = " ".join(f"{v:.4f}" for v in ((heights - low) / (high - low))[::-1].ravel())  # MJCF: last row first
    name = f"{i}{j}"
    field = (
        f'    <hfield name="tile{name}" nrow="{rows}" ncol="{columns}"'
        f' size="{(z1 - z0) / 2:.3f} {(y1 - y0) / 2:.3f} {high - low:.6f} 0.01"\n            elevation="{numbers}"/>'
    )
    damping = 2 * DAMPING_RATIO * np.sqrt(spring * MASS)
    body = (
        f'    <body name="tile{name}" pos="{FACE - low:.6f} {(y0 + y1) / 2:.3f} {(z0 + z1) / 2:.3f}"'
        ' xyaxes="0 0 1 0 1 0" gravcomp="1" childclass="tile">\n'
        f'      <joint name="tile{name}" stiffness="{spring:g}" damping="{damping:.3f}"/>\n'
        f'      <geom name="surface_tile{name}" hfield="tile{name}" material="wood{(i + j) % 2}"/>\n'
        "    </body>"
    )
    return field, body


def world_xml() -> str:
    """The world as MJCF."""
    springs = stiffness()
    tiles = [_tile(i, j, float(springs[i, j])) for i in range(TILES[0]) for j in range(TILES[1])]
    fields, bodies = ("\n".join(parts) for parts in zip(*tiles, strict=True))
    return f"""<!-- A doubly curved wall of tiles on springs, 1.8 m wide, 1 m high; mean plane x = 1 m, looks along -x.
     Written by aerotact.plant.undulating_wall, which says what it is; do not edit. -->
<mujoco model="undulating_wall">
  <include file="floor.xml"/>
  <default>
    <default class="tile">
      <geom type="hfield" mass="{MASS:g}" contype="1" conaffinity="1" condim="1" priority="2" friction="{FRICTION:g}"
            solref="0.004 1" solimp="0.95 0.99 0.001" group="1"/>
      <joint type="slide" axis="0 0 1"/>
    </default>
  </default>
  <asset>
    <material name="wood0" rgba="0.80 0.66 0.47 1"/>
    <material name="wood1" rgba="0.74 0.59 0.40 1"/>
{fields}
  </asset>
  <worldbody>
    <geom name="wall_frame" type="box" size="0.03 {(Y[1] - Y[0]) / 2:g} {Z[1] / 2:g}" pos="1.2 0 {Z[1] / 2:g}"
          rgba="0.42 0.40 0.38 1" contype="0" conaffinity="0" group="1"/>
{bodies}
  </worldbody>
</mujoco>
"""


if __name__ == "__main__":
    FILE.write_text(world_xml(), encoding="utf-8")
