"""From a scenario to a bag."""

from __future__ import annotations

import heapq
import sys
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline_tracker.bags.fresh import fresh_bag
from pipeline_tracker.bags.typestore import BagMessages
from pipeline_tracker.errors import SettingsError
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.simulation.ahead import made_ahead
from pipeline_tracker.simulation.altimeter import Altimeter
from pipeline_tracker.simulation.axis import PipeAxis
from pipeline_tracker.simulation.landing import THINGS
from pipeline_tracker.simulation.lens import lenses_of
from pipeline_tracker.simulation.light import lamps_of, reference_light, water_of
from pipeline_tracker.simulation.motion import Motion
from pipeline_tracker.simulation.navigation import vnm_track, without
from pipeline_tracker.simulation.recording import write_bag
from pipeline_tracker.simulation.records import ALTIMETER, OPTICAL, SIDES, Messages, Record
from pipeline_tracker.simulation.render_progress import RenderProgress
from pipeline_tracker.simulation.renderer import Renderer, Rendering
from pipeline_tracker.simulation.scenario import Scenario
from pipeline_tracker.simulation.scenario_files import dump_scenario, load_scenario
from pipeline_tracker.simulation.scene import Scene, build_scene, draw_axis
from pipeline_tracker.simulation.sensor import Sensor
from pipeline_tracker.simulation.snow import SnowView, draw_snow
from pipeline_tracker.simulation.streams import random_stream
from pipeline_tracker.simulation.truth import frame_contours, stretch_in_view

Array = NDArray[np.float64]

# The first pair's stamp: a fixed time, so that a bag depends on scenario and seed alone.
FIRST_STAMP_NS = 1_750_000_000_000_000_000
_CLEARANCE = 0.05
# So many images are in the making at a time, each on all cores: while one is exposed and packed
# the other is rendered.
_AHEAD = 2


@dataclass(frozen=True)
class Sea:
    """A scenario's scene with a vehicle in it.

    Attributes:
        scenario: what it was made from.
        scene: pipe, bed and stones.
        motion: the vehicle's true motion; time 0 is the first pair's.
        renderer, sensor: make its images.
        snow_views: draw marine snow into them, one for each camera.
    """

    scenario: Scenario
    scene: Scene
    motion: Motion
    renderer: Renderer
    sensor: Sensor
    snow_views: tuple[SnowView, ...]

    def picture(self, frame: int, index: int) -> Rendering:
        """Render what camera ``index`` sees of pair ``frame``, before its sensor."""
        time = float(self.times()[frame])
        rendering = self.renderer.render(self.motion.pose(time), index, self.scene.at(time))
        if self.scenario.water.snow == 0.0:
            return rendering
        # The same stream for both cameras: the same particles.
        snow = draw_snow(self.scenario, random_stream(self.scenario, "snow", frame))
        light = self.snow_views[index].over(rendering.light, rendering.distance, snow)
        return replace(rendering, light=light)

    def times(self) -> Array:
        """Return the pairs' times, s after the first."""
        return _pair_times(self.scenario)

    def mountings(self) -> tuple[Pose, ...]:
        """Return base_link <- optical frame of each camera."""
        left = self.scenario.camera.mounting()
        cameras = self.scenario.camera.rig().cameras
        return tuple(left @ Pose(np.eye(3), camera.centre) for camera in cameras)


def build_sea(scenario: Scenario) -> Sea:
    """Build a scenario's sea.

    Raises:
        SettingsError: a camera or a lamp would be inside the pipe or below the bed.
        PipelineTrackerError: the extra ``[sim]`` is not installed.
    """
    shape, path, ground = (random_stream(scenario, name) for name in ("axis", "motion", "scene"))
    axis = draw_axis(scenario, shape)
    motion = Motion.draw(scenario, axis, path)
    if scenario.pipe.present:
        _check_clear_of_pipe(scenario, axis, motion)
    scene = build_scene(scenario, axis, ground)
    _check_above_bed(scenario, scene, motion)
    _check_clear_of_things(scenario, scene, motion)
    lamps = lamps_of(scenario.lamps)
    reference = reference_light(scenario, lamps)
    water = water_of(scenario, reference)
    renderer = Renderer(scenario, scene, water)
    cameras = range(len(scenario.camera.rig().cameras))
    snow_views = tuple(SnowView.of(scenario, lamps, water, n) for n in cameras)
    return Sea(scenario, scene, motion, renderer, Sensor.of(scenario, reference), snow_views)


def simulate(
    scenario: str | Path,
    output: Path,
    overrides: Sequence[str] = (),
    seed: int | None = None,
    progress: bool = True,
) -> Path:
    """Make a bag with images, calibration, poses and truth.

    The same scenario and seed give the same bytes.

    Args:
        scenario: name of a scenario that comes with the package, or path of a YAML file.
        output: directory of the bag, new or empty; its name becomes the bag's.
        overrides: ``key=value`` each, key dotted, value YAML.
        seed: wins over the scenario's.
        progress: show a bar on stderr, where that is a terminal, and at the end the speed.

    Returns:
        The directory of the bag.

    Raises:
        SettingsError: the scenario is unknown, or a value of it impossible.
        BagError: ``output`` is not empty or cannot be written.
        PipelineTrackerError: the extra ``[sim]`` is not installed.
    """
    loaded = load_scenario(scenario, overrides, seed)
    output = Path(output)
    with fresh_bag(output) as path:
        sea = build_sea(loaded)
        factory = BagMessages()
        records = heapq.merge(
            _frames(sea, Messages(factory), progress),
            _navigation(sea, Messages(factory)),
            key=lambda record: record.stamp,
        )
        write_bag(path, factory, records)
    return output


def _pair_times(scenario: Scenario) -> Array:
    return scenario.path.period * np.arange(scenario.frames, dtype=np.float64)


def _carried(scenario: Scenario) -> Iterator[tuple[str, Array]]:
    """Yield what must stay in the water, with its place in base_link."""
    mounting = scenario.camera.mounting()
    # In mono there is the left one only.
    for name, camera in zip(SIDES, scenario.camera.rig().cameras, strict=False):
        yield f"the {name} camera", mounting.apply(camera.centre)
    for index, lamp in enumerate(scenario.lamps):
        yield f"lamps.{index}", np.array(lamp.position)


def _check_clear_of_pipe(scenario: Scenario, axis: PipeAxis, motion: Motion) -> None:
    for time in _pair_times(scenario):
        pose = motion.pose(float(time))
        for name, mounted in _carried(scenario):
            place = pose.apply(mounted)
            s, _ = axis.nearest(place)
            clear = float(np.linalg.norm(place - axis.points(s))) - axis.radius
            if clear < _CLEARANCE:
                raise SettingsError(
                    f"at {time:g} s {name} is {clear:.2f} m from the pipe's surface, expected at "
                    f"least {_CLEARANCE:g} m outside it; change path.distance="
                    f"{scenario.path.distance:g}, path.distance_sway or its mounting"
                )


def _check_above_bed(scenario: Scenario, scene: Scene, motion: Motion) -> None:
    for time in _pair_times(scenario):
        pose = motion.pose(float(time))
        for name, mounted in _carried(scenario):
            place = pose.apply(mounted)
            height = float(place[2] - scene.bed.height_at(place[None])[0])
            if height < _CLEARANCE:
                where = f"{height:.2f} m above" if height > 0.0 else f"{-height:.2f} m below"
                raise SettingsError(
                    f"at {time:g} s {name} is {where} the bed, expected at least {_CLEARANCE:g} m "
                    f"above it; change path.distance={scenario.path.distance:g}, "
                    "path.distance_sway, bed.burial, bed.drifts or its mounting"
                )


def _check_clear_of_things(scenario: Scenario, scene: Scene, motion: Motion) -> None:
    """Refuse a vehicle inside or below a thing: looking up it would see one."""
    up = np.array([[0.0, 0.0, 1.0]], np.float32)
    for time in _pair_times(scenario):
        pose = motion.pose(float(time))
        for name, mounted in _carried(scenario):
            place = pose.apply(mounted)
            if scene.caster.nearest(place.astype(np.float32)[None], up).mesh[0] == THINGS:
                raise SettingsError(
                    f"at {time:g} s {name} is inside or below something on the bed, expected free "
                    f"water above it; change path.distance={scenario.path.distance:g}, tubes, "
                    "ledges or weed"
                )


def _frames(sea: Sea, messages: Messages, progress: bool) -> Iterator[Record]:
    """Yield the records of all pairs, image by image."""
    cameras = len(sea.mountings())
    jobs = ((frame, n) for frame in range(sea.scenario.frames) for n in range(cameras))

    def make(job: tuple[int, int]) -> Record:
        return _image(sea, messages, *job)

    images = made_ahead(make, jobs, _AHEAD)
    stream = sys.stderr if progress else None
    with closing(images), RenderProgress(sea.scenario.frames, stream) as shown:
        for frame in range(sea.scenario.frames):
            yield from _frame(sea, messages, frame, [next(images) for _ in range(cameras)])
            shown.advance()


def _stamp(time: float) -> int:
    return FIRST_STAMP_NS + round(time * 1e9)


def _image(sea: Sea, messages: Messages, frame: int, n: int) -> Record:
    """Take the image of camera n of a pair. Any thread may, in any order."""
    light = sea.picture(frame, n).light
    rng = random_stream(sea.scenario, "noise", frame, n)
    image = sea.sensor.expose(light, rng, _brightness(sea.scenario, frame, n))
    return messages.image(_stamp(sea.times()[frame]), n, image, sea.scenario.camera)


def _frame(sea: Sea, messages: Messages, frame: int, images: list[Record]) -> Iterator[Record]:
    time = float(sea.times()[frame])
    base, stamp = sea.motion.pose(time), _stamp(time)
    axis, cameras = sea.scene.axis, sea.scenario.camera.rig().cameras
    poses = tuple(base @ mounting for mounting in sea.mountings())
    for n, (lens, image) in enumerate(zip(lenses_of(sea.scenario.camera), images, strict=True)):
        yield messages.camera_info(stamp, n, lens)
        yield image
    yield messages.true_pose(stamp, base)
    present = sea.scenario.pipe.present
    s = stretch_in_view(axis, cameras, poses) if present else np.zeros(0)
    caster = sea.scene.at(time).caster
    yield messages.centerline(stamp, axis.points(s), axis.tangents(s))
    for n, (camera, pose) in enumerate(zip(cameras, poses, strict=True)):
        contours = frame_contours(axis, caster, camera, pose, s)
        yield messages.contours(stamp, n, contours)


def _brightness(scenario: Scenario, index: int, n: int) -> float:
    """Return the exposure of camera n's image relative to the scenario's."""
    # Both cameras are exposed by one control.
    varied = float(random_stream(scenario, "exposure", index).standard_normal())
    brightness = float(np.exp(scenario.camera.exposure_variation * varied))
    return brightness * (1.0 + scenario.camera.mismatch) if n == 1 else brightness


def _navigation(sea: Sea, messages: Messages) -> Iterator[Record]:
    """Yield what comes at the navigation's rate, and what is latched before it."""
    scenario, rng = sea.scenario, random_stream(sea.scenario, "sensors")
    track = vnm_track(sea.motion, scenario, random_stream(scenario, "vnm"))
    first = FIRST_STAMP_NS + int(track.stamps[0])
    sensors, tilt = scenario.sensors, np.deg2rad(scenario.sensors.attitude_noise_deg)
    yield messages.mountings(
        first,
        [*zip(OPTICAL, sea.mountings(), strict=False), (ALTIMETER, sensors.altimeter())],
    )
    yield messages.scenario(first, dump_scenario(scenario))
    altimeter = Altimeter(sensors, sea.scene.caster, random_stream(scenario, "altimeter"))
    heard = without(track.stamps.astype(np.float64) * 1e-9, sensors.altimeter_dropouts)
    for n, (offset, pose) in enumerate(zip(track.stamps, track.poses, strict=True)):
        stamp, true = FIRST_STAMP_NS + int(offset), sea.motion.pose(float(offset) * 1e-9)
        if track.sent[n]:
            yield from messages.navigation(stamp, track, n)
        distance = altimeter.measure(true)
        if heard[n]:
            yield messages.altimeter(stamp, distance, sensors)
        roll, pitch, _ = true.rpy()
        noisy = np.array([roll, pitch, pose.rpy()[2]])
        noisy += tilt * np.append(rng.standard_normal(2), 0.0)
        yield messages.attitude(stamp, Pose.from_rpy(np.zeros(3), noisy), tilt)
