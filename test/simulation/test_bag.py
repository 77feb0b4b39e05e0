from __future__ import annotations

import re
import subprocess
import sys
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from pipeline_tracker import simulation
from pipeline_tracker.bags.fresh import fresh_bag
from pipeline_tracker.cli import run_command
from pipeline_tracker.errors import BagError, PipelineTrackerError
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.simulation import simulate
from pipeline_tracker.simulation.renderer import Renderer
from pipeline_tracker.simulation.scenario import Scenario
from pipeline_tracker.simulation.scenario_files import load_scenario
from pipeline_tracker.simulation.simulator import FIRST_STAMP_NS, Sea, build_sea

from .conftest import SMALL

STORE = get_typestore(Stores.ROS2_JAZZY)


def content(bag: Path) -> dict[str, bytes]:
    return {file.name: file.read_bytes() for file in sorted(bag.iterdir())}


def messages(bag: Path) -> list[tuple[str, int, Any]]:
    with Reader(bag) as reader:
        return [
            (c.topic, stamp, STORE.deserialize_cdr(raw, c.msgtype))
            for c, stamp, raw in reader.messages()
        ]


def pose_of(message: Any) -> Pose:
    p, q = message.position, message.orientation
    return Pose.from_quaternion([p.x, p.y, p.z], [q.x, q.y, q.z, q.w])


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return simulate("demo", tmp_path_factory.mktemp("one") / "sea", SMALL, progress=False)


@pytest.fixture(scope="module")
def read(bag: Path) -> list[tuple[str, int, Any]]:
    return messages(bag)


def test_the_same_seed_gives_the_same_bytes(bag: Path, tmp_path: Path) -> None:
    again = simulate("demo", tmp_path / "sea", SMALL, progress=False)
    assert content(again) == content(bag)


def test_the_number_of_threads_changes_nothing(sea: Sea) -> None:
    base = sea.motion.pose(0.0)
    many = sea.renderer.render(base, 0)
    alone = Renderer(sea.scenario, sea.scene, sea.renderer._water)
    alone._threads = 1
    once = alone.render(base, 0)
    assert np.array_equal(many.light, once.light)
    assert np.array_equal(many.coverage, once.coverage)


def test_another_seed_gives_another_sea(bag: Path, tmp_path: Path) -> None:
    other = messages(simulate("demo", tmp_path / "sea", SMALL, seed=77, progress=False))
    first = messages(bag)
    assert len(other) == len(first)
    for topic in ("/ground_truth/pose", "/ground_truth/centerline", "/altimeter/range"):
        one, two = (next(m for t, _, m in side if t == topic) for side in (first, other))
        assert str(one) != str(two)
    left, right = (
        next(m.data for t, _, m in side if t.startswith("/stereo/left/image"))
        for side in (first, other)
    )
    assert left.tobytes() != right.tobytes()


def test_topics_and_types_of_the_bag(bag: Path, read: list[tuple[str, int, Any]]) -> None:
    with Reader(bag) as reader:
        types = {c.topic: c.msgtype for c in reader.connections}
        latched = {c.topic for c in reader.connections if c.ext.offered_qos_profiles}
    rate = sum(topic == "/vnm/pose" for topic, _, _ in read)
    assert types == {
        "/tf_static": "tf2_msgs/msg/TFMessage",
        "/stereo/left/image_rect/compressed": "sensor_msgs/msg/CompressedImage",
        "/stereo/right/image_rect/compressed": "sensor_msgs/msg/CompressedImage",
        "/stereo/left/camera_info": "sensor_msgs/msg/CameraInfo",
        "/stereo/right/camera_info": "sensor_msgs/msg/CameraInfo",
        "/vnm/pose": "geometry_msgs/msg/PoseStamped",
        "/vnm/odometry": "nav_msgs/msg/Odometry",
        "/altimeter/range": "sensor_msgs/msg/Range",
        "/attitude": "sensor_msgs/msg/Imu",
        "/ground_truth/pose": "geometry_msgs/msg/PoseStamped",
        "/ground_truth/centerline": "nav_msgs/msg/Path",
        "/ground_truth/contours/left": "sensor_msgs/msg/PointCloud2",
        "/ground_truth/contours/right": "sensor_msgs/msg/PointCloud2",
        "/ground_truth/scenario": "std_msgs/msg/String",
    }
    assert latched == {"/tf_static", "/ground_truth/scenario"}
    counts = Counter(topic for topic, _, _ in read)
    assert rate > 12
    for topic, count in counts.items():
        often = topic.startswith(("/vnm", "/altimeter", "/attitude"))
        once = topic in latched
        assert count == (rate if often else 1 if once else 2), topic


def test_stamps_are_in_order_and_the_headers(read: list[tuple[str, int, Any]]) -> None:
    stamps = [stamp for _, stamp, _ in read]
    assert stamps == sorted(stamps)
    frames = {}
    for topic, stamp, message in read:
        if hasattr(message, "header"):
            header = message.header.stamp
            assert header.sec * 10**9 + header.nanosec == stamp
            frames[topic] = message.header.frame_id
    assert frames["/vnm/pose"] == frames["/vnm/odometry"] == "odom"
    assert frames["/ground_truth/pose"] == frames["/ground_truth/centerline"] == "world"
    assert frames["/stereo/left/camera_info"] == "stereo_left_optical"
    assert frames["/stereo/right/image_rect/compressed"] == "stereo_right_optical"
    assert frames["/altimeter/range"] == "altimeter"
    assert frames["/attitude"] == "base_link"
    pairs = [stamp for topic, stamp, _ in read if topic == "/stereo/left/image_rect/compressed"]
    assert pairs == [FIRST_STAMP_NS, FIRST_STAMP_NS + 10**9]


def test_calibration_and_mounting(read: list[tuple[str, int, Any]]) -> None:
    camera = load_scenario("demo", SMALL).camera
    left = next(m for t, _, m in read if t == "/stereo/left/camera_info")
    right = next(m for t, _, m in read if t == "/stereo/right/camera_info")
    focal = camera.width / 2 / np.tan(np.deg2rad(65.5) / 2)
    assert left.p[0] == pytest.approx(focal)
    assert left.p[3] == 0.0
    assert right.p[3] == pytest.approx(-focal * 0.2)
    assert (left.width, left.height) == (192, 128)
    transforms = next(m for t, _, m in read if t == "/tf_static").transforms
    assert [t.child_frame_id for t in transforms] == [
        "stereo_left_optical",
        "stereo_right_optical",
        "altimeter",
    ]
    assert {t.header.frame_id for t in transforms} == {"base_link"}
    places = [np.array([v.x, v.y, v.z]) for v in (t.transform.translation for t in transforms)]
    # The right camera is to starboard; both look ahead and down, 30 degrees from straight down.
    np.testing.assert_allclose(places[0] - places[1], [0.0, 0.2, 0.0], atol=1e-12)
    q = transforms[0].transform.rotation
    sight = Pose.from_quaternion(places[0], [q.x, q.y, q.z, q.w]).rotation[:, 2]
    np.testing.assert_allclose(sight, [0.5, 0.0, -np.sqrt(0.75)], atol=1e-9)
    # The altimeter's beam, along x of its frame as sensor_msgs/Range has it, points down.
    q = transforms[2].transform.rotation
    beam = Pose.from_quaternion(places[2], [q.x, q.y, q.z, q.w]).rotation[:, 0]
    np.testing.assert_allclose(beam, [0.0, 0.0, -1.0], atol=1e-12)


def test_the_odometry_tells_its_covariance(read: list[tuple[str, int, Any]]) -> None:
    found = [m.pose.covariance.reshape(6, 6) for t, _, m in read if t == "/vnm/odometry"]
    first, last = found[0], found[-1]
    assert last[0, 0] > first[0, 0] >= 0.0
    assert (np.linalg.eigvalsh(last) > 0).all()


def test_dropouts_and_mono(tmp_path: Path) -> None:
    wanted = [
        *SMALL,
        "camera.mono=true",
        "vnm.dropouts=[{at: 0.2, duration: 0.5}]",
        "sensors.altimeter_dropouts=[{at: 0.5, duration: 0.4}]",
        "sensors.altimeter_loss=1",
    ]
    read = messages(simulate("demo", tmp_path / "mono", wanted, progress=False))
    topics = {t for t, _, _ in read}
    assert not [t for t in topics if "right" in t]
    assert "/stereo/left/image_rect/compressed" in topics
    children = [
        t.child_frame_id for t in next(m for t, _, m in read if t == "/tf_static").transforms
    ]
    assert children == ["stereo_left_optical", "altimeter"]

    def seconds(topic: str) -> Any:
        return np.array([s - FIRST_STAMP_NS for t, s, _ in read if t == topic]) * 1e-9

    for topic in ("/vnm/pose", "/vnm/odometry"):
        assert not ((seconds(topic) > 0.2) & (seconds(topic) < 0.7)).any()
    heard = seconds("/altimeter/range")
    assert not ((heard > 0.5) & (heard < 0.9)).any()
    assert len(seconds("/attitude")) > max(len(seconds("/vnm/pose")), len(heard)) > 5
    # No echo at all: plus infinity, as ROS has it.
    assert {m.range for t, _, m in read if t == "/altimeter/range"} == {np.inf}


def test_replay_reads_a_mono_bag(tmp_path: Path) -> None:
    simulate("mono", tmp_path / "mono", [*SMALL, "camera.width=480", "camera.height=320"], 3, False)
    command = ["replay", str(tmp_path / "mono"), "--mono", "--output", str(tmp_path / "out")]
    assert run_command([*command, "--set", "pipe.diameter=0.6"]) in {0, 1}
    rows = (tmp_path / "out" / "estimates.csv").read_text().splitlines()
    assert len(rows) == 3


def test_the_cameras_may_differ_and_the_exposure_flicker(tmp_path: Path) -> None:
    def levels(*overrides: str) -> tuple[list[float], list[float]]:
        name = f"sea{len(list(tmp_path.iterdir()))}"
        wanted = [*SMALL, "camera.jpeg_quality=null", "camera.gamma=1", "frames=3", *overrides]
        read = messages(simulate("demo", tmp_path / name, wanted, progress=False))
        sides = [
            [float(m.data.mean()) for t, _, m in read if t == f"/stereo/{side}/image_rect"]
            for side in ("left", "right")
        ]
        return sides[0], sides[1]

    left, right = levels()
    same, brighter = levels("camera.mismatch=0.5")
    assert same == left
    np.testing.assert_allclose(np.array(brighter) / right, 1.5, rtol=0.03)
    left_flicker, right_flicker = levels("camera.exposure_variation=0.3")
    ratios = np.array(left_flicker) / left
    assert ratios.std() > 0.05
    # One exposure control for both cameras.
    np.testing.assert_allclose(np.array(right_flicker) / right, ratios, rtol=0.03)


def test_the_truth_fits_the_poses(read: list[tuple[str, int, Any]], sea: Sea) -> None:
    for n, message in enumerate(m for t, _, m in read if t == "/ground_truth/pose"):
        true = sea.motion.pose(float(n))
        read_pose = pose_of(message.pose)
        np.testing.assert_allclose(read_pose.translation, true.translation, atol=1e-12)
        np.testing.assert_allclose(read_pose.rotation, true.rotation, atol=1e-9)
    mounting = sea.mountings()[1]
    camera = sea.scenario.camera.rig().cameras[1]
    poses = [pose_of(m.pose) for t, _, m in read if t == "/ground_truth/pose"]
    lines = [m for t, _, m in read if t == "/ground_truth/centerline"]
    clouds = [m for t, _, m in read if t == "/ground_truth/contours/right"]
    for base, line, cloud in zip(poses, lines, clouds, strict=True):
        axis = np.array(
            [[p.pose.position.x, p.pose.position.y, p.pose.position.z] for p in line.poses]
        )
        data = np.frombuffer(cloud.data.tobytes(), "<f4").reshape(cloud.height, cloud.width, -1)
        assert [f.name for f in cloud.fields] == ["x", "y", "z", "u", "v", "s", "flag"]
        assert data.shape == (2, len(axis), 7)
        seen = data[..., 6] > 0
        assert seen.any(axis=1).all()
        # Its points lie at the radius around the line, and project to its pixels.
        world = (base @ mounting).apply(data[..., :3])
        gaps = np.linalg.norm(world - axis, axis=-1)
        np.testing.assert_allclose(gaps, 0.3, atol=1e-5)
        own = type(camera)(camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height)
        pixels = own.project(data[..., :3].astype(float))
        np.testing.assert_allclose(pixels[seen], data[..., 3:5][seen], atol=1e-2)


def test_the_sensors_tell_what_is_true(read: list[tuple[str, int, Any]], sea: Sea) -> None:
    ranges = [m.range for t, _, m in read if t == "/altimeter/range"]
    # Beside the pipe at first: about camera height plus diameter, less mounting and burial.
    assert 1.8 < np.median(ranges) < 3.2
    level = [pose_of_imu(m) for t, _, m in read if t == "/attitude"]
    stamps = [s for t, s, _ in read if t == "/attitude"]
    for found, stamp in zip(level, stamps, strict=True):
        true = sea.motion.pose((stamp - FIRST_STAMP_NS) * 1e-9)
        # Where down is, in base_link: 0.15 degrees of noise, five sigma.
        assert np.arccos(found.rotation[2] @ true.rotation[2]) < np.deg2rad(0.75) * 1.5
    twists = [m.twist.twist.linear for t, _, m in read if t == "/vnm/odometry"]
    assert np.median([v.x for v in twists]) == pytest.approx(0.5, abs=0.1)


def pose_of_imu(message: Any) -> Pose:
    q = message.orientation
    return Pose.from_quaternion(np.zeros(3), [q.x, q.y, q.z, q.w])


def test_disparities_are_those_of_the_scene(small: Callable[..., Scenario]) -> None:
    # Image content, not geometry: the right image, moved by the true disparity, is the left one.
    sea = build_sea(small("camera.width=640", "camera.height=432", "bed.resolution=0.025"))
    base = sea.motion.pose(1.0)
    left, right = (sea.renderer.render(base, n) for n in (0, 1))
    camera = sea.scenario.camera.rig().left
    grid = np.stack(np.meshgrid(np.arange(640), np.arange(432)), axis=-1).astype(float)
    depth = left.distance / np.linalg.norm(camera.rays(grid), axis=-1)
    disparity = camera.fx * 0.2 / depth
    # A row of shifts around the true disparity; the parabola through the best is the sub-pixel.
    shifts = np.arange(-1.5, 1.75, 0.25)
    scores = []
    one = np.log(left.light[..., 1].astype(np.float32))
    for shift in shifts:
        columns = (grid[..., 0] - disparity + shift).astype(np.float32)
        two = cv2.remap(
            np.log(right.light[..., 1].astype(np.float32)),
            columns,
            grid[..., 1].astype(np.float32),
            cv2.INTER_CUBIC,
        )
        scores.append(correlation(one, two, 13))
    score = np.stack(scores)
    best = score.argmax(axis=0)
    on_pipe = cv2.erode(left.coverage, np.ones((17, 17))) == 1.0
    off_pipe = cv2.dilate(left.coverage, np.ones((61, 61))) == 0.0
    in_right = (grid[..., 0] - disparity > 20) & (grid[..., 0] < 620)
    for where in (on_pipe, off_pipe):
        chosen = where & in_right & (np.abs(grid[..., 1] - 216) < 200)
        errors = shifts[best[chosen]]
        assert chosen.sum() > 5000
        assert abs(np.mean(errors)) < 0.05
        assert np.percentile(np.abs(errors), 90) <= 0.25
        assert np.median(score.max(axis=0)[chosen]) > 0.8


def correlation(one: Any, two: Any, size: int) -> Any:
    def mean(image: Any) -> Any:
        return cv2.blur(image.astype(np.float64), (size, size))

    cross = mean(one * two) - mean(one) * mean(two)
    spread = (mean(one * one) - mean(one) ** 2) * (mean(two * two) - mean(two) ** 2)
    return cross / np.sqrt(np.maximum(spread, 1e-18))


def test_raw_grey_images_where_they_are_asked_for(tmp_path: Path) -> None:
    wanted = [*SMALL, "frames=1", "camera.encoding=mono8", "camera.jpeg_quality=null"]
    read = messages(simulate("demo", tmp_path / "raw", wanted, progress=False))
    image = next(m for t, _, m in read if t == "/stereo/left/image_rect")
    assert (image.encoding, image.width, image.height, image.step) == ("mono8", 192, 128, 192)
    pixels = image.data.reshape(128, 192)
    # Dim, but neither black nor white.
    assert 25 < pixels.mean() < 150
    assert pixels.std() > 5
    assert (pixels == 255).mean() < 0.001


def test_more_frames_of_the_same_seed_begin_alike(bag: Path, tmp_path: Path) -> None:
    longer = messages(simulate("demo", tmp_path / "sea", [*SMALL, "frames=3"], progress=False))
    first = [m for t, _, m in messages(bag) if t == "/ground_truth/pose"]
    again = [m for t, _, m in longer if t == "/ground_truth/pose"]
    assert len(again) == 3
    start, same = (pose_of(p[0].pose).translation for p in (first, again))
    np.testing.assert_allclose(start, same, atol=1e-9)


def test_the_speed_is_told_at_the_end(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    simulate("demo", tmp_path / "sea", SMALL)
    assert re.fullmatch(r"2 pairs in \d+ s, \d+\.\d s a pair\n", capsys.readouterr().err)


def test_an_output_that_is_not_empty_is_refused(tmp_path: Path) -> None:
    (tmp_path / "note.txt").write_text("mine")
    with pytest.raises(BagError, match="is not empty"):
        simulate("demo", tmp_path, SMALL, progress=False)
    with pytest.raises(BagError, match="is a file"):
        simulate("demo", tmp_path / "note.txt", SMALL, progress=False)
    assert [p.name for p in tmp_path.iterdir()] == ["note.txt"]


def test_an_interrupted_run_leaves_nothing(tmp_path: Path) -> None:
    def interrupted() -> None:
        with fresh_bag(tmp_path / "sea") as path:
            path.mkdir()
            (path / "sea.mcap").write_bytes(b"half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert list(tmp_path.iterdir()) == []


def test_a_place_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(BagError, match="cannot be written"):
        simulate("demo", tmp_path / "file" / "sea", SMALL, progress=False)


def test_an_empty_directory_is_filled(tmp_path: Path) -> None:
    place = tmp_path / "sea"
    place.mkdir()
    with fresh_bag(place) as path:
        path.mkdir()
        (path / "metadata.yaml").write_text("whole")
    assert [p.name for p in place.iterdir()] == ["metadata.yaml"]
    assert [p.name for p in tmp_path.iterdir()] == ["sea"]


def test_importing_the_package_needs_no_extra() -> None:
    code = (
        "import sys; import pipeline_tracker.simulation as s; s.list_scenarios(); "
        "print([m for m in sys.modules if m.split('.')[0] in ('embreex', 'trimesh')])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("name", ["trimesh", "embreex.rtcore_scene"])
def test_a_missing_extra_is_named(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(PipelineTrackerError, match=r"pip install '\.\[sim\]'"):
        simulate("demo", tmp_path / "sea", SMALL, progress=False)
    assert list(tmp_path.iterdir()) == []


def test_unknown_names_of_the_package() -> None:
    with pytest.raises(AttributeError, match="no attribute 'stimulate'"):
        _ = simulation.stimulate
