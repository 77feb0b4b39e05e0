"""Replay: one row for each left image, poses in time, output that can be read again."""

from __future__ import annotations

import csv
import io
import itertools
import os
import signal
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from bag_maker import (
    LEFT,
    MOUNTING,
    RIGHT,
    SECOND,
    START,
    Item,
    Sea,
    mcap_of,
    picture,
    raw_image,
    static_transform,
    write_bag,
)
from stand_in import StandIn

from pipeline_tracker.bags.reader import BagReader
from pipeline_tracker.errors import BagError, CalibrationError, PipelineTrackerError
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.messages import (
    relative_state_from_message,
    segment_from_message,
    status_from_message,
    vectorized_from_message,
)
from pipeline_tracker.replay import ReplayOutcome, default_output, replay
from pipeline_tracker.replay.estimates import COLUMNS
from pipeline_tracker.replay.progress import ReplayProgress
from pipeline_tracker.settings_io import load_settings, settings_from_values


class Replayed:
    """A replay with the stand-in, and what it wrote."""

    def __init__(
        self, bag: Path, output: Path, before: Callable[[int], None] | None = None, **options: Any
    ) -> None:
        force = options.pop("force", False)
        values = {"pipe.diameter": 0.6, **{k.replace("__", "."): v for k, v in options.items()}}
        self.stream = io.StringIO()
        self.pipeline: StandIn | None = None

        def make(*arguments: Any) -> StandIn:
            self.pipeline = StandIn(*arguments)
            self.pipeline.before = before or self.pipeline.before
            return self.pipeline

        self.output = output
        self.outcome: ReplayOutcome = replay(
            bag,
            settings_from_values(values),
            output,
            force=force,
            stream=self.stream,
            make_pipeline=make,
        )

    @property
    def rows(self) -> list[dict[str, str]]:
        return read_rows(self.output)

    @property
    def text(self) -> str:
        return self.outcome.text


def read_rows(output: Path) -> list[dict[str, str]]:
    with (output / "estimates.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def without_time(output: Path) -> list[str]:
    lines = (output / "estimates.csv").read_text().splitlines()
    parts = [line.rsplit(",", 3) for line in lines]
    return [",".join((before, *after)) for before, _, *after in parts]


@pytest.fixture
def run(tmp_path: Path) -> Callable[..., Replayed]:
    numbers = itertools.count()

    def run_bag(items: Any = None, **options: Any) -> Replayed:
        number = next(numbers)
        items = items.items() if isinstance(items, Sea) else items
        bag = items if isinstance(items, Path) else write_bag(tmp_path / f"bag{number}", items)
        return Replayed(bag, tmp_path / f"out{number}", **options)

    return run_bag


def changed(sea: Sea, change: Callable[[Item], Item | None]) -> list[Item]:
    return [new for item in sea.items() if (new := change(item)) is not None]


Run = Callable[..., Replayed]


def test_rows_are_as_promised(run: Run) -> None:
    done = run()
    header = (done.output / "estimates.csv").read_text().splitlines()[0]
    assert header == (
        "stamp_ns,state,valid,reason,mode,technique,support,start_x,start_y,start_z,end_x,end_y,"
        "end_z,heading_misalignment,pitch_misalignment,min_distance,approach_speed,lateral_offset,"
        "side,upper_x,upper_y,upper_z,chainage,processing_ms,bed_left,bed_right"
    )
    assert ",".join(COLUMNS) == header
    first, second, *_ = done.rows
    assert [int(row["stamp_ns"]) for row in done.rows] == [Sea().stamp(i) for i in range(4)]
    assert (first["state"], first["valid"], first["reason"]) == ("tracking", "1", "")
    assert (first["mode"], first["technique"]) == ("recognition", "2")
    assert (second["mode"], second["technique"], second["side"]) == ("tracking", "0", "along")
    assert second["heading_misalignment"] == "-0.100000000"
    assert second["lateral_offset"] == "0.000000000", "no negative zero"
    assert second["chainage"] == "0.200000000"
    assert float(second["processing_ms"]) >= 0.0
    assert done.outcome.summary.found


def test_frames_without_a_pipe_have_empty_cells(run: Run) -> None:
    done = run(Sea(level=lambda _: 50))
    for row in done.rows:
        assert (row["state"], row["valid"], row["side"]) == ("searching", "0", "not_in_view")
        assert row["reason"] == "too dark"
        filled = {name for name, cell in row.items() if cell}
        assert filled == {"stamp_ns", "state", "valid", "reason", "side", "processing_ms"}
    assert not done.outcome.summary.found
    assert "pipe found in 0 (0 %)" in done.text
    assert "not found in frames 1 to 4 (0.0 to 1.5 s): too dark" in done.text


@pytest.mark.parametrize("encoding", ["mono8", "mono16", "bgr8", "rgb8", "jpeg", "png"])
def test_every_encoding_of_images(run: Run, encoding: str) -> None:
    done = run(Sea(encoding=encoding))
    assert [row["valid"] for row in done.rows] == ["1"] * 4
    assert done.pipeline is not None
    expected = [picture(150 + i).mean() for i in range(4)]
    for (left, right), level in zip(done.pipeline.levels, expected, strict=True):
        assert right is not None
        assert abs(left - level) < 2.0
        assert abs(right - level) < 2.0


@pytest.mark.parametrize("kind", ["pose", "pose_with_covariance", "odometry"])
def test_every_type_of_pose(run: Run, kind: str) -> None:
    done = run(Sea(pose=kind))
    assert [row["chainage"] for row in done.rows] == [f"{0.2 * i:.9f}" for i in range(4)]
    settings = load_settings(done.output / "settings.yaml")
    assert settings.pose_type == kind
    assert settings.topics.pose == "/vnm/pose"


def test_bag_without_poses_is_recognised_frame_by_frame(run: Run) -> None:
    done = run(Sea(pose=""))
    assert [row["mode"] for row in done.rows] == ["recognition"] * 4
    assert [row["reason"] for row in done.rows] == ["no_pose"] * 4
    for name in ("approach_speed", "chainage"):
        assert [row[name] for row in done.rows] == [""] * 4
    assert done.rows[0]["heading_misalignment"] != ""
    assert "nothing was tracked, each frame was recognised by itself" in done.text
    assert "the bag has no vehicle poses (vnm/pose)" in done.text


def test_recognition_only(run: Run) -> None:
    done = run(recognition__only=True)
    assert done.pipeline is not None
    assert done.pipeline.recognition_only
    assert [row["mode"] for row in done.rows] == ["recognition"] * 4
    assert "as asked" in done.text
    assert load_settings(done.output / "settings.yaml").recognition.only


def test_mono_uses_the_left_camera_alone(run: Run) -> None:
    for sea in (Sea(), Sea(sides=("left",))):
        done = run(sea, mode="mono")
        assert done.pipeline is not None
        assert all(rig.right is None for rig in done.pipeline.rigs)
        assert [right for _, right in done.pipeline.levels] == [None] * 4
        assert [row["valid"] for row in done.rows] == ["1"] * 4


# Poses and images that do not come together.


def test_pose_at_another_time_is_interpolated(run: Run) -> None:
    items = changed(Sea(), lambda i: None if i.topic == "/vnm/pose" else i)
    sea = Sea(period=0.4)
    poses = [sea.pose_item(i, START - SECOND // 10 + sea.stamp(i) - START) for i in range(6)]
    items = sorted([*items, *poses], key=lambda item: item.log_ns)
    done = run(items)
    for i, row in enumerate(done.rows):
        expected = 0.2 * (0.5 * i + 0.1) / 0.4
        assert float(row["chainage"]) == pytest.approx(expected, abs=1e-9)


def test_frame_waits_for_a_pose_that_is_recorded_later(run: Run) -> None:
    def late(item: Item) -> Item:
        return replace(item, log_ns=item.log_ns + SECOND) if item.topic == "/vnm/pose" else item

    items = sorted(changed(Sea(), late), key=lambda item: item.log_ns)
    done = run(items)
    assert [row["chainage"] for row in done.rows] == [f"{0.2 * i:.9f}" for i in range(4)]


def test_frame_does_not_wait_for_ever(run: Run) -> None:
    """Poses end after the first frame: the others go without."""
    sea = Sea(frames=20)
    items = changed(sea, lambda i: None if i.topic == "/vnm/pose" and i.log_ns > START else i)
    done = run(items)
    assert [bool(row["chainage"]) for row in done.rows] == [True] + [False] * 19
    assert "19 frames had no pose of /vnm/pose and stood alone" in done.text


def test_frames_that_wait_are_bounded(tmp_path: Path) -> None:
    """A frame is given up for its pose after pose.max_gap of the bag's time."""
    from pipeline_tracker.geometry.pose_buffer import PoseBuffer
    from pipeline_tracker.replay.input import ReplayInput

    items = changed(Sea(frames=40), lambda i: None if i.topic == "/vnm/pose" else i)
    items.append(Sea().pose_item(0, Sea().stamp(39)))
    settings = settings_from_values({"pipe.diameter": 0.6, "pose.max_gap": 2.0})
    with BagReader(write_bag(tmp_path / "bag", items)) as bag:
        source = ReplayInput(bag, settings)
        most = 0
        for _ in source.frames(PoseBuffer(2.0), lambda: None):
            most = max(most, len(source._waiting))
    assert 4 <= most <= 6, "2 s at two frames a second"


def test_poses_that_cannot_be_used_are_counted(run: Run) -> None:
    def spoil(item: Item) -> Item:
        if item.topic == "/vnm/pose" and item.log_ns == Sea().stamp(2):
            item.message.pose.orientation.w = float("nan")
        return item

    done = run(changed(Sea(), spoil))
    assert "1 pose not used: 1 invalid (the first: pose.orientation" in done.text
    assert done.rows[2]["chainage"] == f"{0.4:.9f}", "between its neighbours"


# Images that do not come together.


def test_missing_partner_is_one_row_with_a_reason(run: Run) -> None:
    def drop(item: Item) -> Item | None:
        right = item.topic == "/stereo/right/image_rect"
        return None if right and item.log_ns == Sea().stamp(1) else item

    done = run(changed(Sea(), drop))
    assert [row["valid"] for row in done.rows] == ["1", "0", "1", "1"]
    lost = done.rows[1]
    assert (lost["reason"], lost["state"], lost["processing_ms"]) == ("no_right_image", "", "")
    assert "1 image without a partner: 1 no right image within sync.tolerance" in done.text


def test_left_over_right_image_is_counted_and_has_no_row(run: Run) -> None:
    def drop(item: Item) -> Item | None:
        left = item.topic == "/stereo/left/image_rect"
        return None if left and item.log_ns == Sea().stamp(1) else item

    done = run(changed(Sea(), drop))
    assert len(done.rows) == 3
    assert "1 no left image within sync.tolerance" in done.text


def test_late_and_repeated_images_have_their_row_in_time_order(run: Run) -> None:
    sea = Sea(frames=6)
    items = list(sea.items())
    late = sea.image("left", 0, stamp=sea.stamp(0) + SECOND // 10)
    again = sea.image("left", 1)
    items.append(replace(late, log_ns=sea.stamp(5)))
    items.append(replace(again, log_ns=sea.stamp(5)))
    # Both are within the second in which an old stamp is no clock that was set back.
    items[-2] = replace(items[-2], message=raw_image(sea.stamp(4) + 1000, picture(150)))
    items[-1] = replace(items[-1], message=raw_image(sea.stamp(4), picture(150)))
    done = run(items)
    stamps = [int(row["stamp_ns"]) for row in done.rows]
    assert stamps == sorted(stamps)
    reasons = {int(row["stamp_ns"]): row["reason"] for row in done.rows if row["valid"] == "0"}
    assert reasons[sea.stamp(4) + 1000] == "late"
    assert sum(row["stamp_ns"] == str(sea.stamp(4)) for row in done.rows) == 2
    assert len(done.rows) == 8


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize(
    ("fault", "reason"),
    [
        ("cut", "image: JPEG image is cut off"),
        ("garbage", "image: compressed image is neither JPEG nor PNG"),
        ("size", "image is 64 x 24, expected 64 x 48 as the camera info says"),
        ("message", "message of"),
    ],
)
def test_corrupt_image_is_one_frame_lost(run: Run, side: str, fault: str, reason: str) -> None:
    sea = Sea(encoding="jpeg")

    def spoil(item: Item) -> Item:
        if item.topic != f"/stereo/{side}/image_rect/compressed" or item.log_ns != sea.stamp(1):
            return item
        data = item.message.data
        if fault == "cut":
            item.message.data = data[: len(data) // 2]
        elif fault == "garbage":
            item.message.data = np.zeros(100, np.uint8)
        elif fault == "size":
            item.message.data = cv2.imencode(".jpg", picture(150)[:24])[1].ravel()
        else:
            from bag_maker import FACTORY

            return replace(item, message=FACTORY.serialize(item.message)[:30])
        return item

    done = run(changed(sea, spoil))
    assert [row["valid"] for row in done.rows] == ["1", "0", "1", "1"]
    assert reason in done.rows[1]["reason"]
    assert done.rows[1]["reason"].startswith(f"{side} image: ")
    assert int(done.rows[1]["stamp_ns"]) == sea.stamp(1)
    assert "not found in frame 2 (0.5 s)" in done.text


@pytest.mark.parametrize("encoding", ["bayer_rggb8", "32FC1"])
def test_encoding_that_is_not_taken(run: Run, encoding: str) -> None:
    def other(item: Item) -> Item:
        if item.topic.endswith("image_rect"):
            item.message.encoding = encoding
        return item

    done = run(changed(Sea(), other))
    assert all(f"encoding '{encoding}' is not taken" in row["reason"] for row in done.rows)
    assert not done.outcome.summary.found


# Clocks and calibrations that change.


def test_clock_set_back_is_a_reset(run: Run) -> None:
    sea = Sea()
    again = [replace(item, log_ns=item.log_ns + 10 * SECOND) for item in sea.items()]
    done = run([*sea.items(), *again])
    assert done.pipeline is not None
    assert done.pipeline.resets == ["time went backward"]
    stamps = [int(row["stamp_ns"]) for row in done.rows]
    assert stamps == [sea.stamp(i) for i in (0, 1, 2, 3, 0, 1, 2, 3)]
    assert [row["valid"] for row in done.rows] == ["1"] * 8
    assert [pose is not None for _, pose in done.pipeline.calls] == [True] * 8
    assert [row["mode"] for row in done.rows] == (["recognition"] + ["tracking"] * 3) * 2


def test_calibration_that_changes_on_the_way(run: Run) -> None:
    sea = Sea()

    def change(item: Item) -> Item:
        if item.log_ns >= sea.stamp(2) and item.topic.endswith("camera_info"):
            side = "right" if "right" in item.topic else "left"
            offset = 0.3 if side == "right" else 0.0
            return replace(sea.info(side, 0, replace(LEFT, offset=offset)), log_ns=item.log_ns)
        return item

    done = run(changed(sea, change))
    assert done.pipeline is not None
    assert [round(rig.baseline, 6) for rig in done.pipeline.rigs] == [0.2, 0.2, 0.3, 0.3]


def test_calibration_that_goes_bad_loses_frames(run: Run) -> None:
    sea = Sea()

    def spoil(item: Item) -> Item:
        if item.log_ns == sea.stamp(2) and item.topic == "/stereo/right/camera_info":
            item.message.p = np.zeros(12)
        return item

    done = run(changed(sea, spoil))
    assert [row["valid"] for row in done.rows] == ["1", "1", "0", "1"]
    assert "expected both above 0" in done.rows[2]["reason"]


# Calibration and mounting.


def test_mounting_of_the_transforms_and_of_settings(run: Run) -> None:
    done = run()
    assert done.pipeline is not None
    np.testing.assert_allclose(done.pipeline.mounting.rotation, MOUNTING.rotation, atol=1e-12)
    chained = [
        static_transform(START, "base_link", "mast", Pose.from_rpy([0, 0, 1], [0, 0, 1])),
        static_transform(START, "mast", "left_optical", MOUNTING),
        *Sea(static=False).items(),
    ]
    done = run(chained)
    assert done.pipeline is not None
    expected = Pose.from_rpy([0, 0, 1], [0, 0, 1]) @ MOUNTING
    np.testing.assert_allclose(done.pipeline.mounting.translation, expected.translation, atol=1e-12)
    given = {"camera__translation": [1, 2, 3], "camera__rotation_rpy": [0.1, 0.2, 0.3]}
    done = run(chained, **given)
    assert done.pipeline is not None
    np.testing.assert_array_equal(done.pipeline.mounting.translation, [1, 2, 3])


def refusal(run: Run, items: Any, **options: Any) -> str:
    with pytest.raises(PipelineTrackerError) as caught:
        run(items, **options)
    line = str(caught.value)
    assert "\n" not in line
    return line


def test_missing_mounting_is_refused(run: Run) -> None:
    line = refusal(run, Sea(static=False))
    assert "the camera's mounting is not known" in line


def test_zero_calibration_is_refused(run: Run) -> None:
    def zero(item: Item) -> Item:
        if item.topic == "/stereo/left/camera_info":
            item.message.p = np.zeros(12)
        return item

    line = refusal(run, changed(Sea(), zero))
    assert "/stereo/left/camera_info: P has focal lengths fx=0, fy=0, expected both above 0" in line


def test_right_camera_without_baseline_is_refused(run: Run) -> None:
    sea = Sea()

    def move(item: Item) -> Item:
        if item.topic == "/stereo/right/camera_info":
            return sea.info("right", 0, LEFT)
        return item

    assert "baseline of 0 m, expected above 0" in refusal(run, changed(sea, move)).replace(
        "-0", "0"
    )


def test_pictures_that_are_not_rectified_are_refused(run: Run) -> None:
    sea = Sea(image_topic="/stereo/{side}/image_raw")

    def distort(item: Item) -> Item:
        if item.topic.endswith("camera_info"):
            item.message.d = np.array([0.1, 0.0, 0.0, 0.0, 0.0])
        return item

    line = refusal(run, changed(sea, distort))
    assert "/stereo/left/image_raw is not rectified" in line
    assert "--set camera.rectify=true" in line
    assert "--set topics.left_image=/stereo/left/image_raw" in line
    assert len(run(changed(sea, distort), topics__left_image="/stereo/left/image_raw").rows) == 4
    assert len(run(sea).rows) == 4, "without distortion they are as good as rectified"


TURN = Pose.from_rpy(np.zeros(3), [0.0, 0.0, 0.02]).rotation.ravel()


def raw_sea(sea: Sea, **changes: Any) -> list[Item]:
    """Messages of a sea whose camera infos have distortion, and other fields where given."""
    fields: dict[str, Any] = {"d": np.array([-0.2, 0.05, 0.0, 0.0, 0.0])} | changes

    def distort(item: Item) -> Item:
        if item.topic.endswith("camera_info"):
            return replace(item, message=replace(item.message, **fields))
        return item

    return changed(sea, distort)


def test_a_turned_or_scaled_camera_is_refused_like_a_distorted_one(run: Run) -> None:
    sea = Sea(image_topic="/stereo/{side}/image_raw")
    none = np.zeros(5)
    other = np.array([70.0, 0, 30, 0, 70, 20, 0, 0, 1])
    assert "not rectified" in refusal(run, raw_sea(sea, d=none, r=TURN))
    assert "not rectified" in refusal(run, raw_sea(sea, d=none, k=other))
    assert len(run(raw_sea(sea, d=none)).rows) == 4


def test_images_are_rectified_by_setting(run: Run) -> None:
    sea = Sea(image_topic="/stereo/{side}/image_raw", encoding="png")
    items = raw_sea(sea, k=np.array([70.0, 0, 31.5, 0, 70, 23.5, 0, 0, 1]))
    done = run(items, camera__rectify=True)
    assert [row["reason"] for row in done.rows] == [""] * 4
    assert done.pipeline is not None
    # A camera with a shorter lens than P's sees all, one with a longer lens does not.
    assert done.pipeline.unseen_pairs == [(None, None)] * 4
    again = run(
        raw_sea(sea, k=np.array([90.0, 0, 31.5, 0, 90, 23.5, 0, 0, 1])), camera__rectify=True
    )
    assert again.pipeline is not None
    assert None not in again.pipeline.unseen_pairs[0]
    # The calibration that is passed on is that of the rectified images.
    with BagReader(done.output / "result") as bag:
        vectorized = bag.first("/pipeline/vectorized")
    for info, camera in ((vectorized.left_info, LEFT), (vectorized.right_info, RIGHT)):
        assert not np.any(info.d)
        np.testing.assert_array_equal(info.k, camera.matrix.ravel())
        np.testing.assert_array_equal(info.r, np.eye(3).ravel())
        assert info.p[3] == pytest.approx(-camera.fx * camera.offset)
    # The run's own settings give the same again.
    saved = load_settings(done.output / "settings.yaml")
    assert saved.camera.rectify
    assert saved.topics.left_image == "/stereo/left/image_raw/compressed"


def test_rectified_images_are_not_rectified_again(run: Run) -> None:
    line = refusal(run, raw_sea(Sea()), camera__rectify=True)
    assert "camera.rectify is set, but the images are rectified already" in line
    assert "leave camera.rectify out" in line
    raw = Sea(image_topic="/stereo/{side}/image_raw", info_topic="/raw/{side}/info")
    images = [item for item in raw_sea(raw) if item.topic.endswith("image_raw")]
    both = [*images, *raw_sea(Sea())]
    done = run(both, camera__rectify=True)
    assert "/stereo/left/image_raw" in (done.output / "settings.yaml").read_text()
    done = run(both)
    assert "/stereo/left/image_rect" in (done.output / "settings.yaml").read_text()


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"d": np.array([0.1, 0.2, 0.3])}, "D has 3 numbers, expected 5 or 4 for plumb_bob"),
        ({"distortion_model": "fov"}, "distortion_model is 'fov', expected plumb_bob, rational"),
        ({"k": np.zeros(9)}, "K has focal lengths fx=0, fy=0, expected both above 0"),
        ({"p": np.zeros(12)}, "P has focal lengths fx=0, fy=0, expected both above 0"),
        ({"width": 30_000, "height": 30_000}, "image size is 30000 x 30000, expected at most"),
    ],
)
def test_what_does_not_tell_how_to_rectify_is_refused(
    run: Run, changes: dict[str, Any], text: str
) -> None:
    items = raw_sea(Sea(image_topic="/stereo/{side}/image_raw"), **changes)
    line = refusal(run, items, camera__rectify=True)
    assert "/stereo/left/camera_info: " in line
    assert text in line


def test_a_camera_that_is_calibrated_anew_is_rectified_anew(run: Run) -> None:
    sea = Sea(image_topic="/stereo/{side}/image_raw")
    longer = np.array([160.0, 0, 31.5, 0, 160, 23.5, 0, 0, 1])

    def change(item: Item) -> Item:
        if item.topic.endswith("camera_info") and item.log_ns >= sea.stamp(2):
            return replace(item, message=replace(item.message, k=longer))
        return item

    done = run([change(item) for item in raw_sea(sea)], camera__rectify=True)
    assert done.pipeline is not None
    unseen = [pair.left is not None for pair in done.pipeline.unseen_pairs]
    assert unseen == [False, False, True, True]


# Output.


def test_result_bag_holds_every_topic(run: Run) -> None:
    done = run(Sea(frames=6, level=lambda i: 50 if i == 3 else 150))
    with BagReader(done.output / "result") as bag:
        counts = {name: topic.count for name, topic in bag.topics.items()}
        read = {name: [record.unpack() for record in bag.records([name])] for name in bag.topics}
    assert counts == {
        "/pipeline/vectorized": 6,
        "/pipeline/recognition_request": 3,
        "/pipeline/recognition": 3,
        "/pipeline/segment": 5,
        "/pipeline/status": 6,
        "/pipeline/relative_state": 6,
        "/pipeline/heading_misalignment": 5,
        "/pipeline/pitch_misalignment": 5,
        "/pipeline/approach_speed": 5,
        "/pipeline/min_distance": 5,
        "/pipeline/centerline": 3,
        "/pipeline/markers": 6,
        "/vnm/pose": 6,
        "/tf": 6,
        "/tf_static": 1,
        "/pipeline/debug/left/image/compressed": 6,
        "/pipeline/debug/left/camera_info": 6,
        "/pipeline/debug/left/annotations": 6,
    }
    segments = [segment_from_message(m) for m in read["/pipeline/segment"]]
    rows = [row for row in done.rows if row["mode"]]
    for segment, row in zip(segments, rows, strict=True):
        assert segment.stamp_ns == int(row["stamp_ns"])
        assert f"{segment.start[1]:.9f}" == row["start_y"]
    states = [relative_state_from_message(m) for m in read["/pipeline/relative_state"]]
    assert [s.valid for s in states] == [True, True, True, False, True, True]
    status = status_from_message(read["/pipeline/status"][3])
    assert status.reason == "too dark"
    vectorized = vectorized_from_message(read["/pipeline/vectorized"][0])
    assert vectorized.rig.left == LEFT
    assert vectorized.rig.baseline == pytest.approx(RIGHT.offset)
    assert read["/pipeline/vectorized"][0].header.frame_id == "left_optical"
    assert read["/pipeline/segment"][0].header.frame_id == "base_link"
    assert read["/pipeline/centerline"][-1].header.frame_id == "odom"
    assert len(read["/pipeline/centerline"][-1].poses) == 3


def test_result_bag_is_sound_for_another_library(run: Run) -> None:
    from mcap.reader import make_reader

    done = run()
    with mcap_of(done.output / "result").open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        schemas = {
            channel.topic: (schema.name if schema else "")
            for schema, channel, _ in reader.iter_messages()
        }
    assert schemas["/pipeline/relative_state"] == "pipeline_tracker_msgs/msg/RelativeState"
    assert schemas["/pipeline/markers"] == "visualization_msgs/msg/MarkerArray"


def test_two_replays_give_the_same_bytes(run: Run) -> None:
    sea = Sea(frames=8, level=lambda i: 50 if i % 3 == 2 else 150)
    assert without_time(run(sea).output) == without_time(run(sea).output)


def test_settings_of_a_run_give_the_same_run(run: Run, tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", Sea(pose="odometry").items())
    first = run(bag, segment__length=0.4)
    settings = load_settings(first.output / "settings.yaml")
    assert settings.segment.length == 0.4
    assert settings.topics.right_info == "/stereo/right/camera_info"
    assert settings.frames.left_optical == "left_optical"
    second = tmp_path / "again"
    replay(bag, settings, second, stream=io.StringIO(), make_pipeline=StandIn)
    assert without_time(second) == without_time(first.output)
    assert (second / "settings.yaml").read_text() == (first.output / "settings.yaml").read_text()


def test_overlay_pictures(run: Run) -> None:
    done = run(Sea(frames=5, level=lambda i: 200 if i == 4 else 150))
    for name in ("overlay_best.png", "overlay_middle.png"):
        image = cv2.imread(str(done.output / name))
        assert image.shape == (48, 128, 3)
    best = cv2.imread(str(done.output / "overlay_best.png"))
    middle = cv2.imread(str(done.output / "overlay_middle.png"))
    assert (best != middle).any(), "the brightest frame and the third"


def test_one_picture_where_nothing_was_found(run: Run) -> None:
    done = run(Sea(level=lambda _: 50))
    assert not (done.output / "overlay_best.png").exists()
    assert (done.output / "overlay_middle.png").exists()


def test_output_that_is_not_empty_is_refused_without_force(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag")
    output = tmp_path / "out"
    output.mkdir()
    (output / "notes.txt").write_text("mine")
    with pytest.raises(BagError, match=r"not empty \(it has notes.txt\).*--force"):
        Replayed(bag, output)
    assert [p.name for p in output.iterdir()] == ["notes.txt"]
    Replayed(bag, output, force=True)
    again = Replayed(bag, output, force=True)
    assert len(again.rows) == 4
    assert (output / "notes.txt").read_text() == "mine"


def test_output_that_is_a_file_or_the_bag_is_refused(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag")
    (tmp_path / "file").touch()
    with pytest.raises(BagError, match="is a file, expected a directory for --output"):
        Replayed(bag, tmp_path / "file")
    with pytest.raises(BagError, match="is the bag itself"):
        Replayed(bag, bag, force=True)


def test_nothing_is_written_where_the_input_is_bad(tmp_path: Path) -> None:
    output = tmp_path / "out"
    with pytest.raises(CalibrationError):
        Replayed(write_bag(tmp_path / "bag", Sea(static=False).items()), output)
    assert not output.exists()


def test_default_output_is_named_after_the_bag(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "dive.3")
    assert default_output(bag) == Path("dive.3_tracked")
    assert default_output(mcap_of(bag)) == Path("dive.3_tracked")


def test_disk_that_cannot_be_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bag = write_bag(tmp_path / "bag")

    def full(*_: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("pipeline_tracker.replay.estimates.EstimatesFile.write", full)
    with pytest.raises(BagError, match="cannot be written \\(No space left on device\\)"):
        Replayed(bag, tmp_path / "out")


# Damage and interruption on the way.


def test_bag_damaged_on_the_way_keeps_what_came_before(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", Sea(frames=8).items())
    text = (bag / "metadata.yaml").read_text().replace("message_count: 8", "message_count: 9")
    (bag / "metadata.yaml").write_text(text)
    output = tmp_path / "out"
    with pytest.raises(BagError) as caught:
        Replayed(bag, output)
    line = str(caught.value)
    assert "8 of the 9 messages" in line
    assert "salvage" in line
    assert f"the 8 frames before are in {output}" in line
    assert len(read_rows(output)) == 8
    with BagReader(output / "result") as result:
        assert result.topics["/pipeline/status"].count == 8


def test_interrupt_keeps_what_was_computed(run: Run) -> None:
    def interrupt(index: int) -> None:
        if index == 2:
            os.kill(os.getpid(), signal.SIGINT)

    before = signal.getsignal(signal.SIGINT)
    done = run(Sea(frames=8), before=interrupt)
    assert signal.getsignal(signal.SIGINT) is before
    assert done.outcome.summary.interrupted
    assert len(done.rows) == 3, "the frame at hand is finished"
    assert "interrupted after 3 frames" in done.text
    with BagReader(done.output / "result") as result:
        assert result.topics["/pipeline/status"].count == 3


def test_second_interrupt_ends_at_once(tmp_path: Path) -> None:
    def interrupt(index: int) -> None:
        if index == 2:
            os.kill(os.getpid(), signal.SIGINT)
            os.kill(os.getpid(), signal.SIGINT)

    bag = write_bag(tmp_path / "bag", Sea(frames=8).items())
    with pytest.raises(KeyboardInterrupt):
        Replayed(bag, tmp_path / "out", before=interrupt)
    assert len(read_rows(tmp_path / "out")) == 2


# Progress and memory.


def test_progress_in_a_pipe_is_plain_lines() -> None:
    stream, now = io.StringIO(), [0.0]
    with ReplayProgress(20, stream, clock=lambda: now[0]) as progress:
        for _ in range(20):
            now[0] += 1.0
            progress.advance()
    assert stream.getvalue().splitlines() == [
        "5 of 20 frames, 1.0 frames/s, 15 s left",
        "10 of 20 frames, 1.0 frames/s, 10 s left",
        "15 of 20 frames, 1.0 frames/s, 5 s left",
        "20 of 20 frames, 1.0 frames/s, 0 s left",
    ]


def test_progress_goes_on_when_nobody_reads_it() -> None:
    class Closed(io.StringIO):
        def write(self, _text: str) -> int:
            raise BrokenPipeError

    now = [0.0]
    with ReplayProgress(9, Closed(), clock=lambda: now[0]) as progress:
        for _ in range(9):
            now[0] += 9.0
            progress.advance()


def test_progress_on_a_terminal_is_a_bar() -> None:
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    stream = Terminal()
    with ReplayProgress(3, stream) as progress:
        for _ in range(3):
            progress.advance()
    assert "frames/s" in stream.getvalue()
    assert "3/3" in stream.getvalue()


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="memory is read from /proc")
def test_memory_does_not_grow_with_the_bag(tmp_path: Path) -> None:
    levels: list[int] = []

    class Measured(StandIn):
        def process(self, *arguments: Any) -> Any:
            pages = int(Path("/proc/self/statm").read_text().split()[1])
            levels.append(pages * os.sysconf("SC_PAGE_SIZE"))
            return super().process(*arguments)

    sea = Sea(frames=200, size=(640, 480))
    bag = write_bag(tmp_path / "bag", sea.items())
    size = mcap_of(bag).stat().st_size
    settings = settings_from_values({"pipe.diameter": 0.6})
    replay(bag, settings, tmp_path / "out", stream=io.StringIO(), make_pipeline=Measured)
    assert len(levels) == 200
    assert size > 120_000_000
    assert max(levels[50:]) < max(levels[:50]) + 20_000_000
