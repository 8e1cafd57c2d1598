"""Linear programs in three variables: minimise c . x subject to n_i . x >= b_i inside a box.

Based on: Seidel, "Small-dimensional linear programming and convex hulls made easy" (1991). Constraints are added one by one
in a shuffled order; when the optimum so far breaks the new one, the new optimum lies on its plane, which is the same problem
in two variables, and there in one. Expected work is linear in the number of constraints.

Departures: the shuffle is deterministic (a fixed multiplicative generator), so that equal input gives equal bits; the box is a
part of every subproblem, so that no subproblem is unbounded; where many points are equally good, the one near the origin is
preferred. All tolerances are distances: a constraint holds when it is broken by at most `TOLERANCE * reach`.
"""

from __future__ import annotations

import math

import numpy as np

from geometry.borrowing import borrowing

OPTIMAL = 0
INFEASIBLE = 1
UNBOUNDED = 2

TOLERANCE = 1e-12
"""Of the box: a distance below this is none, a sine below this means parallel."""
_NO_SLOPE = 1e-13  # an objective (unit length) that changes less than this along a direction does not change
_AT_BOX = 1.0 - 1e-9  # beyond this part of the reach the box decided, not a constraint
BOX_ROWS = 6


@borrowing
def _prepare(normals, offsets, count):
    """Normalise the rows to unit length in place, drop the void ones, shuffle. Returns the rows left, -1 when one is false."""
    n = 0
    for i in range(count):
        x, y, z, b = normals[i, 0], normals[i, 1], normals[i, 2], offsets[i]
        square = x * x + y * y + z * z
        if not 1e-200 < square < 1e200:  # squares would leave the range of doubles
            largest = max(abs(x), abs(y), abs(z))
            if largest == 0.0:
                if b > 0.0:
                    return -1
                continue
            x, y, z, b = x / largest, y / largest, z / largest, b / largest
            square = x * x + y * y + z * z
        length = math.sqrt(square)
        normals[n, 0], normals[n, 1], normals[n, 2], offsets[n] = x / length, y / length, z / length, b / length
        n += 1
    state = np.uint64(0x9E3779B97F4A7C15)
    for i in range(n - 1, 0, -1):
        state = state * np.uint64(6364136223846793005) + np.uint64(1442695040888963407)
        j = np.int64((state >> np.uint64(33)) % np.uint64(i + 1))
        for k in range(3):
            normals[i, k], normals[j, k] = normals[j, k], normals[i, k]
        offsets[i], offsets[j] = offsets[j], offsets[i]
    return n


@borrowing
def _solve1(rows, count, qx, qy, dx, dy, slope, bound, tolerance):
    """Best t of q + t d over the first rows; returns (feasible, t)."""
    low, high = -bound, bound
    low_slack, high_slack = tolerance, tolerance
    for j in range(count):
        along = rows[j, 0] * dx + rows[j, 1] * dy
        rest = rows[j, 2] - rows[j, 0] * qx - rows[j, 1] * qy
        if along > TOLERANCE:
            t = rest / along
            if t > low:
                low, low_slack = t, tolerance / along
        elif along < -TOLERANCE:
            t = rest / along
            if t < high:
                high, high_slack = t, -tolerance / along
        elif rest > tolerance:
            return False, 0.0
    if low > high:
        # a crossing that the tolerance forgives: each of the two constraints is then broken by a tolerance at most
        return low - high <= low_slack + high_slack, 0.5 * (low + high)
    if slope > _NO_SLOPE:
        return True, low
    if slope < -_NO_SLOPE:
        return True, high
    return True, min(max(0.0, low), high)


@borrowing
def _solve2(rows, count, cx, cy, bound, tolerance):
    """Minimise (cx, cy) . y subject to rows[j, :2] . y >= rows[j, 2] and |y| <= bound; returns (feasible, y0, y1)."""
    y0 = -bound if cx > _NO_SLOPE else (bound if cx < -_NO_SLOPE else 0.0)
    y1 = -bound if cy > _NO_SLOPE else (bound if cy < -_NO_SLOPE else 0.0)
    for i in range(count):
        a, b, rest = rows[i, 0], rows[i, 1], rows[i, 2]
        if a * y0 + b * y1 >= rest - tolerance:
            continue
        square = a * a + b * b
        if square <= TOLERANCE * TOLERANCE:
            return False, y0, y1
        length = math.sqrt(square)
        dx, dy = -b / length, a / length
        qx, qy = a * rest / square, b * rest / square
        feasible, t = _solve1(rows, i, qx, qy, dx, dy, cx * dx + cy * dy, 4.0 * bound, tolerance)
        if not feasible:
            return False, y0, y1
        y0, y1 = qx + t * dx, qy + t * dy
    return True, y0, y1


@borrowing
def _project(normals, offsets, i, reach, ux, uy, uz, wx, wy, wz, work):
    """Rows before i and the box, restricted to plane i with basis u, w about the foot of the origin; returns their number."""
    nx, ny, nz, b = normals[i, 0], normals[i, 1], normals[i, 2], offsets[i]
    for j in range(i):
        mx, my, mz = normals[j, 0], normals[j, 1], normals[j, 2]
        work[j, 0] = mx * ux + my * uy + mz * uz
        work[j, 1] = mx * wx + my * wy + mz * wz
        work[j, 2] = offsets[j] - b * (mx * nx + my * ny + mz * nz)
    # last, because they are hardly ever broken and the order is free
    work[i, 0], work[i, 1], work[i, 2] = ux, wx, -reach - b * nx
    work[i + 1, 0], work[i + 1, 1], work[i + 1, 2] = -ux, -wx, -reach + b * nx
    work[i + 2, 0], work[i + 2, 1], work[i + 2, 2] = uy, wy, -reach - b * ny
    work[i + 3, 0], work[i + 3, 1], work[i + 3, 2] = -uy, -wy, -reach + b * ny
    work[i + 4, 0], work[i + 4, 1], work[i + 4, 2] = uz, wz, -reach - b * nz
    work[i + 5, 0], work[i + 5, 1], work[i + 5, 2] = -uz, -wz, -reach + b * nz
    return i + BOX_ROWS


@borrowing
def solve3(normals, offsets, count, objective, reach, work):
    """Minimise objective . x subject to normals[i] . x >= offsets[i], i < count, and |x_k| <= reach.

    normals: (m, 3) f8 of any length and offsets: (m,) f8, m >= count; both are scratch: scaled to unit normals and permuted
    in place. objective: (3,) f8, may be zero (any feasible point then). reach > 0: half the side of the box about the origin,
    which should be near the solution for the sake of accuracy. work: (count + BOX_ROWS, 3) f8 scratch or larger.

    Returns (status, x, y, z): OPTIMAL; UNBOUNDED when the best point in the box lies on the box (the point is returned; without
    the box the problem is unbounded or its optimum at least this far out); INFEASIBLE when no point of the box satisfies all
    constraints. Constraints hold up to a few `TOLERANCE * reach`. A zero normal is a void constraint, or an infeasible one when
    its offset is positive.
    """
    n = _prepare(normals, offsets, count)
    if n < 0:
        return INFEASIBLE, 0.0, 0.0, 0.0
    cx, cy, cz = objective[0], objective[1], objective[2]
    largest = max(abs(cx), abs(cy), abs(cz))
    if largest > 0.0:
        cx, cy, cz = cx / largest, cy / largest, cz / largest
        length = math.sqrt(cx * cx + cy * cy + cz * cz)
        cx, cy, cz = cx / length, cy / length, cz / length
    x = -reach if cx > _NO_SLOPE else (reach if cx < -_NO_SLOPE else 0.0)
    y = -reach if cy > _NO_SLOPE else (reach if cy < -_NO_SLOPE else 0.0)
    z = -reach if cz > _NO_SLOPE else (reach if cz < -_NO_SLOPE else 0.0)
    tolerance = TOLERANCE * reach
    for i in range(n):
        nx, ny, nz, b = normals[i, 0], normals[i, 1], normals[i, 2], offsets[i]
        if nx * x + ny * y + nz * z >= b - tolerance:
            continue
        # an orthonormal basis of the plane, without a branch that could divide by zero
        side = 1.0 if nz >= 0.0 else -1.0
        p = -1.0 / (side + nz)
        q = nx * ny * p
        ux, uy, uz = 1.0 + side * nx * nx * p, side * q, -side * nx
        wx, wy, wz = q, side + ny * ny * p, -ny
        rows = _project(normals, offsets, i, reach, ux, uy, uz, wx, wy, wz, work)
        feasible, s, t = _solve2(work, rows, cx * ux + cy * uy + cz * uz, cx * wx + cy * wy + cz * wz, 2.0 * reach, tolerance)
        if not feasible:
            return INFEASIBLE, x, y, z
        x, y, z = b * nx + s * ux + t * wx, b * ny + s * uy + t * wy, b * nz + s * uz + t * wz
    if max(abs(x), abs(y), abs(z)) >= _AT_BOX * reach:
        return UNBOUNDED, x, y, z
    return OPTIMAL, x, y, z
