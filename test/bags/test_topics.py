"""Which topics a replay takes, and what it says where that is not clear."""

from __future__ import annotations

from typing import Any

import pytest

from pipeline_tracker.bags.reader import BagTopic
from pipeline_tracker.bags.topics import ReplayTopics, find_topics
from pipeline_tracker.errors import BagError
from pipeline_tracker.settings_io import settings_from_values

IMAGE = "sensor_msgs/msg/Image"
PACKED = "sensor_msgs/msg/CompressedImage"
INFO = "sensor_msgs/msg/CameraInfo"
POSE = "geometry_msgs/msg/PoseStamped"
POSE_COV = "geometry_msgs/msg/PoseWithCovarianceStamped"
ODOMETRY = "nav_msgs/msg/Odometry"

STEREO = {
    "/stereo/left/image_rect": IMAGE,
    "/stereo/right/image_rect": IMAGE,
    "/stereo/left/camera_info": INFO,
    "/stereo/right/camera_info": INFO,
    "/vnm/pose": POSE,
}


def find(types: dict[str, str], counts: dict[str, int] | None = None, **settings: Any) -> Any:
    topics = {n: BagTopic(n, t, (counts or {}).get(n, 5)) for n, t in types.items()}
    values = {"pipe.diameter": 0.6, **{k.replace("__", "."): v for k, v in settings.items()}}
    return find_topics("BAG", topics, settings_from_values(values))


def refusal(types: dict[str, str], **settings: Any) -> str:
    with pytest.raises(BagError) as caught:
        find(types, **settings)
    line = str(caught.value)
    assert line.startswith("BAG: ")
    assert "\n" not in line
    return line


def without(*names: str) -> dict[str, str]:
    return {n: t for n, t in STEREO.items() if n not in names}


def test_the_usual_names() -> None:
    assert find(STEREO) == ReplayTopics(
        left_image="/stereo/left/image_rect",
        right_image="/stereo/right/image_rect",
        left_info="/stereo/left/camera_info",
        right_info="/stereo/right/camera_info",
        pose="/vnm/pose",
        pose_type="pose",
        transforms="",
        rectified=True,
    )


@pytest.mark.parametrize(
    ("pattern", "info"),
    [
        ("/{}/image_rect", "/{}/camera_info"),
        ("/auv/stereo/{}/image_rect_color", "/auv/stereo/{}/camera_info"),
        ("/camera_{}/image_rect", "/camera_{}/camera_info"),
        ("/zed/{}/image_rect/compressed", "/zed/{}/camera_info"),
        ("/{}_camera/image", "/{}_camera/camera_info"),
        ("/pipeline_inspection/{}/image_rect", "/pipeline_inspection/{}/camera_info"),
        ("/stereo/image_{}", "/stereo/{}_info"),
    ],
)
def test_names_by_pattern(pattern: str, info: str) -> None:
    kind = PACKED if pattern.endswith("compressed") else IMAGE
    types = {pattern.format(s): kind for s in ("left", "right")}
    types |= {info.format(s): INFO for s in ("left", "right")}
    found = find(types)
    assert (found.left_image, found.right_image) == (
        pattern.format("left"),
        pattern.format("right"),
    )
    assert (found.left_info, found.right_info) == (info.format("left"), info.format("right"))
    assert found.pose == ""


def test_rectified_goes_before_raw_and_uncompressed_before_compressed() -> None:
    types = {
        **STEREO,
        **{f"/stereo/{s}/image_raw": IMAGE for s in ("left", "right")},
        **{f"/stereo/{s}/image_rect/compressed": PACKED for s in ("left", "right")},
    }
    assert find(types).left_image == "/stereo/left/image_rect"
    rect = {n: t for n, t in types.items() if not n.endswith("image_rect")}
    found = find(rect)
    assert found.left_image == "/stereo/left/image_rect/compressed"
    assert found.right_image == "/stereo/right/image_rect/compressed"
    assert found.left_info == "/stereo/left/camera_info"


def test_raw_names_are_taken_but_not_as_rectified() -> None:
    types = {n.replace("image_rect", "image_raw"): t for n, t in STEREO.items()}
    found = find(types)
    assert found.left_image == "/stereo/left/image_raw"
    assert not found.rectified
    named = find(types, topics__left_image="/stereo/left/image_raw")
    assert named.rectified, "whoever names the topic answers for it"


def test_truth_results_and_pictures_for_people_are_never_taken() -> None:
    types = {
        **STEREO,
        "/ground_truth/left/image_rect": IMAGE,
        "/ground_truth/pose": POSE,
        "/pipeline/debug/image/compressed": PACKED,
        "/stereo/left/depth": IMAGE,
        "/stereo/disparity": IMAGE,
        "/debug/left/image_rect": IMAGE,
        "/move_base/goal_pose": POSE,
    }
    assert find(types) == find(STEREO)
    only_truth = {**without("/vnm/pose"), "/ground_truth/pose": POSE, "/goal_pose": POSE}
    assert find(only_truth).pose == ""


def test_topics_without_messages_do_not_count() -> None:
    assert find(STEREO, {"/vnm/pose": 0}).pose == ""
    with pytest.raises(BagError, match="--mono"):
        find(STEREO, {"/stereo/right/image_rect": 0})


def test_no_images() -> None:
    line = refusal({"/vnm/pose": POSE, "/imu": "sensor_msgs/msg/Imu"})
    assert "no images in the bag, expected sensor_msgs/Image or CompressedImage" in line
    assert "/imu (sensor_msgs/msg/Imu)" in line


@pytest.mark.parametrize(
    "name", ["/stereo/left/image_rect", "/cam/image_rect", "/right/image_rect"]
)
def test_one_camera_only_names_mono(name: str) -> None:
    types = {name: IMAGE, f"{name.rsplit('/', 1)[0]}/camera_info": INFO}
    line = refusal(types)
    assert f"images of one camera only ({name})" in line
    assert "--mono" in line
    found = find(types, mode="mono")
    assert (found.left_image, found.right_image, found.right_info) == (name, "", "")


def test_mono_takes_the_left_of_two() -> None:
    found = find(STEREO, mode="mono")
    assert found.left_image == "/stereo/left/image_rect"
    assert found.right_image == ""


def test_cameras_without_sides_are_listed() -> None:
    types = {"/cam0/image": IMAGE, "/cam1/image": IMAGE, "/cam0/camera_info": INFO}
    types["/cam1/camera_info"] = INFO
    line = refusal(types)
    assert "not clear which topic is the left image: /cam0/image, /cam1/image" in line
    assert "--set topics.left_image=/cam0/image" in line
    found = find(types, topics__left_image="/cam1/image")
    assert (found.left_image, found.right_image) == ("/cam1/image", "/cam0/image")
    assert (found.left_info, found.right_info) == ("/cam1/camera_info", "/cam0/camera_info")


def test_two_stereo_rigs_are_listed() -> None:
    types = {n.replace("/stereo", rig): t for n, t in STEREO.items() for rig in ("/front", "/down")}
    line = refusal(types)
    assert "/down/left/image_rect, /front/left/image_rect" in line
    found = find(types, topics__left_image="/down/left/image_rect")
    assert found.right_image == "/down/right/image_rect"
    assert found.right_info == "/down/right/camera_info"
    found = find(types, topics__right_image="front/right/image_rect")
    assert found.left_image == "/front/left/image_rect"


def test_named_topic_that_is_not_there_or_of_another_type() -> None:
    line = refusal(STEREO, topics__left_image="/cam/image")
    assert "topics.left_image=/cam/image is not in the bag" in line
    assert "/stereo/left/image_rect" in line
    line = refusal(STEREO, topics__left_image="/vnm/pose")
    assert (
        "/vnm/pose has the type geometry_msgs/msg/PoseStamped, expected sensor_msgs/msg/I" in line
    )
    assert "--set topics.left_image=" in line
    line = refusal(STEREO, topics__pose="/stereo/left/image_rect")
    assert "topics.pose" in line


def test_missing_camera_info() -> None:
    infos = ("/stereo/left/camera_info", "/stereo/right/camera_info")
    line = refusal(without(*infos))
    assert "no camera info (sensor_msgs/CameraInfo) in the bag for /stereo/left/image_rect" in line
    types = {**without(*infos), "/a/camera_info": INFO, "/b/camera_info": INFO}
    line = refusal(types)
    assert "/a/camera_info, /b/camera_info" in line
    assert "--set topics.left_info=/a/camera_info" in line


@pytest.mark.parametrize(
    ("types", "expected"),
    [
        ({"/vnm/pose": POSE, "/vnm/odometry": ODOMETRY}, ("/vnm/pose", "pose")),
        ({"/vnm/odometry": ODOMETRY, "/dvl/pose": POSE}, ("/vnm/odometry", "odometry")),
        ({"/auv/pose": POSE_COV}, ("/auv/pose", "pose_with_covariance")),
        ({"/vnm/pose": ODOMETRY}, ("/vnm/pose", "odometry")),
        ({"/odometry/filtered": ODOMETRY}, ("/odometry/filtered", "odometry")),
        ({}, ("", "pose")),
    ],
)
def test_pose_by_name_and_whatever_type_the_bag_has(
    types: dict[str, str], expected: tuple[str, str]
) -> None:
    found = find({**without("/vnm/pose"), **types})
    assert (found.pose, found.pose_type) == expected


def test_poses_that_are_equally_good_are_listed() -> None:
    types = {**without("/vnm/pose"), "/a/odom": ODOMETRY, "/b/pose": POSE}
    line = refusal(types)
    assert "not clear which topic is the vehicle's pose: /a/odom, /b/pose" in line
    assert "--set topics.pose=/a/odom" in line
    assert find(types, topics__pose="/b/pose").pose_type == "pose"
    assert find(types, pose_type="odometry").pose == "/a/odom"


def test_static_transforms() -> None:
    types = {**STEREO, "/tf": "tf2_msgs/msg/TFMessage", "/tf_static": "tf2_msgs/msg/TFMessage"}
    assert find(types).transforms == "/tf_static"


RANGE = "sensor_msgs/msg/Range"


def test_the_echo_sounder_is_looked_for_in_mono_only() -> None:
    types = {**STEREO, "/altimeter/range": RANGE, "/ground_truth/range": RANGE}
    assert find(types).range == ""
    assert find(types, mode="mono").range == "/altimeter/range"
    assert find(STEREO, mode="mono").range == ""
    assert find({**STEREO, "/sonar": RANGE}, mode="mono", topics__range="sonar").range == "/sonar"


def test_two_echo_sounders_are_not_guessed_between() -> None:
    types = {**STEREO, "/front/range": RANGE, "/down/range": RANGE}
    assert "--set topics.range=/down/range" in refusal(types, mode="mono")
