"""Pictures one after another as a film that browsers play, or as PNG files."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from fractions import Fraction
from importlib import import_module
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray
from typing_extensions import Self

from pipeline_tracker.errors import PipelineTrackerError

Picture = NDArray[np.uint8]


class VideoError(PipelineTrackerError):
    """A film cannot be written."""


class Film(Protocol):
    """Takes pictures of one size; a context manager.

    Attributes:
        kind: what is written, in words.
    """

    kind: str

    def __enter__(self) -> Self:
        """Begin."""

    def __exit__(
        self,
        kind: type[BaseException] | None,
        value: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Finish the files; what was written before an error can be played."""

    def add(self, picture: Picture) -> None:
        """Add a picture, (H, W, 3) uint8, blue green red.

        Raises:
            OSError: it cannot be written.
            VideoError: nothing on this machine can encode it.
        """


def open_film(path: Path, rate: float) -> Film:
    """Return what writes to a path: a film where it ends with .mp4, else a directory of PNG files.

    H.264 where PyAV is installed (extra ``[video]``); else VP9 by OpenCV, which takes longer to
    write.

    Args:
        path: file or directory; not yet there.
        rate: pictures per second.
    """
    if path.suffix.lower() != ".mp4":
        return _PngFiles(path)
    try:
        return _H264(path, rate, import_module("av"))
    except ImportError:
        return _Vp9(path, rate)


class _Closing:
    """What all kinds have in common."""

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        value: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._finish()

    def _finish(self) -> None:
        raise NotImplementedError


class _PngFiles(_Closing):
    kind = "PNG files"

    def __init__(self, directory: Path) -> None:
        self._directory = directory
        self._count = 0
        directory.mkdir(parents=True, exist_ok=True)

    def add(self, picture: Picture) -> None:
        _, data = cv2.imencode(".png", picture)
        (self._directory / f"{self._count:06d}.png").write_bytes(data.tobytes())
        self._count += 1

    def _finish(self) -> None:
        pass


class _H264(_Closing):
    kind = "H.264"

    def __init__(self, path: Path, rate: float, av: Any) -> None:
        self._av = av
        self._size: tuple[int, int] | None = None
        with self._as_os_error():
            # The index at the file's beginning lets a browser play before it has all of it.
            self._container = av.open(str(path), "w", options={"movflags": "+faststart"})
            self._stream = self._container.add_stream(
                "libx264",
                rate=Fraction(rate).limit_denominator(1000),
                options={"crf": "23", "preset": "veryfast"},
            )
        self._stream.pix_fmt = "yuv420p"

    def add(self, picture: Picture) -> None:
        picture = _of_size(picture, self._size)
        if self._size is None:
            self._size = self._stream.width, self._stream.height = picture.shape[1::-1]
        frame = self._av.VideoFrame.from_ndarray(picture, format="bgr24")
        with self._as_os_error():
            self._container.mux(self._stream.encode(frame))

    def _finish(self) -> None:
        with self._as_os_error():
            if self._size is not None:
                self._container.mux(self._stream.encode())
            self._container.close()

    @contextmanager
    def _as_os_error(self) -> Iterator[None]:
        try:
            yield
        except self._av.FFmpegError as error:
            raise OSError(error.errno, error.strerror) from None


class _Vp9(_Closing):
    kind = "VP9"

    def __init__(self, path: Path, rate: float) -> None:
        self._path, self._rate = path, rate
        self._size: tuple[int, int] | None = None
        self._writer: Any = None

    def add(self, picture: Picture) -> None:
        picture = _of_size(picture, self._size)
        if self._size is None:
            self._size = picture.shape[1], picture.shape[0]
            code = cv2.VideoWriter.fourcc(*"vp09")
            self._writer = cv2.VideoWriter(str(self._path), code, self._rate, self._size)
            if not self._writer.isOpened():
                raise VideoError(
                    f"{self._path}: this OpenCV cannot write a film that browsers play; install "
                    "PyAV with pip install '.[video]' in the clone, or name a directory for PNG "
                    "files"
                )
        self._writer.write(picture)

    def _finish(self) -> None:
        if self._writer is not None:
            self._writer.release()


def _of_size(picture: Picture, size: tuple[int, int] | None) -> Picture:
    """Return a picture of even width and height, as the encoders want it, and of a film's size."""
    if size is None:
        height, width = (2 * (n // 2) for n in picture.shape[:2])
        picture = picture[:height, :width]
    elif picture.shape[1::-1] != size:
        small = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
        picture = np.asarray(small, dtype=np.uint8)
    return np.ascontiguousarray(picture)
