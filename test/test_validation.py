"""What is refused of each message, with which field and value, in either world of messages."""

from __future__ import annotations

import math
import random
from typing import Any

import mutations
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline_tracker.bags.typestore import BagMessages
from pipeline_tracker.errors import ImageError, MessageError, PipelineTrackerError
from pipeline_tracker.validation.fields import check_covariance, check_finite
from pipeline_tracker.validation.inputs import check_raw_image
from pipeline_tracker.validation.ours import check_output

NAN, INF = math.nan, math.inf


def live_factory() -> Any:
    pytest.importorskip("rclpy")
    from pipeline_tracker.nodes.conversions import LiveMessages

    return LiveMessages()


@pytest.fixture(
    scope="module",
    params=["rosbags", pytest.param("rclpy", marks=pytest.mark.ros)],
)
def factory(request: pytest.FixtureRequest) -> Any:
    return BagMessages() if request.param == "rosbags" else live_factory()


def put(message: Any, path: str, value: Any) -> None:
    """Set a field; an index in brackets sets an element."""
    *outer, last = path.split(".")
    for name in outer:
        message = getattr(message, name)
    name, _, index = last.rstrip("]").partition("[")
    if not index:
        setattr(message, name, value)
        return
    values = getattr(message, name)
    values[int(index)] = value


@pytest.mark.parametrize("kind", mutations.KINDS)
def test_a_sound_message_is_taken(factory: Any, kind: str) -> None:
    make, read = mutations.KINDS[kind]
    check_finite(make(factory))
    read(make(factory))


REFUSED = [
    ("pose", "header.stamp.sec", -1, r"header\.stamp\.sec is -1, expected at least 0"),
    ("pose", "header.stamp.nanosec", 10**9, "nanosec is 1000000000, expected 0 to 999999999"),
    ("request", "stamp.nanosec", 2**32 - 1, r"stamp\.nanosec is 4294967295"),
    ("pose", "pose.position.y", NAN, r"pose\.position\.y is nan, expected a finite number"),
    ("pose", "pose.position.z", -INF, r"position\.z is -inf"),
    ("pose", "pose.position.x", 1e200, r"position\.x is 1e\+200, .* within 1e\+09 m"),
    ("pose", "pose.orientation.w", NAN, r"pose\.orientation is \[.*nan\], expected a quaternion"),
    ("pose", "pose.orientation.w", 0.5, r"it has norm 0\.\d+"),
    ("odometry", "pose.pose.position.x", INF, r"pose\.pose\.position\.x is inf"),
    ("odometry", "twist.twist.linear.x", NAN, r"twist\.twist\.linear\.x is nan"),
    ("odometry", "twist.covariance[7]", NAN, r"twist\.covariance is nan"),
    ("pose_with_covariance", "pose.covariance[0]", NAN, r"pose\.covariance is nan"),
    (
        "pose_with_covariance",
        "pose.covariance[7]",
        -1.0,
        r"diagonal of pose\.covariance is \[0\.1, -1",
    ),
    (
        "pose_with_covariance",
        "pose.covariance[1]",
        0.05,
        r"at \(0, 1\) and \(1, 0\) is \[0\.05, 0\]",
    ),
    ("transform", "transform.translation.z", NAN, r"transform\.translation\.z is nan"),
    ("transform", "transform.rotation.x", 3.0, r"transform\.rotation is \[3, "),
    ("range", "range", NAN, "range is nan, expected above 0 m"),
    ("range", "range", 0.0, "range is 0, expected above 0 m"),
    ("range", "range", 0.25, r"range is 0\.25, expected 0\.5 to 20 m"),
    ("range", "range", 20.5, r"range is 20\.5, expected 0\.5 to 20 m"),
    ("range", "max_range", 0.25, r"min_range, max_range is \[0\.5, 0\.25\]"),
    ("range", "field_of_view", NAN, "field_of_view is nan"),
    ("range", "variance", -1.0, "variance is -1"),
    ("camera_info", "p[3]", INF, "P has a number that is not finite"),
    ("camera_info", "k[0]", NAN, "K has a number that is not finite"),
    ("camera_info", "p[0]", -120.0, "fx=-120"),
    ("camera_info", "width", 0, "image size is 0 x 120"),
    ("image", "encoding", "yuv422", "encoding 'yuv422' is not taken"),
    ("image", "height", 0, "image is 160 x 0"),
    ("image", "height", 119, "19200 bytes of data, expected 19040"),
    ("image", "step", 161, "19200 bytes of data, expected 19320"),
    ("image", "step", 100, "step is 100, expected at least 160"),
    ("compressed", "data", np.zeros(8, np.uint8), "neither JPEG nor PNG"),
    ("vectorized", "left_segments", np.zeros(7, np.float32), "length of left_segments is 7"),
    ("vectorized", "matches[5]", NAN, "matches is nan, expected pixels of an image of 160 x 120"),
    ("vectorized", "right_segments[0]", 9e9, "right_segments is 9e"),
    ("vectorized", "matches", np.zeros(4 * 1201, np.float32), "number of matches is 1201, .* 1200"),
    (
        "vectorized",
        "left_thumbnail",
        np.zeros(3, np.uint8),
        "length of left_thumbnail is 3, expected 300",
    ),
    ("vectorized", "right_info.width", 0, "number of right_segments is 28, expected at most 0"),
    ("vectorized", "left_info.p[0]", NAN, "left_info: P has a number"),
    ("vectorized", "processing_time", NAN, "processing_time is nan"),
    ("segment", "mode", 2, "mode is 2, expected 0 to 1"),
    ("segment", "technique", 5, "technique is 5"),
    ("segment", "start.x", NAN, r"start\.x is nan"),
    ("segment", "radius", 0.0, "radius is 0, expected above 0 m"),
    ("segment", "covariance[15]", -1e-5, "diagonal of covariance"),
    ("segment", "covariance[1]", NAN, "covariance is nan"),
    ("segment", "support", 1.5, r"support is 1\.5, expected 0 to 1"),
    ("segment", "visible_contours", 7, "number of contours is 2, expected 3"),
    ("segment", "visible_contours", 16, "visible_contours is 16"),
    ("segment", "contours", np.zeros(5, np.float32), "length of contours is 5"),
    ("segment", "contours[0]", INF, "contours is inf"),
    ("status", "state", 3, "state is 3, expected 0 to 2"),
    ("status", "reason", "x" * 1001, "length of reason is 1001"),
    ("status", "support", NAN, "support is nan"),
    ("status", "seconds_since_seen", -0.5, r"seconds_since_seen is -0\.5"),
    ("status", "processing_time", INF, "processing_time is inf"),
    ("relative_state", "heading_misalignment", NAN, "heading_misalignment is nan"),
    ("relative_state", "upper_point.z", INF, r"upper_point\.z is inf"),
    ("relative_state", "side", 4, "side is 4"),
    ("relative_state", "quality", 2.0, "quality is 2"),
    ("relative_state", "speed_variance", -2.0, "speed_variance is -2"),
]


@pytest.mark.parametrize(("kind", "path", "value", "text"), REFUSED)
def test_what_is_refused_with_field_and_value(
    factory: Any, kind: str, path: str, value: Any, text: str
) -> None:
    make, read = mutations.KINDS[kind]
    message = make(factory)
    if isinstance(value, np.ndarray):
        value = factory.sequence(value)
    put(message, path, value)
    with pytest.raises(PipelineTrackerError, match=text) as refused:
        read(message)
    assert "\n" not in str(refused.value)
    if isinstance(refused.value, MessageError):
        assert refused.value.field


def test_what_is_unusual_but_sound_is_taken(factory: Any) -> None:
    unlimited = mutations.ping(factory)
    unlimited.min_range = unlimited.max_range = 0.0
    mutations.KINDS["range"][1](unlimited)
    exact = mutations.odometry(factory)
    exact.pose.covariance[:] = 0.0
    mutations.KINDS["odometry"][1](exact)


def test_a_covariance_is_judged_in_shares_of_its_deviations() -> None:
    # Metres beside radians: an eigenvalue of the whole would drown the fault of the small part.
    scale = np.array([1e3, 1e3, 1e-5, 1e-5])
    shares = np.eye(4)
    shares[2, 3] = shares[3, 2] = 0.9
    check_covariance("c", shares * np.outer(scale, scale), 4)
    shares[2, 3] = shares[3, 2] = 1.1
    with pytest.raises(MessageError, match=r"c at \(2, 3\) .* one number of at most 1e-10"):
        check_covariance("c", shares * np.outer(scale, scale), 4)
    three = np.array([[1.0, 0.9, -0.9], [0.9, 1.0, 0.9], [-0.9, 0.9, 1.0]])
    with pytest.raises(MessageError, match="least eigenvalue of c"):
        check_covariance("c", three * np.outer(scale[1:], scale[1:]), 3)
    # No deviation, yet correlated: it cannot be.
    with pytest.raises(MessageError, match=r"\[0\.001, 0\.001\], expected .* at most 0"):
        check_covariance("c", [0.0, 1e-3, 1e-3, 1.0], 2)
    with pytest.raises(MessageError, match="length of c is 3, expected 4"):
        check_covariance("c", [0.0] * 3, 2)


def test_data_that_is_longer_than_its_rows_is_refused() -> None:
    assert check_raw_image("mono8", 8, 4, 10, 40, 10**6) == 1
    assert check_raw_image("mono8", 8, 4, 10, 38, 10**6) == 1
    for size in (37, 39, 41, 400):
        with pytest.raises(ImageError, match=f"{size} bytes of data, expected 40"):
            check_raw_image("mono8", 8, 4, 10, size, 10**6)


def test_nothing_that_is_not_finite_goes_out(factory: Any) -> None:
    for value in (NAN, INF):
        number = factory.message("std_msgs/msg/Float64", data=value)
        with pytest.raises(MessageError, match="data is"):
            check_output("std_msgs/msg/Float64", number)
    poses = [mutations.pose(factory) for _ in range(3)]
    path = factory.message("nav_msgs/msg/Path", header=poses[0].header, poses=poses)
    check_output("nav_msgs/msg/Path", path)
    poses[1].pose.position.x = NAN
    with pytest.raises(MessageError, match=r"poses\[1\]\.pose\.position\.x is nan"):
        check_output("nav_msgs/msg/Path", path)
    for kind in ("vectorized", "segment", "status", "relative_state"):
        message = mutations.KINDS[kind][0](factory)
        name = {
            "vectorized": "VectorizedStereo",
            "segment": "PipeSegment",
            "status": "TrackingStatus",
            "relative_state": "RelativeState",
        }[kind]
        check_output(f"pipeline_tracker_msgs/msg/{name}", message)
        message.header.stamp.nanosec = 2_000_000_000
        with pytest.raises(MessageError, match="nanosec"):
            check_output(f"pipeline_tracker_msgs/msg/{name}", message)


@pytest.mark.parametrize("kind", mutations.KINDS)
@settings(max_examples=60, deadline=2000)
@given(seed=st.integers(0, 2**32 - 1))
def test_a_mutated_message_is_refused_by_our_error_or_read_to_finite_numbers(
    factory: Any, kind: str, seed: int
) -> None:
    make, read = mutations.KINDS[kind]
    message, changed = mutations.mutated(make(factory), random.Random(seed))  # noqa: S311 - a test's dice
    try:
        made = read(message)
    except PipelineTrackerError as error:
        made, text = None, str(error)
    else:
        text = ""
    assert len(text) < 500, changed
    assert "\n" not in text, changed
    for numbers in numbers_in(made):
        assert np.isfinite(numbers).all(), (changed, made)


def numbers_in(made: Any) -> list[Any]:
    """Return every number and array of what was read."""
    if isinstance(made, tuple | list):
        return [n for item in made for n in numbers_in(item)]
    if hasattr(made, "__dataclass_fields__"):
        return [n for name in made.__dataclass_fields__ for n in numbers_in(getattr(made, name))]
    if isinstance(made, np.ndarray | float | int):
        return [np.asarray(made)]
    return []
