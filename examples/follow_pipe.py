"""A closed loop without hardware: follow a simulated pipe by the nodes' own answers.

Each step a pair of small images is ray-traced where the vehicle is, and published with its pose
over DDS to `pipeline-tracker run`; the relative state that comes back goes to the control law, and
its command moves the vehicle. Time is simulated and waits for the answers, so that it runs on any
machine. On the way a stretch of the pipe is buried. Writes ``path.csv`` and ``path.png``.

    python examples/follow_pipe.py --output followed
"""

from __future__ import annotations

import argparse
import csv
import math
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from numpy.typing import NDArray
from pipe_follower import Command, Gains, PipeFollower
from rclpy.node import Node
from rosgraph_msgs.msg import Clock

from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.messages import pose_stamped_message
from pipeline_tracker.nodes.conversions import LiveMessages
from pipeline_tracker.simulation.lens import lenses_of
from pipeline_tracker.simulation.records import Messages, Record
from pipeline_tracker.simulation.scenario_files import load_scenario
from pipeline_tracker.simulation.simulator import Sea, build_sea
from pipeline_tracker.simulation.streams import random_stream
from pipeline_tracker_msgs.msg import RelativeState

Array = NDArray[np.float64]

PERIOD = 0.5
FIRST = 1_000_000_000_000
SECOND = 1_000_000_000
# Poses between two images; the vehicle moves on at the same steps.
_SUBSTEPS = 10
_READY_WITHIN, _ANSWER_WITHIN = 120.0, 60.0
_COLUMNS = ("time", "x", "y", "z", "along", "cross_track", "distance", "valid", "surge", "yaw_rate")
_SEA = (
    "camera.jpeg_quality=null",
    "path.lateral_start=0.4",
    "path.lateral_end=0.4",
    "path.lateral_sway=0",
    "path.distance_sway=0",
    "path.heading_sway_deg=0",
)


@dataclass
class Vehicle:
    """A vehicle that answers to commands with a delay, in a current.

    Attributes:
        pose: true, world <- base_link.
        velocity: along its own axes, forward and up, m/s, and yaw rate, rad/s.
        current: of the water, world, m/s.
        delay: time constant of its answer, s.
    """

    pose: Pose
    velocity: Array
    current: Array
    delay: float = 0.5

    def move(self, command: Command, seconds: float) -> None:
        """Go on for some time under a command."""
        wanted = np.array([command.surge, command.heave, command.yaw_rate])
        self.velocity += (wanted - self.velocity) * (1.0 - math.exp(-seconds / self.delay))
        forward, up, turn = self.velocity
        place = self.pose.translation + seconds * (
            self.pose.rotate(np.array([forward, 0.0, up])) + self.current
        )
        yaw = float(self.pose.rpy()[2]) + seconds * float(turn)
        self.pose = Pose.from_rpy(place, np.array([0.0, 0.0, yaw]))


class Navigation:
    """A visual navigation: it knows each step almost, and its errors add up."""

    def __init__(self, rng: np.random.Generator) -> None:
        """Begin at odom's origin of its first pose."""
        self._rng = rng
        self._true: Pose | None = None
        self._pose = Pose.identity()

    def see(self, true: Pose) -> Pose:
        """Return odom <- base_link for a true pose."""
        if self._true is None:
            self._pose = true
        else:
            step = self._true.inverse() @ true
            way = float(np.linalg.norm(step.translation))
            wrong = Pose.from_rpy(
                step.translation * 1.005 + 0.002 * way * self._rng.standard_normal(3),
                step.rpy() + np.array([0.0, 0.0, 0.001 * way * self._rng.standard_normal()]),
            )
            self._pose = self._pose @ wrong
        self._true = true
        return self._pose


class World(Node):
    """Publishes what a vehicle's sensors see, and hears the relative states."""

    def __init__(self, sea: Sea) -> None:
        """Open the topics."""
        super().__init__("simulated_vehicle")
        self._sea = sea
        self._factory = LiveMessages()
        self._messages = Messages(self._factory)
        self._topics: dict[str, Any] = {}
        self._clock = self.create_publisher(Clock, "/clock", 10)
        self.states: dict[int, RelativeState] = {}
        self.create_subscription(RelativeState, "pipeline/relative_state", self._hear, 10)
        # Opened before anything is sent, so that the nodes find them.
        for index, lens in enumerate(lenses_of(sea.scenario.camera)):
            self._publisher(self._messages.camera_info(FIRST, index, lens))
            picture = np.zeros((sea.scenario.camera.height, sea.scenario.camera.width, 3), np.uint8)
            self._publisher(self._messages.image(FIRST, index, picture, sea.scenario.camera))
        self._publisher(self._pose(FIRST, Pose.identity()))

    def _hear(self, state: RelativeState) -> None:
        stamp = state.header.stamp
        self.states[stamp.sec * SECOND + stamp.nanosec] = state

    def _pose(self, stamp: int, pose: Pose) -> Record:
        return Record(stamp, "/vnm/pose", pose_stamped_message(self._factory, pose, stamp, "odom"))

    def _publisher(self, record: Record) -> Any:
        if record.topic not in self._topics:
            self._topics[record.topic] = self.create_publisher(
                type(record.message), record.topic.lstrip("/"), 10
            )
        return self._topics[record.topic]

    def send(self, record: Record) -> None:
        """Publish a message on its topic."""
        self._publisher(record).publish(record.message)

    def wait(self, met: Callable[[], bool], seconds: float, what: str) -> None:
        """Spin until a condition is met.

        Raises:
            TimeoutError: it is not, in time.
        """
        deadline = time.monotonic() + seconds
        while not met():
            if time.monotonic() > deadline:
                raise TimeoutError(f"{what} did not come within {seconds:g} s")
            rclpy.spin_once(self, timeout_sec=0.05)

    def wait_for_nodes(self) -> None:
        """Wait until the nodes listen to everything."""

        def heard() -> bool:
            publishers = [*self._topics.values(), self._clock]
            return all(publisher.get_subscription_count() > 0 for publisher in publishers)

        self.wait(heard, _READY_WITHIN, "the nodes' subscriptions")

    def tick(self, stamp: int, pose: Pose) -> None:
        """Publish time and pose of navigation."""
        clock = Clock()
        clock.clock.sec, clock.clock.nanosec = divmod(stamp, SECOND)
        self._clock.publish(clock)
        self.send(self._pose(stamp, pose))

    def look(self, stamp: int, frame: int, true: Pose) -> RelativeState:
        """Publish a pair and wait for its relative state."""
        sea = self._sea
        for index, lens in enumerate(lenses_of(sea.scenario.camera)):
            light = sea.renderer.render(true, index, sea.scene.at(0.0)).light
            rng = random_stream(sea.scenario, "noise", frame, index)
            image = sea.sensor.expose(light, rng, 1.0)
            self.send(self._messages.camera_info(stamp, index, lens))
            self.send(self._messages.image(stamp, index, image, sea.scenario.camera))
        self.wait(lambda: stamp in self.states, _ANSWER_WITHIN, "the relative state of a pair")
        return self.states.pop(stamp)


@contextmanager
def running_nodes(sea: Sea) -> Iterator[None]:
    """Run the nodes in a process of their own."""
    camera = sea.scenario.camera
    values = {
        "pipe.diameter": sea.scenario.pipe.diameter,
        "camera.translation": list(camera.translation),
        "camera.rotation_rpy": list(camera.rotation_rpy),
        "use_sim_time": "true",
        # Simulated time stands still while an image is rendered; nobody is silent.
        "output.timeout": 60.0,
    }
    command = [sys.executable, "-m", "pipeline_tracker.cli", "run"]
    for key, value in values.items():
        command += ["--set", f"{key}={value}"]
    process = subprocess.Popen(command, stdin=subprocess.DEVNULL)
    try:
        yield
    finally:
        process.terminate()
        try:
            process.wait(10.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def follow(length: float, width: int, seed: int, gains: Gains) -> list[dict[str, float]]:
    """Follow the pipe and return what happened, a row for each pair.

    Args:
        length: along the pipe, m.
        width: of the images, px.
        seed: of the sea.
        gains: of the control law.

    Raises:
        TimeoutError: the nodes do not answer.
    """
    size = [f"camera.width={width}", f"camera.height={2 * width // 3}"]
    # The sea reaches as far as a dive of so many frames would.
    frames = 1 + math.ceil(length / (gains.speed * PERIOD))
    way = [f"frames={frames}", f"path.speed={gains.speed}", f"path.period={PERIOD}"]
    sea = build_sea(load_scenario("silted", [*_SEA, *size, *way], seed))
    vehicle = Vehicle(_start(sea), np.zeros(3), np.array([0.0, 0.03, 0.0]))
    navigation = Navigation(np.random.default_rng(seed))
    follower = PipeFollower(gains)
    rows: list[dict[str, float]] = []
    world = World(sea)
    try:
        with running_nodes(sea):
            world.wait_for_nodes()
            # Something to begin with: a vehicle that drifts ahead, as it was released.
            command = Command(surge=gains.speed)
            world.tick(FIRST - SECOND // 10, navigation.see(vehicle.pose))
            frame, stamp = 0, FIRST
            while _along(sea, vehicle) < length and frame < 3 * frames:
                world.tick(stamp, navigation.see(vehicle.pose))
                state = world.look(stamp, frame, vehicle.pose)
                now = frame * PERIOD
                follower.see(state, now)
                if frame > 0 or state.valid:
                    command = follower.command(now)
                rows.append(_row(sea, vehicle, now, state, command))
                for n in range(1, _SUBSTEPS + 1):
                    vehicle.move(command, PERIOD / _SUBSTEPS)
                    if n < _SUBSTEPS:
                        between = stamp + round(n * PERIOD / _SUBSTEPS * SECOND)
                        world.tick(between, navigation.see(vehicle.pose))
                frame += 1
                stamp += round(PERIOD * SECOND)
    finally:
        world.destroy_node()
    return rows


def _start(sea: Sea) -> Pose:
    """Return a start to port of the pipe, and turned away from it."""
    pose = sea.motion.pose(0.0)
    return Pose.from_rpy(pose.translation, pose.rpy() * [0.0, 0.0, 1.0] + [0.0, 0.0, 0.1])


def _along(sea: Sea, vehicle: Vehicle) -> float:
    return float(sea.scene.axis.nearest(vehicle.pose.translation)[0])


def _row(
    sea: Sea, vehicle: Vehicle, now: float, state: RelativeState, command: Command
) -> dict[str, float]:
    place = vehicle.pose.translation
    s = sea.scene.axis.nearest(place)[0]
    _, right, _ = sea.scene.axis.frames(s)
    away = place - sea.scene.axis.points(s)
    return {
        "time": now,
        **dict(zip("xyz", map(float, place), strict=True)),
        "along": float(s),
        "cross_track": float(-away @ right),
        "distance": float(np.linalg.norm(away)) - sea.scene.axis.radius,
        "valid": float(state.valid),
        "surge": command.surge,
        "yaw_rate": command.yaw_rate,
    }


def cross_track_rms(rows: list[dict[str, float]], settled: float) -> float:
    """Return the root mean square distance to the side from the pipe, m.

    Args:
        rows: of ``follow``.
        settled: only rows so far along the pipe or farther, m.
    """
    values = [row["cross_track"] for row in rows if row["along"] >= settled]
    return float(np.sqrt(np.mean(np.square(values)))) if values else math.nan


def draw(rows: list[dict[str, float]], file: Path, settled: float) -> None:
    """Draw the path beside the pipe."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: PLC0415 - slow to import
    from matplotlib.figure import Figure  # noqa: PLC0415

    figure = Figure(figsize=(9.0, 6.0), layout="constrained")
    FigureCanvasAgg(figure)
    along = [row["along"] for row in rows]
    shown = {
        "cross-track, cm": [100.0 * row["cross_track"] for row in rows],
        "distance from the pipe, m": [row["distance"] for row in rows],
        "yaw rate, rad/s": [row["yaw_rate"] for row in rows],
    }
    for axes, (name, values) in zip(figure.subplots(3, sharex=True), shown.items(), strict=True):
        axes.plot(along, values, color="#0072B2")
        for before, after in pairwise(rows):
            if not before["valid"]:
                axes.axvspan(before["along"], after["along"], color="#D55E00", alpha=0.3, lw=0)
        axes.set_ylabel(name)
        axes.grid(color="#E5E5E5")
        axes.spines[["top", "right"]].set_visible(False)
    figure.axes[0].axhline(0.0, color="#000000", linewidth=0.8)
    figure.axes[0].set_title(
        f"cross-track RMS from {settled:g} m on: {100.0 * cross_track_rms(rows, settled):.1f} cm; "
        "shaded: no valid state",
        fontsize=10,
    )
    figure.axes[-1].set_xlabel("along the pipe, m")
    figure.savefig(file, dpi=130)


def main() -> int:
    """Follow the pipe, write what happened, say how well."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--output", type=Path, default=Path("followed"), metavar="DIR")
    parser.add_argument("--length", type=float, default=9.0, metavar="M", help="along the pipe")
    parser.add_argument("--width", type=int, default=480, metavar="PX", help="of the images")
    parser.add_argument("--seed", type=int, default=14, metavar="N", help="of the sea")
    parser.add_argument("--settled", type=float, default=2.5, metavar="M", help="RMS from here on")
    given = parser.parse_args()
    # This machine's nodes alone, whatever else is in the network.
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    given.output.mkdir(parents=True, exist_ok=True)
    rclpy.init()
    try:
        rows = follow(given.length, given.width, given.seed, replace(Gains(), distance=2.1))
    except TimeoutError as error:
        sys.stderr.write(f"follow_pipe: {error}\n")
        return 1
    finally:
        rclpy.try_shutdown()
    with (given.output / "path.csv").open("w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, _COLUMNS)
        writer.writeheader()
        writer.writerows(rows)
    draw(rows, given.output / "path.png", given.settled)
    valid = sum(bool(row["valid"]) for row in rows)
    rms = cross_track_rms(rows, given.settled)
    sys.stdout.write(
        f"{len(rows)} pairs, {valid} valid; {rows[-1]['along']:.1f} m along the pipe; "
        f"cross-track RMS {100.0 * rms:.1f} cm from {given.settled:g} m on\n"
        f"written: {given.output / 'path.csv'}, {given.output / 'path.png'}\n"
    )
    return 0 if rms < 0.05 else 1


if __name__ == "__main__":
    sys.exit(main())
