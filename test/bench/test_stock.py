"""The stock methods find what they should: a comparison with a broken method says nothing."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from pipeline_tracker.bench.stock import StockMethods, draw_edges, find_skeleton, pixel_hough

Image = NDArray[np.uint8]


@pytest.fixture(scope="module")
def bar() -> Image:
    """A bright bar, 100 px wide, across the picture."""
    image = np.full((300, 400), 60, np.uint8)
    image[100:200] = 180
    return np.asarray(cv2.GaussianBlur(image, (5, 5), 1.0), np.uint8)


@pytest.mark.parametrize("method", ["chain", "lsd", "edlines", "probabilistic_hough"])
def test_each_method_finds_both_edges(bar: Image, method: str) -> None:
    stock = StockMethods()
    if method == "edlines" and not stock.has_edlines:
        with pytest.raises(RuntimeError, match="contrib"):
            stock.edlines(bar)
        return
    found = stock.chain(bar)[0] if method == "chain" else getattr(stock, method)(bar)
    assert found.shape[1] == 4
    assert found.dtype == np.float32
    long = found[np.abs(found[:, 2] - found[:, 0]) > 100]
    rows = long[:, [1, 3]].mean(axis=1)
    for edge in (99.5, 199.5):
        assert np.any(np.abs(rows - edge) < 2.0), rows


def test_no_piece_leads_from_one_contour_to_the_next() -> None:
    image = np.zeros((300, 400), np.uint8)
    for x in (60, 200, 340):
        cv2.circle(image, (x, 150), 40, 255, -1)
    found, spent = StockMethods().chain(image)
    assert len(found) > 12
    assert np.hypot(found[:, 2] - found[:, 0], found[:, 3] - found[:, 1]).max() < 60
    assert set(spent) == {"clahe", "canny", "skeleton", "contours_polygons"}


def test_the_skeleton_is_a_pixel_wide() -> None:
    edges = np.zeros((60, 60), np.uint8)
    edges[20:26, 5:55] = 255
    skeleton = find_skeleton()
    thin = skeleton.apply(edges)
    assert thin.dtype == np.uint8
    expected = 6 if skeleton.name == "none" else 1
    assert np.count_nonzero(thin[:, 30]) == expected


def test_without_any_skeletonization_it_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(cv2, "ximgproc", raising=False)
    monkeypatch.setattr("pipeline_tracker.bench.stock.find_spec", lambda _: None)
    assert find_skeleton().name == "none"


def test_an_empty_picture_has_no_segments() -> None:
    stock, empty = StockMethods(), np.full((200, 200), 90, np.uint8)
    for found in (stock.chain(empty)[0], stock.lsd(empty), stock.probabilistic_hough(empty)):
        assert found.shape == (0, 4)


def test_the_pixel_transform_finds_the_drawn_segments() -> None:
    segments = np.array([[50, 100, 350, 100], [80, 20, 80, 280]], np.float32)
    edges = draw_edges(segments, (400, 300))
    assert np.count_nonzero(edges) == 301 + 261 - 1
    found = pixel_hough(edges, 150).reshape(-1, 2)
    for rho, theta in ((100.0, np.pi / 2), (80.0, 0.0)):
        assert np.any(np.all(np.abs(found - [rho, theta]) < [1.5, 0.02], axis=1))
