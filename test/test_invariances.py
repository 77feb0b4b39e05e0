"""What must not matter to recognition and tracking: place, heading, travel, and the mirror."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from swim import settings_of
from synthetic_world import DOWN, TILTED, Diver, Look, World, level_pose

from pipeline_tracker.geometry.camera import Camera, StereoRig
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.recognition.recognizer import Recognizer
from pipeline_tracker.tracking.tracker import TrackedFrame, Tracker
from pipeline_tracker.types import Contours, PipeSegment, VectorizedStereo

Array = NDArray[np.float64]

SETTINGS = settings_of()


@dataclass(frozen=True)
class Scene:
    """Frames of a vehicle that swims along x over a pipe."""

    diver: Diver
    poses: list[Pose]
    frames: list[VectorizedStereo]

    def track(self, poses: list[Pose], mounting: Pose | None = None) -> list[TrackedFrame]:
        """Track the frames, believing in other poses or another mounting."""
        mounting = mounting or self.diver.mounting
        tracker, recognizer = Tracker(SETTINGS, mounting), Recognizer(SETTINGS, mounting)
        done = []
        for frame, pose in zip(self.frames, poses, strict=True):
            tracked = tracker.begin(frame, pose)
            if tracked is None:
                tracked = tracker.finish(recognizer.recognize(frame))
            done.append(tracked)
        return done


@st.composite
def scenes(draw: st.DrawFn, count: int = 3) -> Scene:
    mounting = draw(st.sampled_from([DOWN, TILTED]))
    world = World.with_pipe(
        heading=draw(st.floats(-0.9, 0.9)),
        aside=draw(st.floats(-0.2, 0.2)),
        slope=draw(st.floats(-0.08, 0.08)),
        height=draw(st.floats(1.8, 3.0)),
        ahead=0.4 if mounting is DOWN else 1.4,
    )
    diver = Diver(world, mounting=mounting, look=Look(spacing=56))
    poses = [level_pose(x=0.15 * k) for k in range(count)]
    seed = draw(st.integers(0, 1000))
    frames = [diver.frame(pose, k * 10**9, seed + k) for k, pose in enumerate(poses)]
    return Scene(diver, poses, frames)


def turned_bits(bits: Contours) -> Contours:
    """The bits seen by who travels the other way: left is right."""
    return Contours(((int(bits) & 0b0101) << 1) | ((int(bits) & 0b1010) >> 1))


def bits_of(segment: PipeSegment) -> list[Contours]:
    """The bits that are set, in their order."""
    return [bit for bit in Contours if bit & segment.visible_contours]


def from_line(point: Array, segment: PipeSegment) -> float:
    """Distance of a point from the line through a segment, m."""
    step = segment.end - segment.start
    return float(np.linalg.norm(np.cross(point - segment.start, step)) / np.linalg.norm(step))


@given(
    scenes(),
    st.floats(-math.pi, math.pi),
    st.tuples(st.floats(-100.0, 100.0), st.floats(-100.0, 100.0), st.floats(-30.0, 30.0)),
)
@settings(max_examples=8)
def test_moving_and_turning_the_world_about_the_vertical_changes_nothing(
    scene: Scene, yaw: float, shift: tuple[float, float, float]
) -> None:
    world = Pose.from_rpy(shift, [0.0, 0.0, yaw])
    here = scene.track(scene.poses)
    there = scene.track([world @ pose for pose in scene.poses])
    for a, b in zip(here, there, strict=True):
        assert replace(a.status, processing_time=0.0) == replace(b.status, processing_time=0.0)
        assert (a.segment is None) == (b.segment is None)
        if a.segment is None or b.segment is None:
            continue
        # The pictures are the same to the bit; what is left is the rounding of poses 100 m away
        # (1e-14), enlarged by the fit's differences of 1e-6.
        assert np.allclose(a.segment.start, b.segment.start, atol=1e-6)
        assert np.allclose(a.segment.end, b.segment.end, atol=1e-6)
        assert np.allclose(a.segment.covariance, b.segment.covariance, rtol=1e-3, atol=1e-9)
        assert a.segment.visible_contours == b.segment.visible_contours


@given(scenes())
@settings(max_examples=8)
def test_travelling_the_other_way_swaps_ends_and_sides_alone(scene: Scene) -> None:
    # The same rig on a vehicle that looks and goes the other way: base_link turned half round.
    half = Pose.from_rpy([0.0, 0.0, 0.0], [0.0, 0.0, math.pi])
    back = [Pose.from_rpy(-pose.translation, [0.0, 0.0, 0.0]) for pose in scene.poses]
    here = scene.track(scene.poses)
    # base_link' = half * base_link, odom' = half * odom.
    there = scene.track(back, half @ scene.diver.mounting)
    signs = np.array([-1.0, 1.0, 1.0, -1.0])
    for k, (a, b) in enumerate(zip(here, there, strict=True)):
        assert a.status.state == b.status.state
        assert (a.segment is None) == (b.segment is None)
        if a.segment is None or b.segment is None:
            continue
        # The vehicle of the second run goes along its own -x: what it is shown moves as before.
        # Its direction is that of its x axis at first, the opposite of the other's.
        assert np.allclose(half.apply(a.segment.start), b.segment.end, atol=1e-5), k
        assert np.allclose(half.apply(a.segment.end), b.segment.start, atol=1e-5), k
        assert b.segment.visible_contours == turned_bits(a.segment.visible_contours)
        expected = a.segment.covariance * np.outer(signs, signs)
        assert np.allclose(b.segment.covariance, expected, rtol=1e-2, atol=1e-8)
        lines = dict(zip(bits_of(a.segment), a.segment.contours, strict=True))
        others = dict(zip(bits_of(b.segment), b.segment.contours, strict=True))
        for bit, line in lines.items():
            other = others[turned_bits(bit)]
            assert np.allclose(other[[2, 3, 0, 1]], line, atol=0.02)


MIRROR = np.diag([1.0, -1.0, 1.0])


def mirrored_segments(segments: NDArray[np.float32], width: int) -> NDArray[np.float32]:
    flipped = segments.copy()
    flipped[:, [0, 2]] = np.float32(width - 1) - segments[:, [0, 2]]
    return flipped


def mirrored(frame: VectorizedStereo) -> VectorizedStereo:
    """The frame seen in a mirror beside the rig: the right camera becomes the left one."""
    left, right = frame.rig.cameras
    width = left.width
    cx = width - 1 - right.cx, width - 1 - left.cx
    rig = StereoRig(
        Camera(right.fx, right.fy, cx[0], right.cy, width, left.height),
        Camera(left.fx, left.fy, cx[1], left.cy, width, left.height, offset=right.offset),
    )
    matches = mirrored_segments(frame.matches, width)[:, [2, 3, 0, 1]]
    return VectorizedStereo(
        frame.stamp_ns,
        rig,
        mirrored_segments(frame.right_segments, width),
        mirrored_segments(frame.left_segments, width),
        matches,
        frame.right_thumbnail[:, ::-1],
        frame.left_thumbnail[:, ::-1],
    )


def mirrored_mounting(mounting: Pose, baseline: float) -> Pose:
    """Where the mirrored left camera (the right one) is, in a base_link mirrored left to right."""
    right = mounting.apply([baseline, 0.0, 0.0])
    return Pose(MIRROR @ mounting.rotation @ np.diag([-1.0, 1.0, 1.0]), MIRROR @ right)


@given(scenes())
@settings(max_examples=8)
def test_the_mirror_swaps_left_and_right_alone(scene: Scene) -> None:
    mounting = mirrored_mounting(scene.diver.mounting, 0.2)
    seen = replace(scene, frames=[mirrored(frame) for frame in scene.frames])
    poses = [
        Pose(MIRROR @ pose.rotation @ MIRROR, MIRROR @ pose.translation) for pose in scene.poses
    ]
    swapped = {
        Contours.LEFT_IMAGE_LEFT: Contours.RIGHT_IMAGE_RIGHT,
        Contours.LEFT_IMAGE_RIGHT: Contours.RIGHT_IMAGE_LEFT,
        Contours.RIGHT_IMAGE_LEFT: Contours.LEFT_IMAGE_RIGHT,
        Contours.RIGHT_IMAGE_RIGHT: Contours.LEFT_IMAGE_LEFT,
    }
    for a, b in zip(scene.track(scene.poses), seen.track(poses, mounting), strict=True):
        assert a.status.state == b.status.state
        assert a.segment is not None
        assert b.segment is not None
        # Face and middle of the view are those of the left camera, another one in the mirror:
        # other points are used, and noise of 0.1 px is 1 mm of depth at 3 m. So the lines agree
        # to a few of their standard deviations.
        bound = 4.0 * math.sqrt(float(np.max(np.diag(a.segment.covariance)[:2])))
        for point in (b.segment.start, b.segment.end):
            assert from_line(MIRROR @ point, a.segment) < bound
        along = a.segment.end - a.segment.start
        other = MIRROR @ (b.segment.end - b.segment.start)
        cosine = along @ other / np.linalg.norm(along) / np.linalg.norm(other)
        assert cosine > math.cos(math.radians(1.0))
        bits = Contours.NONE
        for bit, image in swapped.items():
            if bit & a.segment.visible_contours:
                bits |= image
        assert b.segment.visible_contours == bits
