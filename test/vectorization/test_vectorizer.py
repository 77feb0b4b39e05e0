"""A stereo pair as segments, matches and thumbnails: scales, memory, odd input."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from pictures import Bar, stereo_pair, texture

from pipeline_tracker.geometry.camera import Camera, StereoRig
from pipeline_tracker.settings import Settings
from pipeline_tracker.types import VectorizedStereo
from pipeline_tracker.vectorization.vectorizer import Vectorizer, thumbnail

Image = NDArray[np.uint8]

SETTINGS = Settings.model_validate({"pipe": {"diameter": 0.6}})


def rig(image: Image, mono: bool = False) -> StereoRig:
    height, width = image.shape
    f, cx, cy = 0.8 * width, (width - 1) / 2.0, (height - 1) / 2.0
    right = None if mono else Camera(f, f, cx, cy, width, height, offset=0.2)
    return StereoRig(Camera(f, f, cx, cy, width, height), right)


def vectorize(
    left: Image, right: Image | None, vectorizer: Vectorizer | None = None
) -> VectorizedStereo:
    made = vectorizer or Vectorizer(SETTINGS)
    return made.process(5, rig(left, right is None), left, right)


def same(a: VectorizedStereo, b: VectorizedStereo) -> bool:
    names = ("left_segments", "right_segments", "matches", "left_thumbnail", "right_thumbnail")
    return all(np.array_equal(getattr(a, name), getattr(b, name)) for name in names)


def near_edges(segments: NDArray[np.float32], bar: Bar, tolerance: float) -> NDArray[np.bool_]:
    across = bar.across(segments.astype(np.float64).reshape(-1, 2)).reshape(-1, 2)
    return np.asarray((np.abs(np.abs(across) - 0.5 * bar.thickness) < tolerance).all(axis=1))


def lengths(segments: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.asarray(np.hypot(segments[:, 2] - segments[:, 0], segments[:, 3] - segments[:, 1]))


@pytest.mark.parametrize("width", [320, 640, 1200, 1600, 2448, 4008])
def test_edges_are_at_their_place_at_every_width(width: int) -> None:
    bar = Bar(width, width * 2 // 3, 0.35, 0.2 * width, 0.03 * width)
    image = bar.image()
    found = vectorize(image, None).left_segments
    assert found.dtype == np.float32
    # Pictures above 1600 px are shrunk before: half a pixel of what is left, and of the coarsest
    # of the pyramid's levels one pixel.
    shrunk = max(1.0, width / 1600.0)
    on = near_edges(found, bar, 0.5 * shrunk)
    for side in (-1.0, 1.0):
        across = bar.across(found[:, :2].astype(np.float64))
        mine = found[on & (np.sign(across) == side)]
        assert lengths(mine).sum() > 0.85 * bar.visible_length(side)
    coarse = near_edges(found, bar, 0.3 * max(2.0, width / 220.0))
    assert lengths(found[coarse]).sum() > 0.95 * lengths(found).sum()


def test_coarse_levels_see_an_edge_that_fouling_has_torn_up() -> None:
    # An edge that is rough by several pixels from place to place.
    bar = Bar(1200, 800, 0.2, 260.0)
    ys, xs = np.mgrid[0:800, 0:1200]
    rough = texture(xs.astype(np.float64), ys.astype(np.float64), 3, 10.0) - 125.0
    places = np.stack((xs, ys), axis=-1)
    inside = np.abs(bar.across(places)) < 130.0 + 0.06 * rough
    random = np.random.default_rng(1)
    image = np.where(inside, 130.0, 100.0) + random.normal(0.0, 6.0, xs.shape)
    found = vectorize(np.asarray(np.clip(np.rint(image), 0, 255), np.uint8), None).left_segments
    on = near_edges(found, bar, 8.0)
    assert lengths(found[on]).max() > 100.0


def test_the_same_edges_at_a_tenth_of_the_contrast() -> None:
    bar = Bar(640, 430, 1.2, 150.0)
    for levels in ((180.0, 70.0), (131.0, 120.0), (20.0, 9.0)):
        found = vectorize(bar.image(*levels), None).left_segments
        on = near_edges(found, bar, 0.5)
        for side in (-1.0, 1.0):
            across = bar.across(found[:, :2].astype(np.float64))
            mine = found[on & (np.sign(across) == side)]
            assert lengths(mine).sum() > 0.85 * bar.visible_length(side)


def test_a_pair_has_segments_matches_and_thumbnails_of_both_images() -> None:
    left, right = stereo_pair(60.3, width=640, height=400)
    frame = vectorize(left, right)
    assert frame.stamp_ns == 5
    assert frame.rig == rig(left)
    assert len(frame.left_segments) > 50
    assert len(frame.right_segments) > 50
    assert frame.left_thumbnail.shape == frame.right_thumbnail.shape == (50, 80)
    disparity = frame.matches[:, 0] - frame.matches[:, 2]
    assert len(frame.matches) > 300
    assert np.median(np.abs(disparity - 60.3)) < 0.1
    assert frame.processing_time > 0.0


def test_matches_of_a_large_pair_are_given_in_its_own_pixels() -> None:
    left, right = stereo_pair(90.3, width=2000, height=600, seed=2)
    matches = vectorize(left, right).matches
    disparity = matches[:, 0] - matches[:, 2]
    assert len(matches) > 100
    # Matched at half size: a tenth of a pixel there.
    assert np.median(np.abs(disparity - 90.3)) < 0.2
    assert matches[:, 0].max() > 1900


def test_it_has_no_memory() -> None:
    left, right = stereo_pair(30.0, width=480, height=320)
    dark = np.asarray(left // 4, np.uint8)
    used = Vectorizer(SETTINGS)
    fresh = vectorize(left, right)
    for other in (dark, np.zeros_like(left), right):
        vectorize(other, other, used)
        assert same(vectorize(left, right, used), fresh)


def test_views_give_what_copies_give() -> None:
    left, right = stereo_pair(30.0, width=480, height=320)
    fresh = vectorize(left, right)
    fortran = np.asfortranarray(left), np.asfortranarray(right)
    both = np.concatenate((left, right), axis=1)
    wide = both[:, :480], both[:, 480:]
    doubled = np.repeat(np.repeat(left, 2, 0), 2, 1)[::2, ::2]
    for pair in (fortran, wide, (doubled, right)):
        assert not pair[0].flags.c_contiguous
        assert same(vectorize(*pair), fresh)
    read_only = left.copy()
    read_only.setflags(write=False)
    assert same(vectorize(read_only, right), fresh)


def test_the_images_are_left_as_they_were() -> None:
    left, right = stereo_pair(30.0)
    before = left.copy(), right.copy()
    vectorize(left, right)
    assert np.array_equal(left, before[0])
    assert np.array_equal(right, before[1])


@pytest.mark.parametrize(
    "shape", [(1, 1), (3, 200), (200, 3), (7, 7), (8, 8), (15, 17), (16, 16), (33, 50)]
)
def test_tiny_images_are_taken(shape: tuple[int, int]) -> None:
    random = np.random.default_rng(0)
    left, right = (random.integers(0, 255, shape).astype(np.uint8) for _ in range(2))
    frame = vectorize(left, right)
    assert frame.left_segments.shape[1] == frame.matches.shape[1] == 4
    assert frame.left_thumbnail.shape == (shape[0] // 8, shape[1] // 8)


@pytest.mark.parametrize("value", [0, 90, 255])
def test_constant_images_have_nothing_in_them(value: int) -> None:
    image = np.full((240, 320), value, np.uint8)
    frame = vectorize(image, image)
    assert frame.left_segments.shape == frame.right_segments.shape == (0, 4)
    assert frame.matches.shape == (0, 4)
    assert (frame.left_thumbnail == value).all()


def test_mono_has_nothing_of_a_right_image() -> None:
    left, _ = stereo_pair(30.0)
    frame = vectorize(left, None)
    assert len(frame.left_segments) > 0
    assert frame.right_segments.shape == frame.matches.shape == (0, 4)
    assert frame.right_thumbnail.size == 0


def test_min_length_and_spacing_are_settings() -> None:
    left, right = stereo_pair(30.0, width=640, height=400)
    coarse = SETTINGS.model_copy(
        update={
            "vectorization": SETTINGS.vectorization.model_copy(
                update={"min_length": 60.0, "match_spacing": 100}
            )
        }
    )
    few, many = vectorize(left, right, Vectorizer(coarse)), vectorize(left, right)
    assert len(few.left_segments) < len(many.left_segments)
    assert len(few.matches) < 0.5 * len(many.matches)


def test_a_thumbnail_averages_blocks_of_eight() -> None:
    random = np.random.default_rng(1)
    image = random.integers(0, 255, (45, 67)).astype(np.uint8)
    small = thumbnail(image)
    assert small.shape == (5, 8)
    blocks = image[:40, :64].reshape(5, 8, 8, 8).mean(axis=(1, 3))
    # Halved three times, rounded by a half at most each time.
    assert np.abs(small - blocks).max() < 1.5
    assert np.abs(small - blocks).mean() < 0.6
    assert math.isclose(float(small.mean()), float(blocks.mean()), abs_tol=0.5)
