"""The replay itself: bag in, directory of results out."""

from __future__ import annotations

import csv
import errno
import shutil
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol, TextIO

from pipeline_tracker import __version__
from pipeline_tracker.bags.reader import BagReader
from pipeline_tracker.echoes import EchoBuffer
from pipeline_tracker.errors import BagError, PipelineTrackerError
from pipeline_tracker.export.command import FILES
from pipeline_tracker.files import write_whole
from pipeline_tracker.geometry.camera import StereoRig
from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.geometry.pose_buffer import PoseBuffer
from pipeline_tracker.geometry.unseen import SEEN_WHOLE, UnseenPair
from pipeline_tracker.jit import kernels_are_kept
from pipeline_tracker.pipeline import COMPILING, FrameResult, Pipeline, warm_up
from pipeline_tracker.replay.estimates import EstimatesFile, estimate_row, lost_row
from pipeline_tracker.replay.input import BACKWARD, Frame, ReplayInput
from pipeline_tracker.replay.progress import ReplayProgress
from pipeline_tracker.replay.record import RECORD, write_record
from pipeline_tracker.replay.result_bag import ResultBag
from pipeline_tracker.replay.resumption import BEFORE, GONE, Resumption
from pipeline_tracker.replay.summary import ReplaySummary
from pipeline_tracker.report.bed import bed_beside
from pipeline_tracker.report.facts import RunFacts, write_facts
from pipeline_tracker.report.filmstrip import DIRECTORY, FilmStrip, pictures
from pipeline_tracker.report.overlay import OverlayKeeper
from pipeline_tracker.report.write import write_report
from pipeline_tracker.settings import Settings
from pipeline_tracker.settings_io import dump_settings
from pipeline_tracker.types import Image, PipeSegment, VectorizedStereo

OUR_FILES = (
    # First: without it nothing is taken for a replay that could be resumed.
    RECORD,
    "estimates.csv",
    "settings.yaml",
    "result",
    BEFORE,
    GONE,
    "overlay_best.png",
    "overlay_middle.png",
    "report.html",
    "run.json",
    # What `evaluate` says of an earlier replay is not true of this one.
    "evaluation.json",
    "evaluation_errors.png",
    "evaluation_coverage.png",
    "evaluation_states.png",
    # Nor what was exported of it.
    *FILES,
)


# The errors of a disk without room: none left, the quota's end, the largest file.
_FULL = {errno.ENOSPC, getattr(errno, "EDQUOT", errno.ENOSPC), errno.EFBIG}
# What is computed is put on the disk so often, s.
_SAVE_EVERY = 0.5


class PipelineLike(Protocol):
    """What a replay needs of the pipeline."""

    poses: PoseBuffer
    echoes: EchoBuffer

    def process(
        self,
        stamp_ns: int,
        rig: StereoRig,
        left: Image,
        right: Image | None,
        unseen: UnseenPair = SEEN_WHOLE,
    ) -> FrameResult:
        """Process one frame."""

    def follow(self, vectorized: VectorizedStereo, known: PipeSegment | None = None) -> FrameResult:
        """Process one frame that is vectorized already."""

    def reset(self, reason: str) -> None:
        """Forget everything."""


PipelineMaker = Callable[[Settings, Pose, bool], PipelineLike]


@dataclass(frozen=True)
class ReplayOutcome:
    """What came of a replay.

    Attributes:
        output: the directory that was written.
        summary: counts.
        text: the summary in words.
    """

    output: Path
    summary: ReplaySummary
    text: str


def default_output(bag: Path) -> Path:
    """Return the directory that a replay writes when none is given: ``NAME_tracked`` here."""
    name = bag.resolve().name
    return Path(f"{Path(name).stem if bag.is_file() else name}_tracked")


def replay(
    bag: Path,
    settings: Settings,
    output: Path,
    *,
    force: bool = False,
    resume: bool = False,
    stream: TextIO | None = None,
    make_pipeline: PipelineMaker | None = None,
) -> ReplayOutcome:
    """Run a bag through the pipeline, as fast as it goes, dropping no frame.

    Args:
        bag: directory or file.
        settings: all settings.
        output: directory to write; created.
        force: whether what an earlier replay left there may be replaced.
        resume: go on with the replay that was broken off there; with the same bag, settings and
            version it gives what an unbroken one would have given.
        stream: where progress is told; standard output by default.
        make_pipeline: called with settings, mounting and recognition-only; the pipeline by default.

    Raises:
        PipelineTrackerError: bad input; where the bag turns out damaged on the way, what was
            computed before is kept.
        KeyboardInterrupt: interrupted a second time, or before the first frame. The first time the
            frame at hand is finished, all files are closed, and the summary says so.
    """
    check_output(output, bag, force=force or resume)
    with BagReader(bag) as reader:
        with _writing(output):
            past = Resumption.find(output, bag) if resume else None
        source = ReplayInput(reader, settings)
        if past is not None:
            past.check_settings(source.settings)
            if past.finished:
                return _nothing_left(output)
        stream = stream or sys.stdout
        if make_pipeline is None:
            if not kernels_are_kept():
                stream.write(f"{COMPILING}\n")
                stream.flush()
            warm_up()
        run = _Run(source, bag, output, make_pipeline or Pipeline, past)
        with _writing(output):
            if past is None:
                _prepare(output, bag, source.settings)
        try:
            run.go(stream)
        except BagError as error:
            # A disk that is full has no room for it either; the first error is the one to tell.
            with suppress(PipelineTrackerError):
                run.report(bag, damage=str(error))
            raise
        run.report(bag)
        if not run.summary.interrupted:
            with _writing(output):
                write_record(output, bag, finished=True)
        has_truth = "/ground_truth/pose" in reader.topics
    return ReplayOutcome(output, run.summary, run.in_words(bag, has_truth=has_truth))


def check_output(output: Path, bag: Path, *, force: bool) -> None:
    """Check that a directory can be written to without a loss.

    Raises:
        BagError: it is a file, is the bag itself, or is not empty (without ``force``).
    """
    if output.exists() and not output.is_dir():
        raise BagError(f"{output}: is a file, expected a directory for --output; name another")
    if output.is_dir() and output.resolve() == bag.resolve():
        raise BagError(f"{output}: is the bag itself; name another directory with --output")
    try:
        first = next(iter(sorted(output.iterdir())), None) if output.is_dir() else None
    except OSError as error:
        raise BagError(f"{output}: cannot be read ({error.strerror}); name another") from None
    if first is not None and not force:
        raise BagError(
            f"{output}: the output directory is not empty (it has {first.name}); name another with "
            "--output, or replace an earlier replay in it with --force"
        )


class _Run:
    def __init__(
        self,
        source: ReplayInput,
        bag: Path,
        output: Path,
        make: PipelineMaker,
        past: Resumption | None,
    ) -> None:
        self.summary = ReplaySummary()
        self._source = source
        self._bag = bag
        self._output = output
        settings = source.settings
        self._settings = settings
        self._pipeline = make(settings, source.mounting, settings.recognition.only)
        self._overlay = OverlayKeeper(source.mounting, source.frame_count)
        self._strip = FilmStrip(output / DIRECTORY, source.mounting, source.frame_count)
        self._pictures: list[Path] = []
        self._past = past
        self._saved = time.monotonic()

    def go(self, stream: TextIO) -> None:
        """Process all frames and close all files, whatever happens."""
        source, poses = self._source, self._pipeline.poses
        start = time.monotonic()
        with _writing(self._output):
            rows = None if self._past is None else self._past.begin()
        with (
            _writing(self._output),
            EstimatesFile(self._output / "estimates.csv", rows) as table,
            ResultBag(
                self._output / "result",
                self._settings,
                source.left_frame,
                source.mounting,
                self._bag,
            ) as result,
            ReplayProgress(source.frame_count, stream) as progress,
            _interrupt_between_frames() as interrupted,
        ):
            try:
                frames = source.frames(
                    poses, lambda: self._pipeline.reset(BACKWARD), self._pipeline.echoes
                )
                for frame in _then(frames, lambda: source.rest(poses)):
                    self._take(frame, table, result)
                    self._save(table, result)
                    progress.advance()
                    if interrupted():
                        self.summary.interrupted = True
                        break
                else:
                    table.finish()
            except BagError as error:
                raise BagError(
                    f"{error}; the {self.summary.frames} frames before are in {self._output}"
                ) from None
            finally:
                self.summary.seconds = time.monotonic() - start
                self._strip.finish()
                self._pictures = self._overlay.write(self._output)

    def _save(self, table: EstimatesFile, result: ResultBag) -> None:
        """Let a kill cost little: put all on the disk, now and then."""
        caught_up = self._past is not None and self.summary.frames >= self._past.frames
        if not caught_up and time.monotonic() - self._saved < _SAVE_EVERY:
            return
        table.save()
        result.save()
        self._saved = time.monotonic()
        if caught_up and self._past is not None:
            self._past.caught_up()
            self._past = None

    def report(self, bag: Path, *, damage: str = "") -> None:
        """Say how it went, and write the report on all that is there."""
        facts = RunFacts(
            version=__version__,
            bag=bag.resolve().name,
            frames_expected=self._source.frame_count,
            interrupted=self.summary.interrupted,
            damage=damage,
            seconds=self.summary.seconds,
            notes=self.summary.notes(self._settings, self._source.counts),
        )
        with _writing(self._output):
            write_facts(self._output, facts)
            write_report(self._output)

    def in_words(self, bag: Path, *, has_truth: bool) -> str:
        return self.summary.in_words(
            bag,
            self._output,
            self._settings,
            self._source.counts,
            self._pictures,
            has_truth=has_truth,
        )

    def _take(self, frame: Frame, table: EstimatesFile, result: ResultBag) -> None:
        if frame.rig is None or frame.left is None:
            row = lost_row(frame.stamp_ns, frame.reason)
            table.write(frame.epoch, row)
            self.summary.add(row, has_pose=False)
            return
        pose = self._pipeline.poses.at(frame.stamp_ns)
        known = None if self._past is None else self._past.answer(frame.stamp_ns)
        start = time.perf_counter()
        if known is None:
            done = self._pipeline.process(
                frame.stamp_ns, frame.rig, frame.left, frame.right, frame.unseen
            )
        else:
            self.summary.taken_over += 1
            vectorized = replace(known.vectorized, rig=frame.rig)
            done = self._pipeline.follow(vectorized, known.recognition)
        spent = 1e3 * (time.perf_counter() - start)
        status, segment, state = done.tracked.status, done.tracked.segment, done.relative_state
        bed: tuple[float | None, float | None] = (None, None)
        if state.valid and segment is not None:
            bed = bed_beside(done.vectorized, segment, self._source.mounting, pose)
        row = estimate_row(
            status, segment, state, has_pose=pose is not None, processing_ms=spent, bed=bed
        )
        table.write(frame.epoch, row)
        self.summary.add(row, has_pose=pose is not None)
        self.summary.add_watched(done.tracked.overlap, done.tracked.warnings)
        if known is None:
            vectorization = 1e3 * done.vectorized.processing_time
            self.summary.add_times(
                vectorization / (1 if frame.right is None else 2),
                spent - vectorization,
                "tracking" if done.recognition is None else "recognition",
            )
        result.write(frame, done.vectorized, done.recognition, status, segment, state, pose)
        self._overlay.take(frame.left, frame.right, done)
        self._strip.take(frame.left, done)


def _prepare(output: Path, bag: Path, settings: Settings) -> None:
    output.mkdir(parents=True, exist_ok=True)
    for name in OUR_FILES:
        path = output / name
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)
    write_record(output, bag, finished=False)
    # Somebody's own pictures may be beside those of an earlier replay.
    for path in pictures(output).values():
        path.unlink()
    comment = (
        f"pipeline_tracker {__version__}, replay of {bag.resolve().name}\n"
        "The same again: pipeline-tracker replay BAG --config THIS_FILE"
    )
    # The bag's name may hold bytes that are no text.
    text = dump_settings(settings, comment).encode("utf-8", "replace")
    write_whole(output / "settings.yaml", text)


def _nothing_left(output: Path) -> ReplayOutcome:
    """Return what came of a replay that has ended already."""
    summary = ReplaySummary()
    with (output / "estimates.csv").open(newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            filled = {name: cell for name, cell in row.items() if cell}
            summary.add(filled, has_pose="chainage" in filled)
    return ReplayOutcome(
        output,
        summary,
        f"{output}: the replay in it has ended, there is nothing to resume; pipe found in "
        f"{summary.valid} of {summary.frames} frames",
    )


def _then(frames: Iterator[Frame], rest: Callable[[], Iterator[Frame]]) -> Iterator[Frame]:
    """Yield frames, and where the bag breaks off, those that still waited, before the error."""
    try:
        yield from frames
    except BagError:
        yield from rest()
        raise


@contextmanager
def _writing(output: Path) -> Iterator[None]:
    """Turn a full disk, or one that cannot be written to, into one line."""
    try:
        yield
    except PipelineTrackerError:
        raise
    except OSError as error:
        what = f"{output}: cannot be written ({error.strerror or error})"
        if error.errno in _FULL:
            raise BagError(
                f"{what}; make room there and go on with --resume, or name another directory with "
                "--output"
            ) from None
        raise BagError(f"{what}; name another directory with --output") from None


@contextmanager
def _interrupt_between_frames() -> Iterator[Callable[[], bool]]:
    """Let the frame at hand be finished when Ctrl-C comes; a second one ends at once."""
    if threading.current_thread() is not threading.main_thread():
        yield lambda: False
        return
    asked = False

    def ask(_number: int, _frame: object) -> None:
        nonlocal asked
        if asked:
            raise KeyboardInterrupt
        asked = True

    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        for number in before:
            signal.signal(number, ask)
        yield lambda: asked
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
