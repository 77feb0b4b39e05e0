"""How well a plane explains surface points: what a pipe has to be better than."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.face import ROUGHNESS, distance_sigma
from pipeline_tracker.jit import compiled, compiled_sums

Array = NDArray[np.float64]

# Robust width, in standard deviations, what costs most, and the widths of the steps of a fit.
WIDTH = 4.0
_FULL_COST = WIDTH * WIDTH / 6.0
_WIDTHS = (12.0, 8.0, WIDTH, WIDTH, WIDTH)
# Planes through three points that are tried before a fit: places of the three among the points, as
# shares of their number, the same for each frame.
_TRIPLES = np.random.default_rng(0).random((64, 3))
# Points that judge such a plane; three points that span less than this, m², are in a row.
_JURY, _SLIVER = 100, 1e-9


@compiled
def robust_cost(residual: float) -> float:
    """Robust cost of a residual in standard deviations."""
    ratio = residual / WIDTH
    inside = max(0.0, 1.0 - ratio * ratio)
    return _FULL_COST * (1.0 - inside * inside * inside)


def plane_cost(points: Array, depth_sigmas: Array, rays: Array) -> Array:
    """Robust cost of each point for the best plane through the points, same noise assumed.

    Begun from the best of many planes through three points: mismatches far off would tilt a fit to
    all, and make anything better than a plane.
    """
    triples = (len(points) * _TRIPLES).astype(np.int64)
    cost = np.full(len(points), _FULL_COST)
    _fit_plane(points, depth_sigmas, rays, triples, cost)
    return cost


@compiled
def _fit_plane(
    points: Array, depth_sigmas: Array, rays: Array, triples: NDArray[np.int64], cost: Array
) -> None:
    """Fill the cost, (N,), see ``plane_cost``, with Tukey's weights from wide to narrow."""
    n = points.shape[0]
    places, facing = np.ascontiguousarray(points.T), np.empty(n)
    sigmas = np.sqrt(np.square(depth_sigmas) + ROUGHNESS * ROUGHNESS)
    centre, normal = _plane_through_most(points, sigmas, triples)
    weights, sums = np.empty(n), np.empty(10)
    directions = np.ascontiguousarray(rays.T)
    for width in _WIDTHS:
        for i in range(n):
            facing[i] = (
                directions[0, i] * normal[0]
                + directions[1, i] * normal[1]
                + directions[2, i] * normal[2]
            )
        level = centre[0] * normal[0] + centre[1] * normal[1] + centre[2] * normal[2]
        for i in range(n):
            height = places[0, i] * normal[0] + places[1, i] * normal[1] + places[2, i] * normal[2]
            residual = (height - level) / distance_sigma(depth_sigmas[i], facing[i])
            cost[i] = robust_cost(residual)
            ratio = residual / width
            inside = max(0.0, 1.0 - ratio * ratio)
            weights[i] = inside * inside / (sigmas[i] * sigmas[i])
        _moments(places, weights, sums)
        if np.sum(weights > 0.0) < 3:
            break
        centre = sums[1:4] / sums[0]
        spread = np.empty((3, 3))
        k = 4
        for a in range(3):
            for b in range(a, 3):
                spread[a, b] = spread[b, a] = sums[k] - sums[0] * centre[a] * centre[b]
                k += 1
        _, vectors = np.linalg.eigh(spread)
        normal = np.ascontiguousarray(vectors[:, 0])


@compiled_sums
def _moments(places: Array, weights: Array, sums: Array) -> None:
    """Fill sums of weights, and of them times x, y, z, xx, xy, xz, yy, yz and zz."""
    w, x, y, z, xx, xy, xz, yy, yz, zz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(weights.shape[0]):
        wx, wy, wz = weights[i] * places[0, i], weights[i] * places[1, i], weights[i] * places[2, i]
        w += weights[i]
        x += wx
        y += wy
        z += wz
        xx += wx * places[0, i]
        xy += wx * places[1, i]
        xz += wx * places[2, i]
        yy += wy * places[1, i]
        yz += wy * places[2, i]
        zz += wz * places[2, i]
    sums[0], sums[1], sums[2], sums[3] = w, x, y, z
    sums[4], sums[5], sums[6], sums[7], sums[8], sums[9] = xx, xy, xz, yy, yz, zz


@compiled
def _plane_through_most(
    points: Array, sigmas: Array, triples: NDArray[np.int64]
) -> tuple[Array, Array]:
    """Return point and normal of the plane through three of the points that the others like best.

    Args:
        points: (N, 3), m.
        sigmas: (N,), m.
        triples: (K, 3) indices of points.
    """
    step = max(1, points.shape[0] // _JURY)
    least = np.inf
    centre, best = points[0].copy(), np.array([0.0, 0.0, 1.0])
    normal = np.empty(3)
    for j in range(triples.shape[0]):
        a, b, c = points[triples[j, 0]], points[triples[j, 1]], points[triples[j, 2]]
        for k in range(3):
            m, n = (k + 1) % 3, (k + 2) % 3
            normal[k] = (b[m] - a[m]) * (c[n] - a[n]) - (b[n] - a[n]) * (c[m] - a[m])
        length = np.sqrt(normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2)
        if not length > _SLIVER:
            continue
        normal /= length
        cost = 0.0
        for i in range(0, points.shape[0], step):
            height = 0.0
            for k in range(3):
                height += (points[i, k] - a[k]) * normal[k]
            cost += robust_cost(height / sigmas[i])
        if cost < least:
            least = cost
            centre[:] = a
            best[:] = normal
    return centre, best
