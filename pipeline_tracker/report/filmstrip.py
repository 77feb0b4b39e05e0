"""frames/: pictures of a share of the frames, small, with contours and axis drawn in."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.pipeline import FrameResult
from pipeline_tracker.report.overlay import Picture, draw_panel
from pipeline_tracker.types import Image

DIRECTORY = "frames"
# A replay is cut into at most so many parts of the same number of frames; each has at most three
# pictures. All together they take at most so many bytes.
_PARTS = 120
_IN_A_PART = 3
_MOST_BYTES = 18_000_000
_MOST_FOR_ONE = 160_000
# Of few frames the pictures may be wide.
_WIDE, _NARROW = 960, 640
_ENOUGH_FOR_WIDE = 100_000
_QUALITIES = (82, 70, 55, 40, 25)


class FilmStrip:
    """Writes pictures of some frames while a replay runs.

    Of each part of the replay: its first frame, the valid frame of the least quality, and the
    first frame of a stretch that is not valid. A picture is on disk as soon as it is chosen, one
    frame is held in memory at most, and what is chosen in one part does not depend on others: a
    replay that breaks off, or goes on later, has the same pictures.
    """

    def __init__(
        self, directory: Path, mounting: Pose, frame_count: int, *, begin: int = 0
    ) -> None:
        """Begin.

        Args:
            directory: where to write ``STAMP_NS.jpg``; created with the first picture.
            mounting: base_link <- left optical frame.
            frame_count: number of frames expected.
            begin: number of frames that were processed before, by a replay that goes on.
        """
        self._directory, self._mounting = directory, mounting
        self._stride = max(1, -(-frame_count // _PARTS))
        most = min(max(1, frame_count), _PARTS * min(self._stride, _IN_A_PART))
        self._room = min(_MOST_FOR_ONE, _MOST_BYTES // most)
        self._left, self._index = most, begin
        self._worst: tuple[float, Image, FrameResult] | None = None
        self._was_valid, self._part_has_loss = True, False

    def take(self, left: Image, result: FrameResult) -> None:
        """Take in a processed frame.

        Args:
            left: (H, W) uint8.
            result: what the pipeline said of it.

        Raises:
            OSError: a picture cannot be written.
        """
        is_first = self._index % self._stride == 0
        self._index += 1
        if is_first:
            self.finish()
            self._part_has_loss = False
        state = result.relative_state
        is_loss = not state.valid and self._was_valid and not self._part_has_loss
        self._was_valid = state.valid
        self._part_has_loss |= is_loss
        if is_first or is_loss:
            self._write(left, result)
        elif state.valid and (self._worst is None or state.quality < self._worst[0]):
            self._worst = state.quality, left, result

    def finish(self) -> None:
        """Write the picture that is still held.

        Raises:
            OSError: it cannot be written.
        """
        if self._worst is not None:
            _, left, result = self._worst
            self._worst = None
            self._write(left, result)

    def _write(self, left: Image, result: FrameResult) -> None:
        # More frames than were counted do not make more pictures.
        if not self._left:
            return
        self._left -= 1
        camera = result.vectorized.rig.left
        picture = draw_panel(left, camera, result.tracked.segment, self._mounting)
        self._directory.mkdir(exist_ok=True)
        path = self._directory / f"{result.tracked.status.stamp_ns}.jpg"
        path.write_bytes(_encoded(picture, self._room))


def pictures(directory: Path) -> dict[int, Path]:
    """Return the pictures of a replay by the stamp of their frame, ns, in order.

    Args:
        directory: output of a replay.
    """
    found = (directory / DIRECTORY).glob("*.jpg")
    stamped = {int(path.stem): path for path in found if path.stem.lstrip("-").isdecimal()}
    return dict(sorted(stamped.items()))


def _encoded(picture: Picture, room: int) -> bytes:
    """Return a picture as a JPEG of at most so many bytes."""
    width = _WIDE if room >= _ENOUGH_FOR_WIDE else _NARROW
    while True:
        small = picture
        if picture.shape[1] > width:
            height = max(1, round(picture.shape[0] * width / picture.shape[1]))
            small = np.asarray(cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA))
        for quality in _QUALITIES:
            _, data = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, quality])
            if len(data) <= room:
                return data.tobytes()
        # Halved and halved again, any picture fits.
        width = min(width, small.shape[1]) // 2
