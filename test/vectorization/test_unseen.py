"""What a camera has not seen gives neither segments nor matches, and takes none from the rest."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from pipeline_tracker.geometry.camera import Camera, StereoRig
from pipeline_tracker.geometry.unseen import SEEN_WHOLE, Unseen, UnseenPair
from pipeline_tracker.settings_io import settings_from_values
from pipeline_tracker.types import VectorizedStereo
from pipeline_tracker.vectorization.vectorizer import Vectorizer

WIDTH, HEIGHT, DISPARITY = 480, 320, 24
LEFT = Camera(400.0, 400.0, 239.5, 159.5, WIDTH, HEIGHT)
RIG = StereoRig(LEFT, Camera(400.0, 400.0, 239.5, 159.5, WIDTH, HEIGHT, 0.2))


@pytest.fixture(scope="module")
def pair() -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """A textured plane and a bright upright bar at x 100 to 160 of the left picture."""
    rng = np.random.default_rng(3)
    wide = rng.integers(60, 120, (HEIGHT, WIDTH + DISPARITY))
    wide[:, 100:160] += 90
    wide = wide.astype(np.uint8)
    return wide[:, :WIDTH].copy(), wide[:, DISPARITY:].copy()


def vectorized(
    pair: tuple[NDArray[np.uint8], NDArray[np.uint8]], unseen: UnseenPair = SEEN_WHOLE
) -> VectorizedStereo:
    settings = settings_from_values({"pipe.diameter": 0.6})
    return Vectorizer(settings).process(1, RIG, *pair, unseen)


def right_part(x: int) -> Unseen:
    mask = np.zeros((HEIGHT, WIDTH), bool)
    mask[:, x:] = True
    return Unseen(mask)


def test_nothing_comes_from_where_nothing_was_seen(
    pair: tuple[NDArray[np.uint8], NDArray[np.uint8]],
) -> None:
    free = vectorized(pair)
    left, right = right_part(300), right_part(200)
    masked = vectorized(pair, UnseenPair(left, right))
    assert free.left_segments[:, ::2].max() > 440
    assert free.matches[:, 0].max() > 440
    # Half a pixel of the finest level is how far a segment's end may be from its last pixel.
    assert 200 < masked.left_segments[:, ::2].max() < 300
    assert 120 < masked.right_segments[:, ::2].max() < 200
    assert 150 < masked.matches[:, 0].max() < 300 - 8
    assert 120 < masked.matches[:, 2].max() < 200 - 8


def test_the_rest_stays_as_it_was(pair: tuple[NDArray[np.uint8], NDArray[np.uint8]]) -> None:
    free = vectorized(pair)
    masked = vectorized(pair, UnseenPair(right_part(300), None))
    np.testing.assert_array_equal(masked.right_segments, free.right_segments)
    np.testing.assert_array_equal(masked.left_thumbnail, free.left_thumbnail)
    far = free.left_segments[free.left_segments[:, ::2].max(axis=1) < 250]
    assert len(far) > 20
    assert {tuple(row) for row in far} <= {tuple(row) for row in masked.left_segments}
    upright = np.abs(masked.left_segments[:, 3] - masked.left_segments[:, 1]) > 60
    assert upright.any(), "the bar is still there"


def test_a_right_part_alone_takes_matches_but_no_left_segments(
    pair: tuple[NDArray[np.uint8], NDArray[np.uint8]],
) -> None:
    free = vectorized(pair)
    masked = vectorized(pair, UnseenPair(None, right_part(200)))
    np.testing.assert_array_equal(masked.left_segments, free.left_segments)
    assert 0 < len(masked.matches) < len(free.matches)


def test_masks_of_shrunk_pictures_cover_whole_blocks() -> None:
    mask = np.zeros((11, 17), bool)
    mask[4, 7] = True
    unseen = Unseen(mask)
    small = unseen.grown(3, 0)
    assert small.shape == (3, 5)
    assert np.argwhere(small).tolist() == [[1, 2]]
    assert np.argwhere(unseen.grown(3, 1)).tolist() == [
        [v, u] for v in (0, 1, 2) for u in (1, 2, 3)
    ]
    assert unseen.grown(3, 1) is unseen.grown(3, 1)
    # Rows and columns left over belong to the last cell.
    points = [[2.0, 1.0], [2.4, 1.4], [2.6, 1.0], [5.0, 3.0]]
    assert unseen.near(points, 3, 0).tolist() == [True, True, False, False]
    assert unseen.near(np.zeros((0, 2)), 3, 0).shape == (0,)
