"""`run --record`: a whole bag at the end, after a hard kill what can be salvaged."""

from __future__ import annotations

import contextlib
import errno
import io
import os
import signal
import threading
from pathlib import Path
from typing import Any

import pytest
from live_processes import children_of, is_ready, known_to_the_recorder, module_of
from live_processes import run_command as run_process

from pipeline_tracker.bags.reader import BagReader
from pipeline_tracker.bags.salvage import salvage
from pipeline_tracker.cli import run_command
from pipeline_tracker.errors import BagError
from pipeline_tracker.messages import relative_state_from_message, stamp_ns
from pipeline_tracker.settings_io import load_settings

pytestmark = pytest.mark.ros


def recording(bench: Any, directory: Path, *arguments: str) -> Any:
    process = bench.process(run_process(bench.scene, "--record", str(directory), *arguments))
    process.wait_for(is_ready, "all nodes are ready")
    process.wait_for(lambda text: "[recorder]: hears all nodes" in text, "all is recorded")
    return process


def recorder_of(process: Any) -> int:
    (pid,) = (
        pid
        for pid in children_of(process.popen.pid)
        if module_of(pid) == "pipeline_tracker.nodes.recorder"
    )
    return int(pid)


@pytest.mark.parametrize("separate", [False, True], ids=["one process", "four processes"])
def test_a_recording_is_whole_and_replays_as_it_was(
    bench: Any, tmp_path: Path, *, separate: bool
) -> None:
    directory, vehicle = tmp_path / "new" / "bag", bench.vehicle()
    process = recording(bench, directory, "--record-images", *(["--separate"] if separate else []))
    known_to_the_recorder(vehicle, process, images=True)
    vehicle.approach(0)
    live = [vehicle.drive(k) for k in range(1, 4)]
    code, _ = process.end(signal.SIGINT)
    assert code == 0
    assert f"recorded {directory}: " in process.text
    with BagReader(directory) as bag:
        states = [
            relative_state_from_message(r.unpack())
            for r in bag.records(["/pipeline/relative_state"])
        ]
        counts = {name: topic.count for name, topic in bag.topics.items()}
    heard = [relative_state_from_message(m) for m in live]
    assert [s.stamp_ns for s in states][-3:] == [s.stamp_ns for s in heard]
    assert [s.chainage for s in states][-3:] == [s.chainage for s in heard]
    assert counts["/stereo/left/image_rect"] == counts["/stereo/right/image_rect"] >= 4
    assert counts["/vnm/pose"] >= 4
    assert counts["/pipeline/vectorized"] >= 3
    from pipeline_tracker.replay import replay

    again = tmp_path / "again"
    settings = load_settings(None, list(bench.scene.settings))
    assert replay(directory, settings, again, stream=io.StringIO()).summary.valid >= 4
    with BagReader(again / "result") as bag:
        replayed = {
            stamp_ns(m.header): m.min_distance
            for m in (r.unpack() for r in bag.records(["/pipeline/relative_state"]))
        }
    assert [replayed[s.stamp_ns] for s in heard] == [s.min_distance for s in heard]


def test_a_killed_recorder_leaves_what_salvage_reads(bench: Any, tmp_path: Path) -> None:
    directory, vehicle = tmp_path / "bag", bench.vehicle()
    process = recording(bench, directory)
    known_to_the_recorder(vehicle, process)
    vehicle.approach(0)
    stamp = stamp_ns(vehicle.drive(1).header)

    def on_disk() -> bool:
        """Whether the last frame can be read from what has reached the disk so far."""
        with contextlib.suppress(BagError, KeyError):
            found = tmp_path / f"look{len(list(tmp_path.iterdir()))}"
            salvage(directory, found)
            with BagReader(found) as bag:
                states = [r.unpack() for r in bag.records(["/pipeline/relative_state"])]
            return stamp in [stamp_ns(state.header) for state in states]
        return False

    vehicle.talker.wait(on_disk, "the frame to reach the disk")
    os.kill(recorder_of(process), signal.SIGKILL)
    assert vehicle.drive(2).valid, "the nodes go on"
    assert process.end(signal.SIGINT)[0] == 1, "the recording failed"
    assert "the recording was killed; `salvage` reads what is there" in process.text
    with pytest.raises(BagError, match="salvage"), BagReader(directory):
        pass
    salvage(directory, tmp_path / "saved")
    with BagReader(tmp_path / "saved") as bag:
        assert bag.topics["/pipeline/relative_state"].count >= 2


def test_a_killed_run_leaves_a_whole_bag(bench: Any, tmp_path: Path) -> None:
    directory, vehicle = tmp_path / "bag", bench.vehicle()
    process = recording(bench, directory)
    known_to_the_recorder(vehicle, process)
    vehicle.approach(0)
    # The last answer may have reached the vehicle alone.
    assert vehicle.drive(1).valid
    process.popen.kill()
    process.popen.wait()
    vehicle.talker.wait((directory / "metadata.yaml").exists, "the recorder to finish the bag")
    with BagReader(directory) as bag:
        assert bag.topics["/pipeline/relative_state"].count >= 1


def test_nothing_recorded_is_no_bag(bench: Any, tmp_path: Path) -> None:
    directory = tmp_path / "bag"
    # Else it is recorded that there is no input.
    process = recording(bench, directory, "--set", "output.timeout=60")
    assert process.end(signal.SIGTERM)[0] == 0
    assert "nothing came that could be recorded" in process.text
    assert not directory.exists()


# The file alone.


def big(count: int) -> bytes:
    return b"\0" * count


@pytest.fixture
def topics() -> tuple[Any, Any]:
    from pipeline_tracker.nodes.recorder_process import RecordedTopic

    return (
        RecordedTopic("pipeline/min_distance", "std_msgs/msg/Float64", "pipeline"),
        RecordedTopic("stereo/left/image_rect", "sensor_msgs/msg/Image", "sensor"),
    )


def test_a_slow_disk_costs_images_first_and_memory_is_bounded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, topics: tuple[Any, Any]
) -> None:
    from pipeline_tracker.nodes import recorder

    gate, write = threading.Event(), recorder.Writer.write

    def slow(self: Any, connection: Any, *arguments: Any) -> None:
        assert gate.wait(60.0)
        write(self, connection, *arguments)

    monkeypatch.setattr(recorder.Writer, "write", slow)
    monkeypatch.setattr(recorder, "_MOST_WITH_IMAGES", 1000)
    monkeypatch.setattr(recorder, "_MOST_WAITING", 1500)
    result, image = topics
    file = recorder.BagFile(tmp_path / "bag", compress=False)
    assert file.put(result, "/pipeline/min_distance", big(12))
    assert [file.put(image, "/left", big(400)) for _ in range(4)] == [True, True, False, False]
    assert file.put(result, "/pipeline/min_distance", big(12)), "results still find room"
    assert not file.put(result, "/pipeline/min_distance", big(4000))
    assert dict(file.lost) == {"/left": 2, "/pipeline/min_distance": 1}
    gate.set()
    file.close()
    assert file.written == 4
    with BagReader(tmp_path / "bag") as bag:
        assert bag.topics["/left"].count == 2
        assert bag.topics["/pipeline/min_distance"].count == 2


def test_a_full_disk_ends_the_recording_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, topics: tuple[Any, Any]
) -> None:
    from pipeline_tracker.nodes import recorder

    written = threading.Event()

    def full(*_: Any) -> None:
        written.set()
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(recorder.Writer, "write", full)
    file = recorder.BagFile(tmp_path / "bag", compress=False)
    file.put(topics[0], "/a", big(12))
    assert written.wait(60.0)
    file.close()
    assert file.failure is not None
    assert file.failure.errno == errno.ENOSPC
    assert not file.put(topics[0], "/a", big(12))


@pytest.mark.parametrize(
    ("overrides", "images", "wanted", "unwanted"),
    [
        (
            [],
            False,
            {"pipeline/vectorized", "vnm/pose", "stereo/right/camera_info"},
            {"stereo/left/image_rect", "altimeter/range", "pipeline/debug/image/compressed"},
        ),
        ([], True, {"stereo/left/image_rect", "stereo/right/image_rect"}, set()),
        (
            ["image_transport=compressed", "camera.rectify=true"],
            True,
            {"stereo/left/image_raw/compressed"},
            {"stereo/left/image_raw"},
        ),
        (
            ["mode=mono"],
            True,
            {"stereo/left/image_rect", "altimeter/range"},
            {"stereo/right/image_rect", "stereo/right/camera_info"},
        ),
    ],
)
def test_what_is_recorded(
    overrides: list[str], images: bool, wanted: set[str], unwanted: set[str]
) -> None:
    from pipeline_tracker.nodes.recorder_process import recorded_topics

    settings = load_settings(None, ["pipe.diameter=0.6", *overrides])
    names = {topic.name for topic in recorded_topics(settings, images=images)}
    assert wanted <= names
    assert not unwanted & names


# What is refused before anything starts.


def refusal(capsys: pytest.CaptureFixture[str], scene: Any, *arguments: str) -> str:
    given = [word for s in scene.settings for word in ("--set", s)]
    assert run_command(["run", *given, *arguments]) == 2
    line = capsys.readouterr().err
    assert line.count("\n") == 1
    return line


def test_places_that_cannot_be_recorded_to(
    capsys: pytest.CaptureFixture[str], scene: Any, tmp_path: Path
) -> None:
    (tmp_path / "file").touch()
    assert "is there already" in refusal(capsys, scene, "--record", str(tmp_path))
    line = refusal(capsys, scene, "--record", str(tmp_path / "file" / "bag"))
    assert "cannot be written" in line
    line = refusal(capsys, scene, "--record-images")
    assert "--record-images: expected --record DIR with it" in line
