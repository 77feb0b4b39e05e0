"""Ray tracing of one camera's image.

A pixel of a smooth surface takes one ray, through its centre, with textures band-limited to the
pixel. A pixel with the outline of the pipe in it, or of another thing that has a clear one, takes
16, spread evenly over its area: there the share of rays is the share of the area, and borders are
true below the pixel. Where bed, stones and weed hide one another there are 4. Shadows are looked
for at every second pixel each way, and at all between where these differ; near their borders 16
rays go to points spread over the lamp.
"""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.simulation.landing import (
    BED,
    FIRST_THING,
    LUMP,
    NOTHING,
    PIPE,
    STONE,
    TUFT,
    Landed,
    land,
    shadow_rays,
    sight_lines,
)
from pipeline_tracker.simulation.lens import Lens, lenses_of
from pipeline_tracker.simulation.light import Water, haze_of, lamps_of
from pipeline_tracker.simulation.scenario import Scenario
from pipeline_tracker.simulation.scene import Scene
from pipeline_tracker.simulation.shading import Eye, Lighting, shade

Array = NDArray[np.float64]
Float32Array = NDArray[np.float32]
Mask = NDArray[np.bool_]

# Rays of a pixel with a border in it. Each has a column and a row of its own (Hammersley's points),
# so that an upright or level border is not rounded to a quarter of a pixel.
_SAMPLES, _FEW = 16, 4
_REVERSED = [0, 8, 4, 12, 2, 10, 6, 14, 1, 9, 5, 13, 3, 11, 7, 15]
_SUBPIXELS = (np.stack([np.arange(_SAMPLES), _REVERSED], axis=1) + 0.5) / _SAMPLES - 0.5
_FEW_SUBPIXELS = (np.stack([np.arange(_FEW), [0, 2, 1, 3]], axis=1) + 0.5) / _FEW - 0.5
# Of the points on a lamp's disc three spread over its rim and the middle, and all others.
_RIM = (9, 6, 3, 0)
_OTHERS = tuple(n for n in range(_SAMPLES) if n not in _RIM)
# Rows of one task.
_BAND = 48
# Shadow rays start this far above the surface, m: the meshes are that coarse.
_LIFT = 0.003
# What has no outline to speak of.
_WEED = (FIRST_THING + TUFT, FIRST_THING + LUMP)
# Neighbours whose ranges differ by more than this many pixel widths have a border between them;
# on a pipe, whose flank falls off steeply, by this many.
_STEP, _FLANK_STEP = 6.0, 40.0


@dataclass(frozen=True)
class Rendering:
    """One camera's image before the sensor.

    Attributes:
        light: (H, W, 3) float32, red, green, blue.
        coverage: (H, W) float32, share of the pixel's area that shows the pipe.
        distance: (H, W) float32, m, along the ray through the pixel's centre; infinite for none.
    """

    light: Float32Array
    coverage: Float32Array
    distance: Float32Array


def _thread_count() -> int:
    """Return how many threads render: as many as the machine has, fewer by OMP_NUM_THREADS."""
    asked = os.environ.get("OMP_NUM_THREADS", "").partition(",")[0].strip()
    limit = int(asked) if asked.isdecimal() else 16
    return max(1, min(os.cpu_count() or 1, limit))


class Renderer:
    """Renders a scene from poses of the vehicle."""

    def __init__(self, scenario: Scenario, scene: Scene, water: Water) -> None:
        """Prepare what is the same for all frames."""
        self._scene = scene
        self._water = water
        self._lamps = lamps_of(scenario.lamps)
        self._lenses = lenses_of(scenario.camera)
        left = scenario.camera.mounting()
        self._mountings = [left @ Pose(np.eye(3), lens.camera.centre) for lens in self._lenses]
        self._hazes = [
            haze_of(lens, self._lamps.moved(mounting.inverse()), water)
            for lens, mounting in zip(self._lenses, self._mountings, strict=True)
        ]
        self._threads = _thread_count()

    def render(self, base: Pose, index: int, scene: Scene | None = None) -> Rendering:
        """Render the image of one camera.

        Args:
            base: world <- base_link.
            index: 0 left camera, 1 right camera.
            scene: the scene with what moves in its place; None: without it.
        """
        lens, pose = self._lenses[index], base @ self._mountings[index]
        lighting = Lighting(self._lamps.moved(base), self._water, self._hazes[index])
        view = _View(scene or self._scene, lighting, lens, pose)
        # Bands don't depend on each other: the image is the same with any number of threads.
        with ThreadPoolExecutor(self._threads) as pool:
            bands = list(pool.map(view.band, range(0, lens.camera.height, _BAND)))
        return Rendering(*(np.concatenate(parts) for parts in zip(*bands, strict=True)))


class _View:
    """One camera at one place."""

    def __init__(self, scene: Scene, lighting: Lighting, lens: Lens, pose: Pose) -> None:
        self._scene, self._lighting, self._lamps = scene, lighting, lighting.lamps
        self._lens, self._camera, self._pose = lens, lens.camera, pose
        self._eye = Eye(pose.translation, 1.0 / lens.matrix[0, 0])
        # Softer shadows reach further over their border: the widest penumbra of a pipe's shadow.
        widest = 0.3 * float(self._lamps.radius.max()) / 2.0 * lens.matrix[0, 0]
        self._soft = int(np.clip(np.ceil(widest), 1, 8))

    def band(self, first: int) -> tuple[Float32Array, Float32Array, Float32Array]:
        """Render rows from ``first`` on: light, coverage and distance."""
        camera, margin = self._camera, self._soft + 1
        last = min(first + _BAND, camera.height)
        top, bottom = max(first - margin, 0), min(last + margin, camera.height)
        shape = (bottom - top, camera.width)
        columns, rows = np.meshgrid(np.arange(shape[1]), np.arange(top, bottom))
        pixels = np.stack((columns.ravel(), rows.ravel()), axis=1).astype(np.float64)
        landed = self._look(pixels)
        lit = self._lit_evenly(landed, shape)
        border = _borders(landed, shape, self._eye.pixel)
        own = slice(first - top, last - top)
        inside = np.zeros(shape, bool)
        inside[own] = True
        self._soften(lit, landed, inside & ~border)
        light = np.empty((len(pixels), 3), np.float32)
        coverage = (landed.kind == PIPE).astype(np.float32)
        plain = np.flatnonzero(inside & ~border)
        light[plain] = self._shade(_part(landed, plain), lit[plain], pixels[plain])
        fine = _outlines(landed, shape)
        for mask, subpixels in ((fine, _SUBPIXELS), (~fine, _FEW_SUBPIXELS)):
            mixed = np.flatnonzero(inside & border & mask)
            light[mixed], coverage[mixed] = self._refine(pixels[mixed], subpixels)
        return (
            light.reshape(*shape, 3)[own],
            coverage.reshape(shape)[own],
            landed.distance.reshape(shape)[own].astype(np.float32),
        )

    def _look(self, pixels: Array) -> Landed:
        """Cast rays through pixels (N, 2)."""
        scene = self._scene
        turn = self._pose.rotation @ self._lens.rotation
        rays = sight_lines(self._lens.sight(pixels), turn)
        origins = np.tile(self._pose.translation.astype(np.float32), (len(rays), 1))
        hits = scene.caster.nearest(origins, rays)
        return land(hits, self._pose.translation, rays, scene.solids)

    def _lit(self, landed: Landed, lamps: Array) -> Float32Array:
        """Tell which places are lit by which of the lamps at (L, 3): (N, L), 0 or 1."""
        lit = np.empty((len(landed.kind), len(lamps)), np.float32)
        for k, lamp in enumerate(lamps):
            lit[:, k] = ~self._scene.caster.blocked(*shadow_rays(landed, lamp, _LIFT))
        return lit

    def _lit_evenly(self, landed: Landed, shape: tuple[int, int]) -> Float32Array:
        """Tell which pixels of a band are lit by which lamps, (H * W, L), 0 or 1.

        A shadow narrower than two pixels may be missed, the border of none.
        """
        anchors = np.zeros(shape, bool)
        anchors[::2, ::2] = True
        known = np.flatnonzero(anchors)
        lit = np.zeros((len(landed.kind), len(self._lamps.position)), np.float32)
        lit[known] = self._lit(_part(landed, known), self._lamps.position)
        near = np.ones((5, 5), np.uint8)
        for k, lamp in enumerate(self._lamps.position):
            bright = anchors & (lit[:, k].reshape(shape) > 0.0)
            some_lit = cv2.dilate(bright.view(np.uint8), near) > 0
            some_dark = cv2.dilate((anchors & ~bright).view(np.uint8), near) > 0
            lit[:, k] = some_lit.ravel()
            open_ = np.flatnonzero(some_lit & some_dark)
            lit[open_, k] = self._lit(_part(landed, open_), lamp[None])[:, 0]
        return lit

    def _soften(self, lit: Float32Array, landed: Landed, where: Mask) -> None:
        """Replace 0 or 1 near the borders of shadows by the share of the lamp's disc in view."""
        for k in range(len(self._lamps.position)):
            fringe = np.flatnonzero(_fringe(lit[:, k], where.shape, self._soft) & where)
            seen = self._points_seen(_part(landed, fringe), k, _RIM)
            lit[fringe, k] = seen / np.float32(len(_RIM))
            # Where rim and middle agree, so do all.
            partly = (seen > 0.0) & (seen < len(_RIM))
            fringe, seen = fringe[partly], seen[partly]
            seen += self._points_seen(_part(landed, fringe), k, _OTHERS)
            lit[fringe, k] = seen / np.float32(_SAMPLES)

    def _points_seen(self, landed: Landed, k: int, points: tuple[int, ...]) -> Float32Array:
        """Count which of the points of lamp k's disc the places see, (N,)."""
        seen = np.zeros(len(landed.kind), np.float32)
        for n in points:
            point = self._lamps.position[k] + self._lamp_shift(n)[k]
            seen += self._lit(landed, point[None])[:, 0]
        return seen

    def _shade(self, landed: Landed, lit: Float32Array, pixels: Array) -> Float32Array:
        shares = (pixels + 0.5) / [self._camera.width, self._camera.height]
        scene = self._scene
        return shade(
            landed,
            lit,
            shares.astype(np.float32),
            self._eye,
            self._lighting,
            scene.solids.tube,
            scene.materials,
        )

    def _refine(self, pixels: Array, subpixels: Array) -> tuple[Float32Array, Float32Array]:
        """Take several rays through each of the pixels (N, 2): light (N, 3), coverage (N,)."""
        light = np.zeros((len(pixels), 3), np.float32)
        coverage = np.zeros(len(pixels), np.float32)
        count = np.float32(len(subpixels))
        for n, shift in enumerate(subpixels):
            moved = pixels + shift
            landed = self._look(moved)
            lit = self._lit(landed, self._lamps.position + self._lamp_shift(n))
            light += self._shade(landed, lit, moved)
            coverage += landed.kind == PIPE
        return light / count, coverage / count

    def _lamp_shift(self, n: int) -> Array:
        """Return the n-th of the points spread over each lamp's disc, from its middle, (L, 3)."""
        # A spiral of equal areas; neighbouring rays of a pixel take distant points.
        k = (5 * n) % _SAMPLES
        reach, angle = np.sqrt((k + 0.5) / _SAMPLES), k * 2.399963
        across = np.cross(self._lamps.direction, [0.1, 0.9, 0.3])
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        other = np.cross(self._lamps.direction, across)
        shift: Array = np.cos(angle) * across + np.sin(angle) * other
        shift *= reach * self._lamps.radius[:, None]
        return shift


def _part(landed: Landed, chosen: NDArray[np.intp]) -> Landed:
    kind, place, normal, local, distance = landed
    return Landed(kind[chosen], place[chosen], normal[chosen], local[chosen], distance[chosen])


def _borders(landed: Landed, shape: tuple[int, int], angle: float) -> Mask:
    """Find pixels with the border of a thing in them, or with one thing before another, (H, W)."""
    kind = landed.kind.reshape(shape).view(np.uint8)
    near = np.ones((3, 3), np.uint8)
    distance = np.minimum(landed.distance, 1e3).reshape(shape)
    step = cv2.dilate(distance, near) - cv2.erode(distance, near)
    border: Mask = cv2.dilate(kind, near) != cv2.erode(kind, near)
    most = np.where(kind == PIPE, np.float64(_FLANK_STEP * angle), _STEP * angle)
    border |= step > most * distance
    return border


def _outlines(landed: Landed, shape: tuple[int, int]) -> Mask:
    """Find pixels with the border of the pipe, or of a thing of clear outline, near, (H, W).

    Where weed hides a piece of it that border is the weed's, which is ragged.
    """
    near = np.ones((3, 3), np.uint8)
    kind = landed.kind.reshape(shape).astype(np.int16)
    weed = np.isin(kind, _WEED)
    highest = cv2.dilate(np.where(weed, np.int16(-2), kind), near)
    lowest = cv2.erode(np.where(weed, np.int16(1000), kind), near)
    clear = np.isin(kind, (NOTHING, BED, STONE, *_WEED), invert=True)
    outline: Mask = (highest > lowest) & (cv2.dilate(clear.view(np.uint8), near) > 0)
    return outline


def _fringe(lit: Float32Array, shape: tuple[int, ...], reach: int) -> Mask:
    """Find pixels with the border of a shadow at most ``reach`` pixels away, (H, W)."""
    near = np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
    lamp = lit.reshape(shape).astype(np.uint8)
    fringe: Mask = cv2.dilate(lamp, near) != cv2.erode(lamp, near)
    return fringe
