"""One camera: the axis from its contours, the known radius and the echo sounder (5.2).

One image shows where the pipe is to the side, and only by the width of its strip how far away. The
width is a poor witness: the foot of the pipe, the edge of its shadow and growth run along the
contour and are taken for it. How well it is known is measured in the picture itself: from how
widely edges that run along the pipe are spread about the contour. The echo sounder, where its beam
meets the pipe, tells the distance without such doubt, and with the radius how wide the strip is.
Pairs of edges of that width, with their brighter sides alike, are put together.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.axis_fit import Axis, AxisFit, Evidence, Prior, across, fit_axis
from pipeline_tracker.echoes import Echoes
from pipeline_tracker.evidence import (
    REFERENCE_WIDTH,
    contour_rays,
    distances_from_axis,
    rays_to_axis,
    unit_rays,
)
from pipeline_tracker.face import SPAN
from pipeline_tracker.pipe_segment import middle_of_view
from pipeline_tracker.support import Support, contour_support
from pipeline_tracker.types import VectorizedStereo

Array = NDArray[np.float64]

# A beam that passes the axis at more than this share of the radius may have met the bed.
_HIT_SHARE = 0.7
# Roughness of what the beam meets, m; and what the pipe may wander off the fitted curve, for each
# metre along it from the middle of the view.
_SURFACE, _WANDER = 0.005, 0.006
# A place of the axis tells of echoes so near to it, m along it.
_PASSED_NEAR = 0.8
# Echoes so far behind the middle of the view, m, say nothing of the pipe there.
_BEHIND, _AHEAD = 6.0, 2.0
# Neighbours err alike, by the pose and by the bend that is not known.
_ECHO_WEIGHT = 0.2
# Edges of this share of the radius on both sides of a contour could as well be it.
_DOUBT, _LEAST_DOUBT = 0.2, 0.03
# Where the echoes tell the distance, only edges within so many of its standard deviations.
_DOUBT_SIGMAS = 2.5
# The strongest gradient lies outside of the contour: px at 1200 px width, of one image by rendered
# seas at 2 m.
_EDGE_OUTSIDE = 1.2
# Standard deviation of a lone clean edge, px at 1200 px width, and what is added for each square px
# of the spread of all edges near it: most of what is spread widely is no contour.
_CLEAN_EDGE, _SPREAD_SHARE = 0.4, 0.28
# Echoes that make the distance known.
LEAST_HITS = 3
# A frame without a past, and the echoes alone: left, up, heading, pitch, bend left, bend up. What
# lies on the bed bends little upward.
_LOOSE = np.array([10.0, 10.0, 3.0, 0.3, 0.03, 0.01])
_ALONG_ECHOES = np.array([0.005, 10.0, 0.005, 0.15, 0.005, 0.01])
# Standard deviations of height and pitch are this much larger in a prior: the square root of 2.
_COUNTED_TWICE = 1.4
_DEPTH_WIDTHS = ((40.0, 24.0, 12.0), (6.0, 4.0, 4.0))
# Where fits begin: left in _ASIDE m, up in standard deviations of the depth.
_ASIDE = 0.03
_STARTS = tuple((aside, 0) for aside in (0, -1, 1, -2, 2)) + tuple(
    (aside, climb) for aside in (0, -1, 1) for climb in (-1, 1)
)
# Clarity that a px of spread takes, at 1200 px width.
_SPREAD_COST = 0.12
# So much less clarity is e times less likely; fits nearer than that, m, are one.
_UNCLEAR, _SAME = 0.035, 0.004
_USED = 0.2
# Edges are looked at so near to the contours, as a share of the radius.
_NEAR = 0.7
_WIDTHS = ((12.0, 6.0, 4.0), (6.0, 4.0, 4.0), (4.0, 4.0, 4.0))
_GATES = (10.0, 6.0, 4.0)


@dataclass(frozen=True)
class MonoFit:
    """An axis fitted to one image.

    Attributes:
        fit: the fit, or the mean of several.
        support: of the contours of the likeliest.
        hits: number of echoes that met the pipe.
        spread: see ``edge_spread``, of the worse contour.
    """

    fit: AxisFit
    support: Support
    hits: int
    spread: float

    @property
    def clarity(self) -> float:
        """How much edges are on the contours, and not beside them."""
        least = min((contour.share for contour in self.support.contours), default=0.0)
        return 0.5 * (self.support.contour_share + least) - _SPREAD_COST * self.spread


def echo_hits(echoes: Echoes, axis: Axis, radius: float) -> tuple[Array, Array]:
    """Return where the beam met the pipe, if the pipe lies along an axis.

    The first echo counts: it comes from the place of the pipe that is nearest within the beam.

    Args:
        echoes: in the frame of the axis.
        axis: the axis.
        radius: m.

    Returns:
        Points (K, 3), m, of the echoes whose beam met it; standard deviations (K,), m.
    """
    if not len(echoes):
        return np.zeros((0, 3)), np.zeros(0)
    echoes = _straightened(echoes, axis)
    normals, distances = distances_from_axis(echoes.origins, axis)
    towards = -normals
    cosine = np.clip(np.einsum("ij,ij->i", echoes.directions, towards), -1.0, 1.0)
    off = np.arccos(cosine)
    turn = np.minimum(off, echoes.half_angles)
    aside = towards - cosine[:, None] * echoes.directions
    aside /= np.maximum(np.linalg.norm(aside, axis=1), 1e-12)[:, None]
    ways = np.cos(turn)[:, None] * echoes.directions + np.sin(turn)[:, None] * aside
    # How far the ray passes the axis, in the section across it.
    section = ways - np.einsum("ij,ij->i", ways, _tangents(echoes, axis))[:, None] * _tangents(
        echoes, axis
    )
    section /= np.maximum(np.linalg.norm(section, axis=1), 1e-12)[:, None]
    facing = np.einsum("ij,ij->i", section, towards)
    miss = distances * np.sqrt(np.maximum(0.0, 1.0 - facing**2))
    along = (echoes.origins - axis.point) @ axis.direction
    met = (miss < _HIT_SHARE * radius) & (facing > 0.0) & (distances > radius)
    met &= (along > -_BEHIND) & (along < _AHEAD)
    points = echoes.origins + echoes.distances[:, None] * ways
    sigmas = np.sqrt(echoes.sigmas**2 + _SURFACE**2 + (_WANDER * along) ** 2)
    return points[met], sigmas[met]


def _straightened(echoes: Echoes, axis: Axis) -> Echoes:
    """Move echoes to the side by as much as the pipe there was beside the axis as it goes on.

    Off the middle of its round a beam meets the pipe lower: a bend that is not known would look
    like a slope.
    """
    if not len(echoes.passed):
        return echoes
    left = np.cross(-echoes.directions.mean(axis=0), axis.direction)
    left /= max(float(np.linalg.norm(left)), 1e-9)
    along = (echoes.passed - axis.point) @ axis.direction
    order = np.argsort(along)
    along, passed = along[order], echoes.passed[order]
    bends = 0.5 * np.square(along)[:, None] * axis.bend
    aside = (passed - axis.point - along[:, None] * axis.direction - bends) @ left
    t = (echoes.origins - axis.point) @ axis.direction
    nearest = np.abs(t[:, None] - along).min(axis=1)
    shift = np.where(nearest < _PASSED_NEAR, np.interp(t, along, aside), 0.0)
    return replace(echoes, origins=echoes.origins - shift[:, None] * left)


def _tangents(echoes: Echoes, axis: Axis) -> Array:
    t = (echoes.origins - axis.point) @ axis.direction
    tangents = axis.direction + t[:, None] * axis.bend
    unit: Array = tangents / np.linalg.norm(tangents, axis=1)[:, None]
    return unit


def edge_spread(
    frame: VectorizedStereo, axis: Axis, radius: float, doubt: float
) -> tuple[float, float]:
    """Measure how far edges along the pipe lie from its left and from its right contour.

    Args:
        frame: the vectorized image.
        axis: the axis.
        radius: m.
        doubt: how far from the contour, as a share of the radius, edges are counted.

    Returns:
        Root of the mean square of their distances, weighted by length, px at 1200 px width; 0
        where there are none. Where ``doubt`` is wide, 1.25 times the mean distance, the same for a
        bell-shaped spread: a lone piece of clutter far off would rule a square.
    """
    camera = frame.rig.left
    segments = frame.left_segments.astype(np.float64)
    if not len(segments):
        return 0.0, 0.0
    measured = rays_to_axis(unit_rays(segments.reshape(-1, 2), camera), camera, axis)
    scale = camera.fx / np.maximum(measured[:, 1], 0.05) * REFERENCE_WIDTH / camera.width
    length = np.hypot(*(segments[:, 2:] - segments[:, :2]).T) * REFERENCE_WIDTH / camera.width
    aside = measured[:, 0].reshape(-1, 2)
    off = (np.abs(aside) - radius) * scale.reshape(-1, 2)
    seen = (measured[:, 1].reshape(-1, 2) > 0).all(axis=1)
    seen &= (np.abs(measured[:, 2]).reshape(-1, 2) < SPAN).all(axis=1)
    near = (np.abs(np.abs(aside) - radius) < doubt * radius).all(axis=1)
    along = np.abs(off[:, 0] - off[:, 1]) < np.maximum(0.12 * length, 1.5)
    spreads = []
    for side in (-1.0, 1.0):
        own = seen & near & along & (np.sign(aside) == side).all(axis=1)
        weight = length[own]
        total = max(float(weight.sum()), 1e-9)
        if doubt < _DOUBT:
            square = np.mean(off[own] ** 2, axis=1)
            spreads.append(float(np.sqrt((weight * square).sum() / total)))
        else:
            mean = np.mean(np.abs(off[own]), axis=1)
            spreads.append(1.25 * float((weight * mean).sum() / total))
    return spreads[0], spreads[1]


def fit_mono(
    frame: VectorizedStereo,
    start: Axis,
    radius: float,
    vertical: Array,
    echoes: Echoes,
    prior: Prior | None = None,
) -> MonoFit | None:
    """Fit the axis to its contours in one image and to the echoes that met it.

    Args:
        frame: the vectorized image.
        start: rough axis, left optical frame.
        radius: m.
        vertical: unit vector up, left optical frame.
        echoes: in the left optical frame.
        prior: how well the start is known.

    Returns:
        The fit, its origin in the middle of the view; None where it went astray.
    """
    axis = start.moved(middle_of_view(start, frame.rig.left))
    if prior is None and len(echo_hits(echoes, axis, radius)[0]) >= LEAST_HITS:
        # How steep it is, the echoes tell better than one image.
        axis = _levelled(axis, vertical)
    axis, doubt, heard = _at_depth(axis, radius, vertical, echoes)
    axis = axis.moved(middle_of_view(axis, frame.rig.left))
    task = _Task(frame, radius, vertical, echoes, _loosened(prior, axis), doubt)
    if doubt >= _DOUBT:
        if prior is not None:
            # Followed without echoes: only edges within what the frame before leaves open.
            task = replace(task, doubt=_doubt_of(float(prior.sigmas[1]), axis))
        return task.fit_from(axis)
    left, up = across(axis.direction, vertical)
    rise = float(np.sqrt(heard[0, 0]))

    # From the frame before to the side, from the echoes in height.
    def surprise(fit: AxisFit) -> float:
        aside = _step(fit, task.prior.axis)[[0, 2]] / task.prior.sigmas[[0, 2]]
        climb = _step(fit, axis)[[1, 3]]
        return 0.5 * float(aside @ aside + climb @ np.linalg.solve(heard, climb))

    found = []
    for brighter in (1.0, -1.0):
        alike = replace(task, frame=_alike(frame, axis, radius, brighter))
        for aside, climb in _STARTS:
            point = axis.point + aside * _ASIDE * left + climb * rise * up
            fitted = alike.fit_from(Axis(point, axis.direction, axis.bend))
            if fitted is not None:
                found.append(fitted)
    if not found:
        return None
    return _blend(found, [surprise(fitted.fit) for fitted in found])


def _alike(frame: VectorizedStereo, axis: Axis, radius: float, brighter: float) -> VectorizedStereo:
    """Keep the edges near the contours whose outer side is the brighter (1) or the darker one (-1).

    The left edge of the pipe's bright middle and the right edge of its shadow are as far apart as
    its contours, but one has its brighter side within, the other without.
    """
    camera = frame.rig.left
    segments = frame.left_segments.astype(np.float64)
    ways = segments[:, 2:] - segments[:, :2]
    middles = 0.5 * (segments[:, 2:] + segments[:, :2])
    # The brighter side is to the right of the way from 1 to 2.
    beside = (
        middles
        + np.stack((-ways[:, 1], ways[:, 0]), axis=1)
        / np.maximum(np.linalg.norm(ways, axis=1), 1e-9)[:, None]
    )
    here, there = (
        np.abs(rays_to_axis(unit_rays(places, camera), camera, axis)[:, 0])
        for places in (middles, beside)
    )
    kept = ((there - here) * brighter > 0.0) & (np.abs(here - radius) < _NEAR * radius)
    return replace(frame, left_segments=frame.left_segments[kept])


def _blend(found: list[MonoFit], surprises: list[float]) -> MonoFit:
    """Take the mean of the fits, each as likely as it is clear and as it was to be expected.

    Beside each contour run edges of shadow, foot and growth; several pairs of them are as wide as
    the echoes say. They lie to both sides of the true one.
    """
    costs = np.array(surprises) - [fitted.clarity / _UNCLEAR for fitted in found]
    order = np.argsort(costs)
    best = found[order[0]]
    steps = np.array([_step(best.fit, fitted.fit.axis) for fitted in found])
    kept: list[int] = []
    for k in order:
        # Several starts lead to the same pair of edges.
        if all(np.abs(steps[k] - steps[j])[:2].max() > _SAME for j in kept):
            kept.append(int(k))
    weights = np.exp(costs[kept[0]] - costs[kept])
    weights /= weights.sum()
    mean = weights @ steps[kept]
    covariance = best.fit.covariance.copy()
    covariance[:4, :4] = 0.0
    for weight, k in zip(weights, kept, strict=True):
        off = steps[k] - mean
        covariance[:4, :4] += weight * (found[k].fit.covariance[:4, :4] + np.outer(off, off))
    fit = best.fit
    axis = Axis(
        fit.axis.point + mean[0] * fit.left + mean[1] * fit.up,
        fit.axis.direction + mean[2] * fit.left + mean[3] * fit.up,
        fit.axis.bend,
    ).moved(0.0)
    mean_fit = replace(fit, axis=axis, covariance=covariance)
    return MonoFit(mean_fit, best.support, best.hits, best.spread)


def _step(fit: AxisFit, axis: Axis) -> Array:
    """Return left, up (m), heading and pitch (rad) of an axis beside a fitted one."""
    there = axis.moved(float((fit.axis.point - axis.point) @ axis.direction))
    off, turn = there.point - fit.axis.point, there.direction - fit.axis.direction
    return np.array([off @ fit.left, off @ fit.up, turn @ fit.left, turn @ fit.up])


@dataclass(frozen=True)
class _Task:
    """What all fits of a frame have in common."""

    frame: VectorizedStereo
    radius: float
    vertical: Array
    echoes: Echoes
    prior: Prior
    doubt: float

    def fit_from(self, start: Axis) -> MonoFit | None:
        """Fit from one start; None where it goes astray."""
        frame, radius = self.frame, self.radius
        axis = start
        fit: AxisFit | None = None
        for gate, widths in zip(_GATES, _WIDTHS, strict=True):
            evidence = _evidence(frame, axis, radius, self.echoes, gate, self.doubt)
            if len(evidence.rays) < 4:
                return None
            fit = fit_axis(axis, radius, evidence, self.vertical, self.prior, widths)
            numbers = np.concatenate((fit.axis.point, fit.axis.direction, fit.axis.bend))
            if not np.isfinite(numbers).all() or fit.axis.point[2] <= radius:
                return None
            axis = fit.axis.moved(middle_of_view(fit.axis, frame.rig.left))
        if fit is None or float(axis.direction @ start.direction) < 0.9:
            return None
        return MonoFit(
            fit=replace(fit, axis=axis),
            support=Support(contour_support(frame, axis, radius), 0, 0.0, 0.0, 0.0),
            hits=int(np.count_nonzero(fit.point_weights > _USED)),
            spread=max(edge_spread(frame, axis, radius, self.doubt)),
        )


def _loosened(prior: Prior | None, axis: Axis) -> Prior:
    """Return the prior with what it says of the depth believed less.

    Half of that came from echoes that are heard again and from a stretch that is still in view: it
    would be counted anew in each frame.
    """
    if prior is None:
        return Prior(axis, _LOOSE)
    sigmas = _LOOSE.copy()
    sigmas[[0, 2]] = prior.sigmas[[0, 2]]
    sigmas[[1, 3]] = _COUNTED_TWICE * prior.sigmas[[1, 3]]
    return Prior(prior.axis, sigmas)


def _at_depth(
    axis: Axis, radius: float, vertical: Array, echoes: Echoes
) -> tuple[Axis, float, Array]:
    """Move an axis to where the echoes say that the pipe is, in its own vertical plane.

    The edges near a contour all look like one; only from about the right distance is the right one
    the nearest.

    Returns:
        The axis; how far from its contours, as a share of the radius, others could be it; and the
        2 x 2 covariance of its height and pitch.
    """
    axis = _below_echoes(axis, radius, vertical, echoes)
    doubt, covariance = _DOUBT, np.diag(np.square(_LOOSE[[1, 3]]))
    for widths in _DEPTH_WIDTHS:
        points, sigmas = echo_hits(echoes, axis, radius)
        if len(points) < LEAST_HITS:
            return axis, _DOUBT, covariance
        none = np.zeros(0)
        evidence = Evidence(
            points, sigmas, np.zeros((0, 3)), np.zeros((0, 3)), none, none, none, _ECHO_WEIGHT
        )
        straight = Axis.straight(axis.point, axis.direction)
        fit = fit_axis(straight, radius, evidence, vertical, Prior(straight, _ALONG_ECHOES), widths)
        axis = fit.axis
        covariance = fit.covariance[np.ix_([1, 3], [1, 3])]
        doubt = _doubt_of(float(np.sqrt(covariance[0, 0])), axis)
    return axis, doubt, covariance


def _doubt_of(height_sigma: float, axis: Axis) -> float:
    """Return how far from a contour, as a share of the radius, edges could as well be it."""
    sigma = height_sigma / max(float(np.linalg.norm(axis.point)), 0.1)
    return float(np.clip(_DOUBT_SIGMAS * sigma, _LEAST_DOUBT, _DOUBT))


def _levelled(axis: Axis, vertical: Array) -> Axis:
    level = axis.direction - vertical * float(axis.direction @ vertical)
    if float(np.linalg.norm(level)) < 0.5:
        return axis
    return Axis.straight(axis.point, level)


def _below_echoes(axis: Axis, radius: float, vertical: Array, echoes: Echoes) -> Axis:
    """Move an axis up or down until the middle one of the echoes came from its upper side.

    A fit alone may end above the echoes: from there, too, they are a radius away.
    """
    points, _ = echo_hits(echoes, axis, radius)
    if len(points) < LEAST_HITS:
        return axis
    left, up = across(axis.direction, vertical)
    t = (points - axis.point) @ axis.direction
    off = points - (axis.point + t[:, None] * axis.direction + 0.5 * (t * t)[:, None] * axis.bend)
    top = np.sqrt(np.maximum(radius**2 - np.square(off @ left), 0.0))
    climb = float(np.median(off @ up - top))
    return Axis(axis.point + climb * up, axis.direction, axis.bend)


def _evidence(
    frame: VectorizedStereo,
    axis: Axis,
    radius: float,
    echoes: Echoes,
    gate: float,
    doubt: float,
) -> Evidence:
    camera = frame.rig.left
    scale = camera.width / REFERENCE_WIDTH
    rays, sides, weights = contour_rays(
        frame.left_segments, camera, axis, radius, max(gate * scale, 2.0)
    )
    sigmas = np.empty(len(rays))
    for side, spread in zip((-1.0, 1.0), edge_spread(frame, axis, radius, doubt), strict=True):
        own = sides == side
        # All edges of one side are one sight of the contour: they are off together.
        weights[own] /= max(float(weights[own].sum()), 1.0)
        sigmas[own] = (
            max(np.hypot(_CLEAN_EDGE, _SPREAD_SHARE * spread * spread) * scale, 0.5) / camera.fx
        )
    rays = _inward(rays, sides, axis, _EDGE_OUTSIDE * scale / camera.fx)
    points, point_sigmas = echo_hits(echoes, axis, radius)
    return Evidence(
        points=points,
        point_sigmas=point_sigmas,
        rays=rays,
        origins=np.broadcast_to(camera.centre, rays.shape),
        sides=sides,
        ray_sigmas=sigmas,
        ray_weights=weights,
        point_weight=_ECHO_WEIGHT,
    )


def _inward(rays: Array, sides: Array, axis: Axis, angle: float) -> Array:
    """Turn rays of contours towards the axis."""
    right = np.cross(rays, axis.direction)
    right /= np.maximum(np.linalg.norm(right, axis=1), 1e-9)[:, None]
    turned = rays - (sides * angle)[:, None] * right
    unit: Array = turned / np.linalg.norm(turned, axis=1)[:, None]
    return unit
