"""A replay as a film: each frame's images with what was found in them."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import TextIO

from pipeline_tracker.bags.reader import BagReader
from pipeline_tracker.errors import BagError, PipelineTrackerError
from pipeline_tracker.geometry.pose_buffer import SECOND_NS, PoseBuffer
from pipeline_tracker.pipeline import FrameResult
from pipeline_tracker.replay.input import Frame, ReplayInput
from pipeline_tracker.replay.progress import ReplayProgress
from pipeline_tracker.replay.results import StoredResults, check_replay, replayed_bag
from pipeline_tracker.report.overlay import draw_overlay
from pipeline_tracker.report.reasons import count
from pipeline_tracker.report.video import open_film
from pipeline_tracker.settings_io import load_settings


@dataclass(frozen=True)
class Cut:
    """Which frames come into a film, and how fast it is.

    Attributes:
        every: one of so many frames.
        start, end: s after the first left image; None from the first, to the last.
        rate: pictures per second of the film.
    """

    every: int = 1
    start: float | None = None
    end: float | None = None
    rate: float = 10.0

    def check(self) -> None:
        """Check the values.

        Raises:
            PipelineTrackerError: one is out of its range.
        """
        if not self.every >= 1:
            raise PipelineTrackerError(f"--every {self.every}: expected at least 1")
        if not 0.1 <= self.rate <= 240.0:
            raise PipelineTrackerError(f"--rate {self.rate:g}: expected 0.1 to 240 (pictures/s)")
        if self.start is not None and not 0.0 <= self.start < float("inf"):
            raise PipelineTrackerError(f"--from {self.start:g}: expected at least 0 (s)")
        if self.end is not None and not (self.start or 0.0) <= self.end < float("inf"):
            raise PipelineTrackerError(
                f"--to {self.end:g}: expected at least {self.start or 0.0:g} (s), where it begins"
            )


@dataclass(frozen=True)
class FilmOutcome:
    """What came of a film.

    Attributes:
        output: file or directory.
        kind: what was written, in words.
        pictures: number of pictures.
        without: frames that were left out because they have no images, or no result.
    """

    output: Path
    kind: str
    pictures: int
    without: int

    def in_words(self) -> str:
        """Return it for a person."""
        text = f"written to {self.output}: {count(self.pictures, 'picture')}, {self.kind}"
        if self.without:
            frames = count(self.without, "frame")
            text += f"; {frames} without images or result left out"
        return text


def write_film(
    directory: Path,
    output: Path,
    cut: Cut,
    *,
    bag: Path | None = None,
    force: bool = False,
    stream: TextIO | None = None,
) -> FilmOutcome:
    """Draw a replay's results on the images they were found in.

    Args:
        directory: the output of a replay.
        output: a .mp4 file, or a directory for PNG files; created.
        cut: which frames.
        bag: the bag that was replayed; by default the one that the replay names.
        force: whether what is there may be replaced.
        stream: where progress is told; standard output by default.

    Raises:
        PipelineTrackerError: bad input, no frame to show, or nothing can be written.
    """
    cut.check()
    check_replay(directory)
    _check_output(output, force=force)
    settings = load_settings(directory / "settings.yaml")
    bag = bag or replayed_bag(directory)
    with (
        BagReader(bag) as images,
        BagReader(directory / "result") as result,
        _writing(output),
    ):
        source = ReplayInput(images, settings)
        with ReplayProgress(source.frame_count, stream or sys.stdout) as progress:
            pictures = _Pictures(source, StoredResults(result), cut, progress)
            chosen = pictures.chosen()
            first = next(chosen, None)
            if first is None:
                raise BagError(
                    f"{bag}: none of its frames that were asked for has a result in {directory}; "
                    "name the replayed bag with --bag, or others with --from and --to"
                )
            output.parent.mkdir(parents=True, exist_ok=True)
            written = 0
            with open_film(output, cut.rate) as film:
                for frame, found, title in chain([first], chosen):
                    assert frame.left is not None  # noqa: S101 - others are not chosen
                    film.add(draw_overlay(frame.left, frame.right, found, source.mounting, title))
                    written += 1
    return FilmOutcome(output, film.kind, written, pictures.without)


_Chosen = tuple[Frame, FrameResult, str]


class _Pictures:
    """Frames of the bag, each with its result."""

    def __init__(
        self, source: ReplayInput, results: StoredResults, cut: Cut, progress: ReplayProgress
    ) -> None:
        self.without = 0
        self._source = source
        self._results = results
        self._cut = cut
        self._progress = progress

    def chosen(self) -> Iterator[_Chosen]:
        """Yield what is to be drawn."""
        cut, begin, epoch = self._cut, None, 0
        poses = PoseBuffer(self._source.settings.pose.max_gap)
        for number, frame in enumerate(self._source.frames(poses, poses.clear)):
            self._progress.advance()
            if frame.epoch != epoch:
                # Clocks were set back: the results begin again too.
                epoch = frame.epoch
                self._results.rewind()
            begin = frame.stamp_ns if begin is None else begin
            seconds = (frame.stamp_ns - begin) / SECOND_NS
            if cut.end is not None and seconds > cut.end and not epoch:
                return
            early = cut.start is not None and seconds < cut.start
            late = cut.end is not None and seconds > cut.end
            if early or late or number % cut.every:
                continue
            found = None if frame.left is None else self._results.at(frame.stamp_ns)
            if frame.left is None or found is None:
                self.without += 1
                continue
            _check_size(frame, found, self._source)
            yield frame, found, self._title(number, seconds, found)

    def _title(self, number: int, seconds: float, found: FrameResult) -> str:
        title = f"frame {number + 1} of {self._source.frame_count}  {seconds:.1f} s"
        chainage = found.relative_state.chainage
        return f"{title}  chainage {chainage:.2f} m" if chainage else title


def _check_size(frame: Frame, found: FrameResult, source: ReplayInput) -> None:
    if frame.rig is not None and frame.rig != found.vectorized.rig:
        raise BagError(
            f"{source.topics.left_image}: the cameras are not those of the replay's results; name "
            "the replayed bag with --bag"
        )


def _check_output(output: Path, *, force: bool) -> None:
    film = output.suffix.lower() == ".mp4"
    if film and output.is_dir():
        raise BagError(f"{output}: is a directory, expected a file; name another with --output")
    if not film and output.is_file():
        raise BagError(
            f"{output}: expected a name that ends with .mp4 (a film), or a directory (PNG files)"
        )
    full = output.is_file() or (output.is_dir() and any(output.iterdir()))
    if full and not force:
        raise BagError(f"{output}: is there already; name another, or replace it with --force")
    if output.is_dir():
        for old in output.glob("[0-9]*.png"):
            old.unlink()


@contextmanager
def _writing(output: Path) -> Iterator[None]:
    """Turn a full disk, or one that cannot be written to, into one line."""
    try:
        yield
    except PipelineTrackerError:
        raise
    except OSError as error:
        raise BagError(
            f"{output}: cannot be written ({error.strerror or error}); name another place with "
            "--output"
        ) from None
