"""The stereo synchroniser: every image comes out exactly once."""

from __future__ import annotations

from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline_tracker.sync import (
    LATE,
    NO_LEFT,
    NO_RIGHT,
    PAIRED,
    QUEUE_FULL,
    REPEATED,
    Matched,
    StereoSynchroniser,
)

MS = 1_000_000


def synchroniser(
    tolerance: float = 0.002, max_wait: float = 1.0, queue: int = 8
) -> StereoSynchroniser[str]:
    return StereoSynchroniser(tolerance, max_wait, queue)


def shown(outcomes: list[Matched[str]]) -> list[tuple[int | None, int | None, str]]:
    return [
        (
            o.left.stamp_ns // MS if o.left else None,
            o.right.stamp_ns // MS if o.right else None,
            o.reason,
        )
        for o in outcomes
    ]


def test_equal_stamps_pair_at_once_in_either_order() -> None:
    sync = synchroniser()
    assert sync.add_left(0, "a") == []
    assert shown(sync.add_right(0, "b")) == [(0, 0, "")]
    assert sync.add_right(100 * MS, "c") == []
    (pair,) = sync.add_left(100 * MS, "d")
    assert pair.left is not None
    assert pair.right is not None
    assert (pair.left.item, pair.right.item) == ("d", "c")
    assert sync.counts == {PAIRED: 2}
    assert len(sync) == 0


def test_nearest_partner_not_the_first() -> None:
    sync = synchroniser(tolerance=0.050)
    sync.add_left(100 * MS, "left")
    assert sync.add_right(60 * MS, "first") == []
    assert shown(sync.add_right(105 * MS, "nearest")) == []
    assert shown(sync.add_left(200 * MS, "next")) == [(None, 60, NO_LEFT), (100, 105, "")]


def test_right_image_goes_to_the_left_one_it_is_nearest_to() -> None:
    sync = synchroniser(tolerance=0.050)
    sync.add_left(0, "")
    sync.add_right(40 * MS, "")
    sync.add_left(45 * MS, "")
    assert shown(sync.flush()) == [(0, None, NO_RIGHT), (45, 40, "")]


def test_constant_offset_waits_only_for_the_first_pair() -> None:
    sync = synchroniser()
    sync.add_left(0, "")
    assert sync.add_right(MS, "") == [], "a nearer left image might still come"
    assert shown(sync.add_left(100 * MS, "")) == [(0, 1, "")]
    assert shown(sync.add_right(101 * MS, "")) == [(100, 101, "")]
    sync.add_left(200 * MS, "")
    assert shown(sync.add_right(201 * MS, "")) == [(200, 201, "")]


def test_outside_the_tolerance_is_no_pair() -> None:
    sync = synchroniser()
    sync.add_left(0, "")
    assert shown(sync.add_right(3 * MS, "")) == [(0, None, NO_RIGHT)]
    assert shown(sync.flush()) == [(None, 3, NO_LEFT)]


def test_partner_exactly_at_the_tolerance_is_taken() -> None:
    sync = synchroniser()
    sync.add_left(0, "")
    sync.add_right(2 * MS, "")
    assert shown(sync.flush()) == [(0, 2, "")]


def test_missing_right_image_costs_only_its_own_left_one() -> None:
    sync = synchroniser()
    out = []
    for i in range(5):
        out += sync.add_left(i * 100 * MS, "")
        if i != 2:
            out += sync.add_right(i * 100 * MS, "")
    assert shown(out) == [
        (0, 0, ""),
        (100, 100, ""),
        (200, None, NO_RIGHT),
        (300, 300, ""),
        (400, 400, ""),
    ]


def test_late_partner_is_counted_as_late() -> None:
    sync = synchroniser(max_wait=0.25)
    out = sync.add_left(0, "")
    for i in range(1, 4):
        out += sync.add_left(i * 100 * MS, "")
    assert shown(out) == [(0, None, NO_RIGHT)]
    assert shown(sync.add_right(0, "")) == [(None, 0, LATE)]
    sync.add_right(100 * MS, "")
    assert shown(sync.add_left(50 * MS, "")) == [(50, None, LATE)]


def test_repeated_stamps() -> None:
    sync = synchroniser()
    sync.add_left(0, "")
    assert shown(sync.add_left(0, "")) == [(0, None, REPEATED)], "while it is held"
    sync.add_right(0, "")
    assert shown(sync.add_left(0, "")) == [(0, None, REPEATED)], "after it was paired"
    assert shown(sync.add_right(0, "")) == [(None, 0, REPEATED)]
    assert sync.counts == {PAIRED: 1, REPEATED: 3}


def test_oldest_gives_way_when_the_queue_is_full() -> None:
    sync = synchroniser(max_wait=60.0, queue=3)
    out = []
    for i in range(5):
        out += sync.add_left(i * 100 * MS, "")
    assert shown(out) == [(0, None, QUEUE_FULL), (100, None, QUEUE_FULL)]
    assert len(sync) == 3


def test_out_of_order_images_still_pair() -> None:
    sync = synchroniser()
    sync.add_left(100 * MS, "")
    sync.add_left(0, "")
    assert shown(sync.add_right(0, "")) == [(0, 0, "")]
    assert shown(sync.add_right(100 * MS, "")) == [(100, 100, "")]


def test_reset_forgets_the_stamps() -> None:
    sync = synchroniser()
    sync.add_left(10_000 * MS, "")
    assert shown(sync.reset()) == [(10_000, None, NO_RIGHT)]
    sync.add_left(0, "")
    assert shown(sync.add_right(0, "")) == [(0, 0, "")]


events = st.lists(st.tuples(st.booleans(), st.integers(0, 60)), max_size=80)


@given(events, st.integers(0, 10), st.integers(1, 40), st.integers(1, 6))
def test_every_image_comes_out_exactly_once(
    images: list[tuple[bool, int]], tolerance: int, max_wait: int, queue: int
) -> None:
    sync: StereoSynchroniser[int] = StereoSynchroniser(tolerance / 1e3, max_wait / 1e3, queue)
    out: list[Matched[int]] = []
    for number, (is_left, stamp) in enumerate(images):
        out += (sync.add_left if is_left else sync.add_right)(stamp * MS, number)
        assert len(sync) <= 2 * queue
    out += sync.flush()
    assert len(sync) == 0
    items = [i.item for o in out for i in (o.left, o.right) if i is not None]
    assert sorted(items) == list(range(len(images)))
    assert sync.counts == Counter(o.reason or PAIRED for o in out)
    for o in out:
        assert (o.left is not None and o.right is not None) == (o.reason == "")
        if o.left and o.right:
            assert abs(o.left.stamp_ns - o.right.stamp_ns) <= tolerance * MS
            assert (images[o.left.item][0], images[o.right.item][0]) == (True, False)
    in_order = [o.left.stamp_ns for o in out if o.left and o.reason not in (LATE, REPEATED)]
    assert in_order == sorted(in_order)


@given(
    st.lists(st.tuples(st.integers(-20, 20), st.booleans(), st.booleans()), max_size=30),
    st.randoms(use_true_random=False),
)
@pytest.mark.parametrize("max_wait", [10.0])
def test_pairs_do_not_depend_on_which_camera_comes_first(
    max_wait: float, frames: list[tuple[int, bool, bool]], random: object
) -> None:
    """Each camera in its own order, the two woven at random: the same pairs."""
    left = [i * 100 * MS for i, (_, has, _) in enumerate(frames) if has]
    right = [i * 100 * MS + j * MS // 10 for i, (j, _, has) in enumerate(frames) if has]
    expected = {
        (i * 100 * MS, i * 100 * MS + j * MS // 10) for i, (j, a, b) in enumerate(frames) if a and b
    }
    sync: StereoSynchroniser[None] = StereoSynchroniser(0.002, max_wait, 100)
    out: list[Matched[None]] = []
    while left or right:
        take_left = bool(left) and (not right or random.random() < 0.5)  # type: ignore[attr-defined]
        if take_left:
            out += sync.add_left(left.pop(0), None)
        else:
            out += sync.add_right(right.pop(0), None)
    out += sync.flush()
    assert {(o.left.stamp_ns, o.right.stamp_ns) for o in out if o.left and o.right} == expected
