"""SurfaceMap: a triangular mesh of what a plant's robot may touch, as a planner knows it (bodie2021 IV-B).

The paper reconstructs the mesh from the camera's points; here it is taken from the plant's geometry as it stands, so
that the map is exact. Looking up points needs trimesh and rtree: pip install "aerotact[mesh]".
"""

from typing import Any

import mujoco
import numpy as np
from scipy.spatial import cKDTree

from aerotact.exceptions import InputError
from aerotact.experiments.contact_pose import ContactPose, contact_pose
from aerotact.plant.plant import Plant
from aerotact.ports import Array

_WELD = 5e-4  # m, within which vertices of neighbouring height fields are the same


def _trimesh() -> Any:
    try:
        import rtree  # noqa: F401, PLC0415
        import trimesh  # noqa: PLC0415
    except ImportError as error:
        raise InputError(f'a surface map needs a mesh library: {error}; valid: pip install "aerotact[mesh]"') from error
    return trimesh


class SurfaceMap:
    """Triangles with vertex normals, and an R-tree of their bounding boxes.

    Attributes:
        mesh: `trimesh.Trimesh` in W; its normals point to the robot's side.
    """

    def __init__(self, vertices_W: Array, faces: Array) -> None:
        """Weld the vertices.

        Args:
            vertices_W: m, shape (n, 3).
            faces: three vertices each, shape (m, 3), counter-clockwise seen from the robot's side.

        Raises:
            InputError: the mesh library is not installed.
        """
        self._library = _trimesh()
        same = np.array([min(group) for group in cKDTree(vertices_W).query_ball_point(vertices_W, _WELD)])
        self.mesh = self._library.Trimesh(vertices_W, same[faces], process=False)
        self.mesh.remove_unreferenced_vertices()

    def closest(self, points_W: Array) -> tuple[Array, Array]:
        """The points of the surface that are nearest to others.

        Args:
            points_W: m, shape (n, 3).

        Returns:
            Points on the surface, m, and unit normals there, interpolated between those of the vertices; shape (n, 3).
        """
        found, _, triangles = self._library.proximity.closest_point(self.mesh, np.atleast_2d(points_W))
        corners = self.mesh.faces[triangles]
        weights = self._library.triangles.points_to_barycentric(self.mesh.vertices[corners], found)
        normals = (weights[:, :, None] * self.mesh.vertex_normals[corners]).sum(axis=1)
        return np.asarray(found), normals / np.linalg.norm(normals, axis=1, keepdims=True)

    def contact(self, point_W: Array, across_W: Array | None = None) -> ContactPose:
        """The tool on the surface, as near as can be to a point in free space, m, shape (3,)."""
        points, normals = self.closest(point_W)
        return contact_pose(points[0], normals[0], across_W)

    def random_contacts(self, count: int, seed: int, margin: float = 0.1) -> list[ContactPose]:
        """Contacts at points drawn evenly over the surface's area.

        Args:
            count: how many.
            seed: of the draw.
            margin: least distance from the surface's rim, m.

        Raises:
            InputError: the surface has no such points.
        """
        mesh, rim = self.mesh, self._rim()
        rng = np.random.default_rng(seed)
        found: list[ContactPose] = []
        for _ in range(50):
            triangles = rng.choice(len(mesh.faces), count, p=mesh.area_faces / mesh.area)
            weights = rng.dirichlet(np.ones(3), count)
            points = (weights[:, :, None] * mesh.triangles[triangles]).sum(axis=1)
            away = np.linalg.norm(points[:, None, :] - rim, axis=2).min(axis=1, initial=np.inf)
            if (away > margin).any():
                found += map(contact_pose, *self.closest(points[away > margin]))
            if len(found) >= count:
                return found[:count]
        raise InputError(f"{len(found)} of {count} contacts at {margin:g} m from the rim; valid: a smaller margin")

    def _rim(self) -> Array:
        """Vertices of the edges that belong to one triangle only, m, shape (k, 3)."""
        edges = self.mesh.edges_sorted
        _, first, counts = np.unique(edges, axis=0, return_index=True, return_counts=True)
        return np.asarray(self.mesh.vertices[np.unique(edges[first[counts == 1]])])


def map_surfaces(plant: Plant) -> SurfaceMap:
    """Map the height fields of a plant's world whose names start with "surface", where they are now.

    Raises:
        InputError: the world has none, or the mesh library is not installed.
    """
    model, data = plant.model, plant.data
    vertices, faces, count = [], [], 0
    for geom in range(model.ngeom):
        if model.geom_type[geom] != mujoco.mjtGeom.mjGEOM_HFIELD or not model.geom(geom).name.startswith("surface"):
            continue
        grid, triangles = _height_field(model, int(model.geom_dataid[geom]))
        vertices.append(grid @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom])
        faces.append(triangles + count)
        count += len(grid)
    if not vertices:
        raise InputError(
            "the plant's world has no height field; valid: a world with one whose name starts with surface"
        )
    return SurfaceMap(np.concatenate(vertices), np.concatenate(faces))


def _height_field(model: Any, index: int) -> tuple[Array, Array]:
    """Vertices in the field's own frame, m, and triangles, counter-clockwise from above."""
    rows, columns, start = model.hfield_nrow[index], model.hfield_ncol[index], model.hfield_adr[index]
    half_x, half_y, height, _ = model.hfield_size[index]
    z = height * model.hfield_data[start : start + rows * columns].reshape(rows, columns)
    x, y = np.meshgrid(np.linspace(-half_x, half_x, columns), np.linspace(-half_y, half_y, rows))
    corner = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    right, above = corner + 1, corner + columns
    # Cells are divided as MuJoCo divides them.
    triangles = np.concatenate(
        [np.column_stack([corner, right, above + 1]), np.column_stack([corner, above + 1, above])]
    )
    return np.stack([x, y, z], axis=-1).reshape(-1, 3), triangles
