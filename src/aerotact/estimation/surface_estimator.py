"""surface_estimator: distance and normal of the surface ahead of the tool, bodie2021 (35)-(39).

The paper's singular value decomposition of the centred points has the same right vectors as their covariance, which is
all that is kept of a frame (`point_patch`). Signs and indices follow docs/errata.md.
"""

from typing import Any

import casadi as ca

from aerotact.dynamics import so3
from aerotact.dynamics.model import Model
from aerotact.gains import with_robot_gains
from aerotact.ports import Block, BlockBuilder

REACH = 4.0
"""What is further away than this, or not seen at all, is said to be at this distance, m."""
SWEEPS = 5  # of the Jacobi iteration, which converges quadratically; a 3 x 3 matrix is diagonal to round-off after four


def eigenvectors(matrix: Any) -> tuple[list[Any], list[Any]]:
    """Eigenvalues and orthonormal eigenvectors of a symmetric 3 x 3 matrix by cyclic Jacobi rotations, unsorted.

    Args:
        matrix: CasADi expression of shape (3, 3); only the upper triangle is read.
    """
    A = {(i, j): matrix[i, j] for i in range(3) for j in range(i, 3)}
    V = [[ca.SX(float(i == j)) for j in range(3)] for i in range(3)]
    for _ in range(SWEEPS):
        for p, q in ((0, 1), (0, 2), (1, 2)):
            r = 3 - p - q
            angle = 0.5 * ca.atan2(2 * A[p, q], A[q, q] - A[p, p])
            c, s = ca.cos(angle), ca.sin(angle)
            pr, qr = (min(p, r), max(p, r)), (min(q, r), max(q, r))
            pp, qq, pq, a, b = A[p, p], A[q, q], A[p, q], A[pr], A[qr]
            A[p, p], A[q, q] = c * c * pp - 2 * s * c * pq + s * s * qq, s * s * pp + 2 * s * c * pq + c * c * qq
            A[p, q] = s * c * (pp - qq) + (c * c - s * s) * pq
            A[pr], A[qr] = c * a - s * b, s * a + c * b
            for row in V:
                row[p], row[q] = c * row[p] - s * row[q], s * row[p] + c * row[q]
    return [A[i, i] for i in range(3)], [ca.vertcat(*[row[i] for row in V]) for i in range(3)]


def surface_estimator(model: Model, rate: float) -> Block:
    """Plane through a patch of points; nothing is filtered.

    Normal: the eigenvector of the least eigenvalue, (35)-(37), turned against the tool's z axis. Distance: where the
    tool's axis cuts the plane, (38)-(39). A plane counts as valid if enough points lie about the axis, in a plane, in
    both directions of it, and if it is not seen at a grazing angle; otherwise distance and normal say that nothing is
    near: `REACH`, and against the tool's axis.
    """
    robot = model.robot
    model.require(["tool"], "estimator surface_estimator")
    b = BlockBuilder("surface_estimator", "bodie2021", rate, "plane ahead of the tool from a patch of points (35)-(39)")
    q_WB = b.measurement("q_WB", 4, "1", frame="W", kind="quaternion", doc="attitude of the base")
    count = b.measurement("patch_points", 1, "1", doc="number of points about the tool's axis")
    mean = b.measurement("patch_mean_E", 3, "m", frame="E", doc="mean of these points")
    covariance = b.measurement("patch_covariance_E", 6, "m^2", frame="E", doc="of the points: xx xy xz yy yz zz")
    points_min = b.parameter("points_min", 1, "1", 30.0, doc="fewest points", lower=3.0)
    residual_max = b.parameter("residual_max", 1, "m", 0.025, doc="largest rms distance of the points to the plane")
    spread_min = b.parameter("spread_min", 1, "m", 0.025, doc="least rms extent of the points in the plane")
    slope_min = b.parameter("slope_min", 1, "1", 0.3, doc="least cosine between tool's axis and normal", lower=0.01)

    xx, xy, xz, yy, yz, zz = ca.vertsplit(covariance)
    matrix = ca.vertcat(ca.horzcat(xx, xy, xz), ca.horzcat(xy, yy, yz), ca.horzcat(xz, yz, zz))
    values, vectors = eigenvectors(matrix)
    n_E, least = vectors[0], values[0]
    for value, vector in zip(values[1:], vectors[1:], strict=True):
        n_E = ca.if_else(value < least, vector, n_E)
        least = ca.fmin(value, least)
    low, high = ca.fmin(values[0], values[1]), ca.fmax(values[0], values[1])
    middle = ca.fmax(low, ca.fmin(high, values[2]))
    n_E = ca.if_else(n_E[2] > 0, -n_E, n_E)
    slope = ca.fmax(-n_E[2], slope_min)
    distance = -ca.dot(mean, n_E) / slope
    valid = ca.logic_and(count >= points_min, ca.sqrt(ca.fmax(least, 0)) <= residual_max)
    valid = ca.logic_and(valid, ca.sqrt(ca.fmax(middle, 0)) >= spread_min)
    valid = ca.logic_and(valid, ca.logic_and(-n_E[2] >= slope_min, distance <= REACH))

    axis_E = ca.DM([0, 0, -1])
    n_W = ca.mtimes(so3.rotation(q_WB), ca.mtimes(ca.DM(robot.R_BE), ca.if_else(valid, n_E, axis_E)))
    against = tuple(float(v) for v in -ca.evalf(so3.rotation(ca.DM(model.hover_tool[1]))).full()[:, 2])
    b.output(
        "surface_distance", ca.if_else(valid, distance, REACH), "m", doc="from the tip along z of E", default=(REACH,)
    )
    b.output("n_W", n_W, "1", frame="W", doc="unit normal towards the robot", default=against)
    b.output("surface_valid", valid, "1", kind="flag", doc="1 if there is a plane to trust")
    return with_robot_gains(b.build(), robot)


ESTIMATORS = {"surface_estimator": surface_estimator}
