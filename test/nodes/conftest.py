"""What the tests of the nodes share: a scene, a ROS domain for each test, live nodes.

Everything waits for conditions with a deadline; nothing sleeps and hopes.
"""

from __future__ import annotations

import contextlib
import fcntl
import itertools
import os
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from pipeline_tracker.geometry.camera import Camera, StereoRig
from pipeline_tracker.geometry.pose import Pose

# A condition on a busy machine may take its time.
DEADLINE = 30.0
SECOND = 1_000_000_000


class Scene:
    """A vehicle that looks straight down on a pipe and follows it.

    The pipe, 0.6 m thick, lies along x of odom; the vehicle flies 2.3 m above its axis.
    """

    start_ns = 1_700_000_000 * SECOND
    period_ns = SECOND // 2
    step = 0.2
    settings = (
        "pipe.diameter=0.6",
        "camera.translation=[0.0, 0.0, 0.0]",
        "camera.rotation_rpy=[3.141592653589793, 0.0, -1.5707963267948966]",
    )

    def __init__(self) -> None:
        camera = Camera(600.0, 600.0, 383.5, 287.5, 768, 576)
        self.rig = StereoRig(camera, replace(camera, offset=0.2))
        self._made: dict[int, tuple[NDArray[np.uint8], NDArray[np.uint8]]] = {}
        noise = np.random.default_rng(0).normal(0.0, 1.0, (512, 512))
        smooth = gaussian_filter(noise, 1.5, mode="wrap")
        self._texture = smooth / smooth.std() * 12.0

    def stamp(self, k: int) -> int:
        return self.start_ns + k * self.period_ns

    def pose(self, k: float) -> Pose:
        return Pose(np.eye(3), np.array([k * self.step, 0.05, 2.3]))

    def images(self, k: int) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
        if k not in self._made:
            left, right = (self._image(camera, k) for camera in self.rig.cameras)
            self._made[k] = left, right
        return self._made[k]

    def _image(self, camera: Camera, k: int) -> NDArray[np.uint8]:
        radius, distance, fine = 0.3, 2.3, 2
        rows, columns = fine * camera.height, fine * camera.width
        ys, xs = np.mgrid[0:rows, 0:columns]
        u = ((xs + 0.5) / fine - 0.5 - camera.cx) / camera.fx
        v = ((ys + 0.5) / fine - 0.5 - camera.cy) / camera.fy
        # Ray (o + s u, s v, s) against the cylinder x² + (z - distance)² = radius².
        o = camera.offset - 0.05
        a, b = u * u + 1.0, o * u - distance
        root = b * b - a * (o * o + distance**2 - radius**2)
        hit = root > 0
        s = np.where(hit, (-b - np.sqrt(np.maximum(root, 0.0))) / a, distance + radius)
        # The top of the picture is forward.
        x, y = camera.offset + s * u, s * v - k * self.step
        texture = self._texture[(y * 60).astype(int) % 512, (x * 60).astype(int) % 512]
        bright = np.where(hit, 150.0, 60.0) + texture
        pixels = bright.reshape(camera.height, fine, camera.width, fine).mean(axis=(1, 3))
        return np.asarray(np.rint(pixels), np.uint8)


@pytest.fixture(scope="session")
def scene() -> Scene:
    return Scene()


@pytest.fixture(scope="session")
def compiled() -> None:
    """All kernels compiled, as the nodes do before they are ready."""
    from pipeline_tracker.pipeline import warm_up

    warm_up()


@pytest.fixture(scope="session")
def transport() -> None:
    """Shared memory that holds the images that the tests publish, as camera drivers need it."""
    from pipeline_tracker.nodes.process import prepare_transport

    prepare_transport(local=True)


@pytest.fixture
def domain(transport: None) -> Iterator[int]:  # noqa: ARG001
    """A ROS domain that no other test on this computer uses meanwhile."""
    directory = Path(tempfile.gettempdir()) / f"pipeline_tracker_domains_{os.getuid()}"
    directory.mkdir(exist_ok=True)
    # Above 101, Linux gives the ports to others.
    for number in itertools.cycle(range(1, 101)):
        with (directory / str(number)).open("w") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                continue
            if is_quiet(number):
                yield number
                return


def is_quiet(number: int) -> bool:
    """Whether nobody is in a ROS domain: the ports of its first participants are free."""
    for participant in range(20):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind(("", 7410 + 250 * number + 2 * participant))
            except OSError:
                return False
    return True


class Talker:
    """The test's own node: it publishes input and keeps all that is published."""

    def __init__(self, domain: int, namespace: str = "") -> None:
        import rclpy
        from rclpy.executors import SingleThreadedExecutor

        self.context = rclpy.Context()
        rclpy.init(args=[], context=self.context, domain_id=domain)
        self.node = rclpy.create_node("talker", context=self.context, namespace=namespace)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.got: dict[str, list[Any]] = defaultdict(list)
        self._publishers: dict[str, Any] = {}

    def close(self) -> None:
        self.executor.shutdown()
        self.node.destroy_node()
        self.context.try_shutdown()

    def publisher(self, topic: str, type_name: str) -> Any:
        from pipeline_tracker.nodes.conversions import message_class

        if topic not in self._publishers:
            kind = message_class(type_name)
            self._publishers[topic] = self.node.create_publisher(kind, topic, 50)
        return self._publishers[topic]

    def close_topic(self, topic: str) -> None:
        self.node.destroy_publisher(self._publishers.pop(topic))

    def hear(self, topic: str, type_name: str) -> None:
        from pipeline_tracker.nodes.conversions import message_class

        self.node.create_subscription(message_class(type_name), topic, self.got[topic].append, 50)

    def wait(self, condition: Callable[[], Any], what: str, within: float = DEADLINE) -> Any:
        """Spin until a condition holds; fail with ``what`` where it does not in time."""
        deadline = time.monotonic() + within
        while not (held := condition()):
            left = deadline - time.monotonic()
            assert left > 0.0, f"not within {within:g} s: {what}; got {self.counts()}"
            self.executor.spin_once(timeout_sec=min(left, 0.05))
        return held

    def watch(self, seconds: float) -> None:
        """Spin for a time: where what matters is that something does *not* happen."""
        deadline = time.monotonic() + seconds
        while (left := deadline - time.monotonic()) > 0.0:
            self.executor.spin_once(timeout_sec=left)

    def counts(self) -> dict[str, int]:
        return {topic: len(messages) for topic, messages in self.got.items()}


OUTPUTS = {
    "pipeline/vectorized": "pipeline_tracker_msgs/msg/VectorizedStereo",
    "pipeline/recognition": "pipeline_tracker_msgs/msg/PipeSegment",
    "pipeline/segment": "pipeline_tracker_msgs/msg/PipeSegment",
    "pipeline/status": "pipeline_tracker_msgs/msg/TrackingStatus",
    "pipeline/relative_state": "pipeline_tracker_msgs/msg/RelativeState",
    "pipeline/heading_misalignment": "std_msgs/msg/Float64",
    "pipeline/pitch_misalignment": "std_msgs/msg/Float64",
    "pipeline/approach_speed": "std_msgs/msg/Float64",
    "pipeline/min_distance": "std_msgs/msg/Float64",
    "pipeline/centerline": "nav_msgs/msg/Path",
    "pipeline/markers": "visualization_msgs/msg/MarkerArray",
}

INPUTS = {
    "stereo/left/image_rect": "sensor_msgs/msg/Image",
    "stereo/right/image_rect": "sensor_msgs/msg/Image",
    "stereo/left/camera_info": "sensor_msgs/msg/CameraInfo",
    "stereo/right/camera_info": "sensor_msgs/msg/CameraInfo",
    "vnm/pose": "geometry_msgs/msg/PoseStamped",
}


class Vehicle:
    """Publishes the scene as cameras and navigation of a vehicle would."""

    def __init__(self, talker: Talker, scene: Scene) -> None:
        from pipeline_tracker.nodes.conversions import LiveMessages

        self.talker = talker
        self.scene = scene
        self.factory = LiveMessages()
        for topic, kind in INPUTS.items():
            talker.publisher(topic, kind)
        for topic, kind in OUTPUTS.items():
            talker.hear(topic, kind)

    def send(self, topic: str, message: Any) -> None:
        self.talker.publisher(topic, INPUTS.get(topic, "")).publish(message)

    def info(self, side: str, stamp: int) -> Any:
        from pipeline_tracker.messages import camera_info_message

        camera = self.scene.rig.cameras[("left", "right").index(side)]
        return camera_info_message(self.factory, camera, stamp, "left_optical")

    def image(self, side: str, k: int, stamp: int) -> Any:
        from pipeline_tracker.messages import header_message

        pixels = self.scene.images(k)[("left", "right").index(side)]
        return self.factory.message(
            "sensor_msgs/msg/Image",
            header=header_message(self.factory, stamp, "left_optical"),
            height=pixels.shape[0],
            width=pixels.shape[1],
            step=pixels.shape[1],
            encoding="mono8",
            data=self.factory.sequence(pixels.ravel()),
        )

    def pose(self, k: float, stamp: int) -> Any:
        from pipeline_tracker.messages import header_message, pose_message

        return self.factory.message(
            "geometry_msgs/msg/PoseStamped",
            header=header_message(self.factory, stamp, "odom"),
            pose=pose_message(self.factory, self.scene.pose(k)),
        )

    def frame(self, k: int, *, shift_ns: int = 0, pose: bool = True) -> int:
        """Publish all that belongs to frame k; return its stamp."""
        stamp = self.scene.stamp(k) + shift_ns
        if pose:
            self.send("vnm/pose", self.pose(k, stamp))
        for side in ("left", "right"):
            self.send(f"stereo/{side}/camera_info", self.info(side, stamp))
            self.send(f"stereo/{side}/image_rect", self.image(side, k, stamp))
        return stamp

    def state(self, stamp: int) -> Any:
        """Return the newest relative state of a frame; None before it comes."""
        return self._newest("pipeline/relative_state", stamp)

    def status(self, stamp: int) -> Any:
        """Return the newest status of a frame; None before it comes."""
        return self._newest("pipeline/status", stamp)

    def _newest(self, topic: str, stamp: int) -> Any:
        from pipeline_tracker.messages import stamp_ns

        found = [m for m in self.talker.got[topic] if stamp_ns(m.header) == stamp]
        return found[-1] if found else None

    def drive(self, k: int, **options: Any) -> Any:
        """Publish frame k and wait for its relative state."""
        stamp = self.frame(k, **options)
        return self.talker.wait(lambda: self.state(stamp), f"relative state of frame {k}")

    def approach(self, k: int, within: float = 120.0) -> Any:
        """Publish frame k until its relative state comes: the nodes may still be starting.

        A little later each time: a stamp that a node has had before is dropped, and what it said
        of it may have been lost on a node that did not listen yet.
        """
        deadline = time.monotonic() + within
        shift = 0
        while True:
            stamp = self.frame(k, shift_ns=shift)
            shift += 1_000_000
            with contextlib.suppress(AssertionError):
                return self.talker.wait(partial(self.state, stamp), "", within=2.0)
            assert time.monotonic() < deadline, f"not within {within:g} s: a first state"


class Live:
    """Nodes of ours that run in a thread of the test's process."""

    def __init__(
        self, domain: int, kinds: list[Any], parameters: dict[str, Any], **options: Any
    ) -> None:
        import rclpy
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.lifecycle import TransitionCallbackReturn

        self.context = rclpy.Context()
        rclpy.init(args=[], context=self.context, domain_id=domain)
        self.nodes = [kind(parameters, context=self.context, **options) for kind in kinds]
        self.executor = SingleThreadedExecutor(context=self.context)
        for node in self.nodes:
            self.executor.add_node(node)
            if node.autostart:
                assert node.trigger_configure() == TransitionCallbackReturn.SUCCESS
        for node in self.nodes:
            if node.autostart:
                assert node.trigger_activate() == TransitionCallbackReturn.SUCCESS
        self._ended = False
        self.thread = threading.Thread(target=self._spin, daemon=True)
        self.thread.start()

    def _spin(self) -> None:
        while not self._ended:
            self.executor.spin_once()

    def node(self, name: str) -> Any:
        return next(node for node in self.nodes if name == node.NAME)

    def drops(self, name: str) -> dict[str, int]:
        return dict(self.node(name).drops)

    def close(self) -> None:
        self._ended = True
        self.executor.create_task(lambda: None)
        self.thread.join(DEADLINE)
        assert not self.thread.is_alive()
        for node in self.nodes:
            node.close()
            node.destroy_node()
        self.executor.shutdown()
        self.context.try_shutdown()


@dataclass
class Bench:
    """Makes what a test needs in its domain, and ends it all."""

    domain: int
    scene: Scene
    stack: contextlib.ExitStack
    directory: Path
    nodes: list[Any] = field(default_factory=list)

    def talker(self, namespace: str = "") -> Talker:
        talker = Talker(self.domain, namespace)
        self.stack.callback(talker.close)
        self.nodes.append(talker.node)
        return talker

    def matched(self, talker: Talker) -> None:
        """Wait until all nodes of the test, which are in this process, know each other's topics.

        Each end of a topic finds the other by itself: a message that is sent when only its
        publisher has found the subscription is lost.
        """
        publishers, subscriptions = Counter[str](), Counter[str]()
        for node in self.nodes:
            publishers.update(p.topic_name for p in node.publishers)
            subscriptions.update(s.topic_name for s in node.subscriptions)

        def all_matched() -> bool:
            ends = [
                *(
                    p.get_subscription_count() >= subscriptions[p.topic_name]
                    for node in self.nodes
                    for p in node.publishers
                ),
                *(
                    s.get_publisher_count() >= publishers[s.topic_name]
                    for node in self.nodes
                    for s in node.subscriptions
                ),
            ]
            return all(ends)

        talker.wait(all_matched, "all topics matched")

    def vehicle(self, namespace: str = "") -> Vehicle:
        return Vehicle(self.talker(namespace), self.scene)

    def live(self, *overrides: str, kinds: list[Any] | None = None, **options: Any) -> Live:
        from pipeline_tracker.nodes.launcher import node_parameters
        from pipeline_tracker.nodes.live import NODES
        from pipeline_tracker.settings_io import load_settings

        settings = load_settings(None, [*self.scene.settings, *overrides])
        live = Live(self.domain, kinds or list(NODES), node_parameters(settings), **options)
        self.stack.callback(live.close)
        self.nodes += live.nodes
        return live

    def process(self, code: str) -> Process:
        process = Process(code, self.domain, self.directory)
        self.stack.callback(process.close)
        return process


# A process that has been started ends with the tests, also when these are killed: then its
# standard input closes.
END_WITH_PARENT = """
import os, threading
def watch():
    os.read(0, 1)
    os._exit(9)
threading.Thread(target=watch, daemon=True).start()
"""


class Process:
    """A Python process of its own, with its output in files."""

    def __init__(self, code: str, domain: int, directory: Path) -> None:
        self.out = directory / f"out_{time.monotonic_ns()}"
        self.err = self.out.with_suffix(".err")
        environment = {**os.environ, "ROS_DOMAIN_ID": str(domain), "PYTHONUNBUFFERED": "1"}
        with self.out.open("w") as out, self.err.open("w") as err:
            self.popen = subprocess.Popen(
                [sys.executable, "-c", END_WITH_PARENT + code],
                stdin=subprocess.PIPE,
                stdout=out,
                stderr=err,
                env=environment,
                start_new_session=True,
            )

    @property
    def text(self) -> str:
        return self.out.read_text() + self.err.read_text()

    def wait_for(self, condition: Callable[[str], bool], what: str, within: float = 120.0) -> None:
        """Wait until the output fulfils a condition."""
        deadline = time.monotonic() + within
        while not condition(self.text):
            assert self.popen.poll() is None, f"ended before {what}: {self.text}"
            assert time.monotonic() < deadline, f"not within {within:g} s: {what}: {self.text}"
            with contextlib.suppress(subprocess.TimeoutExpired):
                self.popen.wait(0.05)

    def end(self, number: int = signal.SIGTERM, within: float = 20.0) -> tuple[int, float]:
        """Send a signal; return exit code and the time that it took, s."""
        started = time.monotonic()
        self.popen.send_signal(number)
        code = self.popen.wait(within)
        return code, time.monotonic() - started

    def close(self) -> None:
        # By a signal that it can answer: what is killed leaves its shared memory behind.
        self.popen.terminate()
        try:
            self.popen.wait(DEADLINE)
        except subprocess.TimeoutExpired:
            self.popen.kill()
            self.popen.wait()
        assert self.popen.stdin is not None
        self.popen.stdin.close()


@pytest.fixture
def bench(domain: int, scene: Scene, compiled: None, tmp_path: Path) -> Iterator[Bench]:  # noqa: ARG001
    """The means of a test over DDS, in its own domain and on this computer only."""
    with contextlib.ExitStack() as stack:
        yield Bench(domain, scene, stack, tmp_path)
