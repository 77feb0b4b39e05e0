"""Health on /diagnostics, accounts and the middleware's own faults, over DDS."""

from __future__ import annotations

import math
import threading
from typing import Any

import pytest

from pipeline_tracker.validation.fields import check_finite

pytestmark = pytest.mark.ros

ARRAY = "diagnostic_msgs/msg/DiagnosticArray"
OK, WARN, ERROR = 0, 1, 2
NAMES = ("stereo_vectorizer", "local_recognizer", "pipe_tracker", "relative_state_publisher")
OVERALL = "pipeline_tracker: overall"


class Board:
    """The newest status of each name."""

    def __init__(self, talker: Any) -> None:
        talker.hear("/diagnostics", ARRAY)
        self.talker = talker

    def status(self, name: str) -> Any:
        """Return the newest status of a node, or of all; None before it comes."""
        name = name if ":" in name else f"{name}: status"
        for array in reversed(self.talker.got["/diagnostics"]):
            for status in array.status:
                if status.name == name:
                    return status
        return None

    def values(self, name: str) -> dict[str, str]:
        status = self.status(name)
        return {} if status is None else {v.key: v.value for v in status.values}

    def wait_level(self, name: str, level: int, words: str = "") -> Any:
        """Wait for a level and words of a message."""

        def there() -> Any:
            status = self.status(name)
            fits = status is not None and status.level == bytes([level]) and words in status.message
            return status if fits else None

        try:
            return self.talker.wait(there, "")
        except AssertionError:
            status = self.status(name)
            pytest.fail(f"{name} is not at {level} ({words}) but {status}")

    def wait_value(self, name: str, key: str, value: str) -> None:
        def there() -> bool:
            return self.values(name).get(key) == value

        try:
            self.talker.wait(there, "")
        except AssertionError:
            pytest.fail(f"{name}: {key} is not {value} in {self.values(name)}")


def settled(vehicle: Any, live: Any) -> dict[str, Any]:
    """Wait until no node holds an item any more; return the accounts."""

    def accounts() -> dict[str, Any]:
        return {node.NAME: node.health.ledger.account() for node in live.nodes}

    vehicle.talker.wait(
        lambda: not any(account.waiting for account in accounts().values()),
        "all that came was answered or dropped",
    )
    return accounts()


def test_the_health_of_nodes_that_follow_a_pipe(bench: Any) -> None:
    live, vehicle = bench.live(), bench.vehicle()
    board = Board(vehicle.talker)
    bench.matched(vehicle.talker)
    # Nothing has come yet; after a while that is an error.
    board.wait_level("stereo_vectorizer", WARN, "waiting for stereo/left/image_rect")
    for k in range(4):
        vehicle.scene.images(k)
        # Stamps are the present time: nothing is late.
        now = vehicle.talker.node.get_clock().now().nanoseconds
        vehicle.drive(k, shift_ns=now - vehicle.scene.stamp(k))
    board.wait_value("pipe_tracker", "frames processed", "4")
    values = board.values("pipe_tracker")
    assert values["state"] == "active"
    assert (values["tracking"], values["reset counter"]) == ("tracking", "0")
    assert float(values["5.3.1: overlap"]) == pytest.approx(0.9, abs=0.05)
    assert float(values["5.3.1: time used t1, 95 % [ms]"]) > 0.0
    assert float(values["5.3.1: time available t2 [ms]"]) > 0.0
    assert float(values["latency, median [ms]"]) > 0.0
    assert values["pipeline/vectorized: received"] == "4"
    assert values["vnm/pose: received"] == "4"
    assert values["pipeline/recognition: state"] in {"ok", "late", "ahead of the clock"}
    board.wait_value("stereo_vectorizer", "images processed", "8")
    board.wait_value("local_recognizer", "requests processed", "1")
    board.wait_value("relative_state_publisher", "statuses processed", "4")
    assert float(board.values(OVERALL)["last valid relative state ago [s]"]) >= 0.0
    for name in NAMES:
        assert board.status(name).hardware_id == "pipeline_tracker"
    # The cameras fall silent.
    board.wait_level("stereo_vectorizer", ERROR, "stereo/left/image_rect stale for")
    board.wait_level(OVERALL, ERROR, "stereo_vectorizer: status: stereo/left/camera_info stale")
    # The tracker is still and has no voice any more.
    tracker = live.node("pipe_tracker")
    tracker._speaker._timer.cancel()
    board.wait_level(OVERALL, ERROR, "pipe_tracker: status is silent")


def test_every_image_request_frame_and_status_is_accounted_for(bench: Any) -> None:
    live, vehicle = bench.live(), bench.vehicle()
    bench.matched(vehicle.talker)
    scene, sent = vehicle.scene, {"left": 0, "right": 0}
    ledger = live.node("stereo_vectorizer").health.ledger

    def arrived() -> None:
        # One by one: where many wait, the middleware lets the oldest of a queue give way.
        vehicle.talker.wait(
            lambda: ledger.account().received == sum(sent.values()), "the image to arrive"
        )

    def image(side: str, k: int, stamp: int, **changes: Any) -> None:
        message = vehicle.image(side, k, stamp)
        for name, value in changes.items():
            setattr(message, name, value)
        sent[side] += 1
        vehicle.send(f"stereo/{side}/image_rect", message)
        arrived()

    def frame(k: int, shift: int = 0, **changes: Any) -> None:
        stamp = scene.stamp(k) + shift
        vehicle.send("vnm/pose", vehicle.pose(k, stamp))
        for side in ("left", "right"):
            vehicle.send(f"stereo/{side}/camera_info", vehicle.info(side, stamp))
            image(side, k, stamp, **changes if side == "left" else {})

    vehicle.drive(0)
    sent = {"left": 1, "right": 1}
    # A partner is missing, on either side; then a late, a corrupt and a repeated image.
    image("left", 1, scene.stamp(1))
    image("right", 1, scene.stamp(1) + 50_000_000)
    frame(2)
    image("left", 0, scene.stamp(0) + 10_000_000)
    frame(3, step=10)
    frame(4, encoding="bayer_rggb8")
    image("left", 4, scene.stamp(4))
    # One whose header is impossible.
    broken = vehicle.image("left", 5, scene.stamp(5))
    broken.header.stamp.nanosec = 2_000_000_000
    sent["left"] += 1
    vehicle.send("stereo/left/image_rect", broken)
    arrived()
    vehicle.drive(6)
    sent = {side: count + 1 for side, count in sent.items()}
    _spoil_frames(bench, live, vehicle)
    accounts = settled(vehicle, live)
    images = accounts["stereo_vectorizer"]
    assert images.received == sum(sent.values())
    assert images.received == images.processed + images.lost
    assert images.dropped == {
        "no_right_image": 1,
        "no_left_image": 1,
        "late": 1,
        "repeated": 1,
        "pair refused": 4,
        "stereo/left/image_rect refused": 1,
    }
    frames = accounts["pipe_tracker"]
    assert frames.received == images.processed // 2 + 2
    assert frames.received == frames.processed + frames.lost
    assert frames.dropped == {"frame_late_or_repeated": 1, "pipeline/vectorized refused": 1}
    statuses = accounts["relative_state_publisher"]
    assert statuses.received == statuses.processed == frames.processed
    requests = accounts["local_recognizer"]
    assert requests.received == requests.processed == 1


def _spoil_frames(bench: Any, live: Any, vehicle: Any) -> None:
    """Send the tracker a frame that is late, and one with an impossible number."""
    late = vehicle.talker.got["pipeline/vectorized"][-1]
    vehicle.talker.publisher("pipeline/vectorized", "pipeline_tracker_msgs/msg/VectorizedStereo")
    bench.matched(vehicle.talker)
    vehicle.send("pipeline/vectorized", late)
    late.processing_time = math.nan
    vehicle.send("pipeline/vectorized", late)
    ledger = live.node("pipe_tracker").health.ledger
    vehicle.talker.wait(lambda: ledger.account().lost == 2, "both are refused")


def test_overruns_are_in_the_account_and_so_is_what_is_cut_off(bench: Any) -> None:
    from pipeline_tracker.nodes.stereo_vectorizer import QUEUE, StereoVectorizer

    live, vehicle = bench.live(kinds=[StereoVectorizer]), bench.vehicle()
    bench.matched(vehicle.talker)
    node = live.node("stereo_vectorizer")
    go_on, computes = threading.Event(), threading.Event()
    process = node._vectorizer.process

    def slow(*given: Any) -> Any:
        computes.set()
        assert go_on.wait(60.0)
        return process(*given)

    node._vectorizer.process = slow
    ledger, pairs = node.health.ledger, QUEUE + 4
    for k in range(pairs):
        vehicle.frame(k, pose=False)
        vehicle.talker.wait(
            lambda k=k: ledger.account().received == 2 * (k + 1), f"images of frame {k}"
        )
    vehicle.talker.wait(computes.is_set, "the first pair is under way")
    vehicle.talker.wait(lambda: ledger.account().lost == 6, "three pairs gave way")
    account = ledger.account()
    assert account.dropped == {"overrun": 6}
    assert account.waiting == 2 * (QUEUE + 1)
    # What waits and what is under way when the node is deactivated is dropped, not forgotten.
    live.executor.create_task(node.trigger_deactivate)
    vehicle.talker.wait(lambda: not node.is_active, "the node is inactive")
    go_on.set()
    vehicle.talker.wait(lambda: ledger.account().waiting == 0, "nothing is left")
    account = ledger.account()
    assert account.received == 2 * pairs
    assert account.dropped["deactivated"] == 2 * QUEUE
    # The pair under way may still have been answered.
    assert account.processed + account.dropped.get("result_of_before", 0) == 2


def test_life_is_told_from_the_start_and_nothing_leaks(bench: Any) -> None:
    from rclpy.parameter import Parameter

    from pipeline_tracker.nodes.pipe_tracker import PipeTracker

    live = bench.live("autostart=false", kinds=[PipeTracker])
    talker = bench.talker()
    board = Board(talker)
    node = live.node("pipe_tracker")
    board.wait_level("pipe_tracker", WARN, "unconfigured")

    def change(transition: Any) -> None:
        done: list[Any] = []
        live.executor.create_task(lambda: done.append(transition()))
        talker.wait(lambda: done, "the transition")

    def held() -> tuple[int, ...]:
        return (
            len(list(node.publishers)),
            len(list(node.subscriptions)),
            len(list(node.timers)),
            len(list(node.services)),
            len(node.health._inputs),
        )

    before = held()
    # A configuration that fails is told with its cause.
    assert node.set_parameters([Parameter("pipe.diameter", value=-1.0)])[0].successful
    change(node.trigger_configure)
    board.wait_level("pipe_tracker", ERROR, "unconfigured: pipe.diameter=-1.0")
    assert held() == before
    assert node.set_parameters([Parameter("pipe.diameter", value=0.6)])[0].successful
    change(node.trigger_configure)
    board.wait_level("pipe_tracker", WARN, "inactive")
    assert not node.health._inputs
    change(node.trigger_activate)
    board.wait_level("pipe_tracker", WARN, "waiting for pipeline/vectorized")
    assert len(node.health._inputs) == 3
    for _ in range(10):
        change(node.trigger_deactivate)
        change(node.trigger_cleanup)
        assert held() == before
        change(node.trigger_configure)
        change(node.trigger_activate)
    change(node.trigger_deactivate)
    change(node.trigger_cleanup)
    assert held() == before


def test_ends_of_a_topic_that_do_not_fit_are_told_on_both_sides(bench: Any) -> None:
    from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

    from pipeline_tracker.nodes.conversions import message_class
    from pipeline_tracker.nodes.pipe_tracker import PipeTracker

    live = bench.live(kinds=[PipeTracker])
    talker = bench.talker()
    board = Board(talker)
    frames, statuses = (
        message_class(f"pipeline_tracker_msgs/msg/{name}")
        for name in ("VectorizedStereo", "TrackingStatus")
    )
    best_effort = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
    keeps = QoSProfile(depth=5, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    offers = talker.node.create_publisher(frames, "pipeline/vectorized", best_effort)
    wants = talker.node.create_subscription(statuses, "pipeline/status", print, keeps)
    board.wait_level("pipe_tracker", WARN, "offers less RELIABILITY")
    board.wait_level("pipe_tracker", WARN, "asks for more DURABILITY")
    values = board.values("pipe_tracker")
    assert values["pipeline/vectorized: quality of service"].startswith("pipeline/vectorized: a")
    assert "DURABILITY" in values["pipeline/status: quality of service"]
    # When they are gone it is well again.
    talker.node.destroy_publisher(offers)
    talker.node.destroy_subscription(wants)
    talker.wait(
        lambda: "pipeline/status: quality of service" not in board.values("pipe_tracker"),
        "the mismatch is forgotten",
    )
    assert live.node("pipe_tracker").health.mismatches == []


def test_messages_that_are_sent_but_do_not_come_are_counted(bench: Any) -> None:
    from pipeline_tracker.nodes.stereo_vectorizer import StereoVectorizer

    live, vehicle = bench.live(kinds=[StereoVectorizer]), bench.vehicle()
    bench.matched(vehicle.talker)
    node = live.node("stereo_vectorizer")
    watch = node.health._inputs["stereo/left/camera_info"]
    # The node's executor is held up: more than the queue's depth comes meanwhile.
    held, go_on = threading.Event(), threading.Event()

    def hold() -> None:
        held.set()
        assert go_on.wait(60.0)

    def send(count: int) -> None:
        for _ in range(count):
            vehicle.send("stereo/left/camera_info", vehicle.info("left", vehicle.scene.stamp(0)))

    send(1)
    vehicle.talker.wait(lambda: watch.received == 1, "the first one")
    live.executor.create_task(hold)
    vehicle.talker.wait(held.is_set, "the executor is held up")
    send(40)
    go_on.set()
    vehicle.talker.wait(lambda: watch.received + watch.lost == 41, "all are received or lost")
    assert watch.received < 20
    assert "messages sent but not received" in node.health.report().message


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_nothing_that_is_not_finite_leaves_a_node(
    bench: Any, monkeypatch: Any, value: float
) -> None:
    from dataclasses import replace

    from pipeline_tracker.relative_state import RelativeStateEstimator
    from pipeline_tracker.tracking.tracker import Tracker

    live, vehicle = bench.live(), bench.vehicle()
    bench.matched(vehicle.talker)
    vehicle.drive(0)
    begin, update = Tracker.begin, RelativeStateEstimator.update

    def bad_segment(self: Any, *given: Any) -> Any:
        tracked = begin(self, *given)
        if tracked is None or tracked.segment is None:
            return tracked
        return replace(tracked, segment=replace(tracked.segment, radius=value))

    with monkeypatch.context() as patched:
        patched.setattr(Tracker, "begin", bad_segment)
        state = vehicle.drive(1)
    assert not state.valid
    status = vehicle.status(vehicle.scene.stamp(1))
    assert status.reason.startswith("internal error: MessageError: radius is")
    assert live.drops("pipe_tracker") == {"internal_error": 1}
    good = vehicle.drive(2)
    assert good.valid
    assert good.reset_counter == 1

    def bad_state(self: Any, *given: Any) -> Any:
        return replace(update(self, *given), lateral_offset=value)

    with monkeypatch.context() as patched:
        patched.setattr(RelativeStateEstimator, "update", bad_state)
        state = vehicle.drive(3)
    assert not state.valid
    assert (state.lateral_offset, state.heading_variance) == (0.0, -1.0)
    assert live.drops("relative_state_publisher") == {"internal_error": 1}
    assert vehicle.drive(4).valid
    settled(vehicle, live)
    for messages in vehicle.talker.got.values():
        for message in messages:
            check_finite(message)
