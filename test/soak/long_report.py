"""A replay's directory of many frames, made of a short one, and how quick its report is.

    python test/soak/long_report.py DIR OUTPUT --frames 10000

repeats the results in DIR (output of `pipeline-tracker replay`) along the pipe, with every output
written by the code that writes it in a replay, and writes the report. In every thousand frames
some are lost, one is of low quality. Where chromium and chromedriver are installed it tells how
long the page takes there to be drawn whole, to step to the next picture and to zoom.
"""

from __future__ import annotations

import argparse
import shutil
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from pipeline_tracker.bags.reader import BagReader
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.messages import (
    pose_from_message,
    relative_state_from_message,
    segment_from_message,
    stamp_ns,
    status_from_message,
    vectorized_from_message,
)
from pipeline_tracker.mounting import mounting_from_settings
from pipeline_tracker.pipeline import FrameResult
from pipeline_tracker.replay.estimates import EstimatesFile, estimate_row
from pipeline_tracker.replay.input import Frame
from pipeline_tracker.replay.result_bag import ResultBag
from pipeline_tracker.report.facts import RunFacts, write_facts
from pipeline_tracker.report.filmstrip import DIRECTORY, FilmStrip
from pipeline_tracker.report.record import read_record
from pipeline_tracker.report.write import write_report
from pipeline_tracker.tracking.tracker import TrackedFrame
from pipeline_tracker.types import RelativeState, State, TrackingStatus

READ = {
    "/pipeline/vectorized": vectorized_from_message,
    "/pipeline/segment": segment_from_message,
    "/pipeline/status": status_from_message,
    "/pipeline/relative_state": relative_state_from_message,
    "/vnm/pose": pose_from_message,
}
SECOND = 1_000_000_000


def results(directory: Path) -> list[dict[str, Any]]:
    """Return what each valid frame of a replay gave, by topic."""
    frames: dict[int, dict[str, Any]] = {}
    with BagReader(directory / "result") as bag:
        for record in bag.records(READ):
            message = record.unpack()
            stamp = stamp_ns(message.header)
            frames.setdefault(stamp, {})[record.topic] = READ[record.topic](message)
            if record.topic == "/pipeline/vectorized":
                frames[stamp]["infos"] = message.left_info, message.right_info
    whole = [frame for frame in frames.values() if len(frame) == len(READ) + 1]
    return [frame for frame in whole if frame["/pipeline/relative_state"].valid]


def repeated(
    frames: list[dict[str, Any]], count: int
) -> Iterator[tuple[Frame, FrameResult, Pose, int]]:
    """Yield the frames again and again, each time further along, and the number of the original."""
    first, last = frames[0]["/vnm/pose"][1], frames[-1]["/vnm/pose"][1]
    round_trip = (last.translation - first.translation) * len(frames) / (len(frames) - 1)
    chainage = frames[-1]["/pipeline/relative_state"].chainage * len(frames) / (len(frames) - 1)
    for index in range(count):
        again, number = divmod(index, len(frames))
        found = frames[number]
        stamp = found["/pipeline/status"].stamp_ns % SECOND + (1_700_000_000 + index) * SECOND
        own = found["/vnm/pose"][1]
        pose = Pose(own.rotation, own.translation + again * round_trip)
        status = replace(found["/pipeline/status"], stamp_ns=stamp)
        state = replace(
            found["/pipeline/relative_state"],
            stamp_ns=stamp,
            chainage=found["/pipeline/relative_state"].chainage + again * chainage,
        )
        segment = replace(found["/pipeline/segment"], stamp_ns=stamp)
        if index % 1000 == 333:
            state = replace(state, quality=0.21)
        if index % 1000 in range(600, 607):
            status = TrackingStatus(stamp, State.SEARCHING, "pipe_not_found", 0.0, 1.0, 0)
            state, segment = RelativeState(stamp, False, 0.0, 0), None
        vectorized = replace(found["/pipeline/vectorized"], stamp_ns=stamp)
        result = FrameResult(vectorized, None, TrackedFrame(status, segment), state)
        left_info, right_info = found["infos"]
        yield Frame(stamp, left_info=left_info, right_info=right_info), result, pose, number


def make(source: Path, output: Path, count: int) -> None:
    """Write the directory of the long replay, without its report."""
    record = read_record(source)
    output.mkdir(parents=True)
    shutil.copy(source / "settings.yaml", output)
    frames = results(source)
    rig = frames[0]["/pipeline/vectorized"].rig.left
    images = []
    for frame in frames:
        picture = cv2.imread(str(record.pictures[frame["/pipeline/status"].stamp_ns]), 0)
        images.append(np.asarray(cv2.resize(picture, (rig.width, rig.height)), np.uint8))
    mounting = mounting_from_settings(record.settings)
    strip = FilmStrip(output / DIRECTORY, mounting, count)
    bed = [(float(row["bed_left"] or 0.3), float(row["bed_right"] or 0.3)) for row in record.rows]
    with (
        EstimatesFile(output / "estimates.csv") as table,
        ResultBag(output / "result", record.settings, "left_optical", mounting, source) as bag,
    ):
        for frame, result, pose, number in repeated(frames, count):
            status, segment = result.tracked.status, result.tracked.segment
            state = result.relative_state
            table.write(
                0,
                estimate_row(
                    status, segment, state, has_pose=True, processing_ms=50.0, bed=bed[number]
                ),
            )
            seen = replace(frame, left=images[number])
            bag.write(seen, result.vectorized, None, status, segment, state, pose)
            strip.take(images[number], result)
        strip.finish()
    facts = RunFacts(
        version="0", bag="long", frames_expected=count, interrupted=False, damage="",
        seconds=0.0, notes=[],
    )  # fmt: skip
    write_facts(output, facts)


def browse(page: Path) -> str:
    """Open the page in headless Chromium; return what that took."""
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service
    from selenium.webdriver.support.ui import WebDriverWait

    options = webdriver.ChromeOptions()
    for argument in ("--headless=new", "--disable-gpu", "--no-sandbox", "--window-size=1400,900"):
        options.add_argument(argument)
    driver = webdriver.Chrome(options=options, service=Service(shutil.which("chromedriver")))
    try:
        driver.execute_cdp_cmd("Performance.enable", {"timeDomain": "threadTicks"})

        def spent() -> float:
            metrics = driver.execute_cdp_cmd("Performance.getMetrics", {})["metrics"]
            return next(m["value"] for m in metrics if m["name"] == "TaskDuration")

        def cost(script: str, times: int = 1) -> float:
            before = spent()
            for _ in range(times):
                # The next frame but one is drawn after all that the script has set off.
                driver.execute_async_script(
                    f"{script}; const done = arguments[0];"
                    "requestAnimationFrame(() => requestAnimationFrame(() => setTimeout(done)))"
                )
            return (spent() - before) / times

        start = time.perf_counter()
        driver.get(page.resolve().as_uri())
        drawn = "return document.documentElement.dataset.plots"
        WebDriverWait(driver, 300, 0.02).until(lambda d: d.execute_script(drawn))
        wall, cpu = time.perf_counter() - start, spent()
        step = cost("document.getElementById('on').click()", 10)
        zoom = cost("Plotly.relayout('timelines', {'xaxis.range': [100, 300]})")
    finally:
        driver.quit()
    return (
        f"drawn after {wall:.1f} s ({cpu:.1f} s of CPU); CPU of a step {step:.2f} s, "
        f"of a zoom {zoom:.2f} s"
    )


def main() -> None:
    """Make it, and tell what the report takes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("directory", type=Path)
    parser.add_argument("output", type=Path)
    parser.add_argument("--frames", type=int, default=10_000)
    given = parser.parse_args()
    make(given.directory, given.output, given.frames)
    start, cpu = time.perf_counter(), time.process_time()
    page = write_report(given.output)
    print(  # noqa: T201 - a command's output
        f"{page}: {page.stat().st_size / 1e6:.1f} MB, written in "
        f"{time.perf_counter() - start:.1f} s ({time.process_time() - cpu:.1f} s of CPU)"
    )
    if shutil.which("chromedriver"):
        print(browse(page))  # noqa: T201


if __name__ == "__main__":
    main()
