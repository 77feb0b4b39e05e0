"""Node: image pairs to straight segments and matched points."""

from __future__ import annotations

import sys
import threading
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from pipeline_tracker.messages import stamp_ns, vectorized_message
from pipeline_tracker.nodes import qos
from pipeline_tracker.nodes.base import PipelineNode
from pipeline_tracker.nodes.debug_pictures import DebugPictures
from pipeline_tracker.nodes.process import prepare_transport
from pipeline_tracker.nodes.runtime import run_nodes
from pipeline_tracker.nodes.timeline import StampJudge, Step
from pipeline_tracker.nodes.worker import END_WITHIN, Worker
from pipeline_tracker.pipeline import Stage
from pipeline_tracker.rectification import StereoImages
from pipeline_tracker.sync import Matched, StereoSynchroniser
from pipeline_tracker.validation.fields import check_stamp
from pipeline_tracker.vectorization.vectorizer import Vectorizer

# Pairs that wait while one is computed; as many as the depth of the image topics.
QUEUE = qos.SENSOR.depth


@dataclass(frozen=True)
class Pair:
    """Messages that belong together; ``right`` is None in mono.

    ``epoch`` counts how often time had gone back when the pair came.
    """

    stamp_ns: int
    left: Any
    right: Any
    epoch: int

    @property
    def images(self) -> int:
        """How many images it has."""
        return 1 if self.right is None else 2


@dataclass(frozen=True)
class Infos:
    """The newest camera infos; ``right`` is None in mono or as long as none has come."""

    left: Any = None
    right: Any = None


class StereoVectorizer(PipelineNode):
    """Pairs the two cameras' images and vectorizes each pair, without memory."""

    NAME = "stereo_vectorizer"
    STAGE = Stage.VECTORIZATION
    ITEMS = "images"

    def open_outputs(self) -> None:
        """Open the topics of vectorized pairs and of pictures."""
        self._epoch = 0
        self._lock = threading.Lock()
        self._vectorized_out = self.speak(
            "pipeline_tracker_msgs/msg/VectorizedStereo", "pipeline/vectorized"
        )
        self._pictures = DebugPictures(self)

    def start(self) -> None:
        """Open the topics of images and camera infos."""
        settings = self.settings
        self._stereo = settings.mode == "stereo"
        sync = settings.sync
        self._sync: StereoSynchroniser[Any] = StereoSynchroniser(
            sync.tolerance, sync.max_wait, sync.queue
        )
        self._judge = StampJudge(self.live_clock, settings.image.max_age)
        self._timeline = self.timeline(self._judge)
        self._vectorizer = Vectorizer(settings)
        self._infos = Infos()
        self._images: tuple[Infos, StereoImages] | None = None
        self._without_info: deque[Pair] = deque()
        self._worker = Worker(self._vectorize, QUEUE, self._on_overrun, self.NAME)
        self.scope.add(self._worker.close, END_WITHIN)
        self._pictures.start()
        for side in ("left", "right") if self._stereo else ("left",):
            self._listen_to(side)
        self.ready()

    def stop(self) -> None:
        """Forget what is under way, and all memory that it takes."""
        self._forget("deactivated")
        self._infos = Infos()
        self._images = None
        # A new one, without the working memory of the old.
        self._vectorizer = Vectorizer(self.settings)

    def change(self) -> None:
        """Go on with another ``image.max_age``."""
        self._judge.max_age = self.settings.image.max_age

    def on_clock_went_back(self, now_ns: int, way_ns: int) -> None:
        """Forget what is under way."""
        if self._timeline.clock_went_back(now_ns, way_ns):
            self._forget("time_went_backward")

    def _listen_to(self, side: str) -> None:
        name = "image_raw" if self.settings.camera.rectify else "image_rect"
        topic, kind = f"stereo/{side}/{name}", "Image"
        if self.settings.image_transport == "compressed":
            topic, kind = f"{topic}/compressed", "CompressedImage"

        def read(message: Any) -> tuple[int, Any]:
            check_stamp(message.header)
            return stamp_ns(message.header), message

        def on_image(given: tuple[int, Any]) -> None:
            self._on_image(side, *given)

        def on_info(message: Any) -> None:
            self._on_info(side, message)

        self.listen("sensor_msgs/msg/CameraInfo", f"stereo/{side}/camera_info", on_info, qos.SENSOR)
        self.listen(f"sensor_msgs/msg/{kind}", topic, on_image, qos.SENSOR, read, counted=True)

    def _on_info(self, side: str, message: Any) -> None:
        infos = self._infos
        if side == "left":
            self._infos = Infos(message, infos.right)
        else:
            self._infos = Infos(infos.left, message)
        while self._without_info and self._is_calibrated():
            self._compute(self._without_info.popleft())

    def _on_image(self, side: str, stamp: int, message: Any) -> None:
        step, reason, details = self._timeline.refusal(f"{side}_image", stamp)
        if reason:
            self.dropped(reason, details, 1)
            return
        if step is Step.BACKWARD:
            self._forget("time_went_backward")
        if not self._stereo:
            self._take(Pair(stamp, message, None, self._epoch))
            return
        add = self._sync.add_left if side == "left" else self._sync.add_right
        for matched in add(stamp, message):
            self._settle(matched)

    def _settle(self, matched: Matched[Any]) -> None:
        left, right = matched.left, matched.right
        if left is not None and right is not None:
            self._take(Pair(left.stamp_ns, left.item, right.item, self._epoch))
            return
        alone = left or right
        side = "left" if left is not None else "right"
        stamp = alone.stamp_ns if alone is not None else 0
        self.dropped(matched.reason, f"{side} image of {stamp} ns", 1)

    def _take(self, pair: Pair) -> None:
        if self._is_calibrated():
            self._compute(pair)
            return
        # The first camera info may come after the first pair.
        self._without_info.append(pair)
        if len(self._without_info) > QUEUE:
            lost = self._without_info.popleft()
            self.dropped(
                "no_camera_info",
                f"pair of {lost.stamp_ns} ns: no camera info has come",
                lost.images,
            )

    def _is_calibrated(self) -> bool:
        infos = self._infos
        return infos.left is not None and (infos.right is not None or not self._stereo)

    def _compute(self, pair: Pair) -> None:
        self._worker.put((pair, self._infos))

    def _on_overrun(self, item: tuple[Pair, Infos]) -> None:
        pair = item[0]
        self.dropped(
            "overrun", f"pair of {pair.stamp_ns} ns: images come faster than computed", pair.images
        )

    def _forget(self, reason: str) -> None:
        """Drop what is held and under way."""
        pairs = [*self._without_info, *(pair for pair, _ in self._worker.clear())]
        held = sum(pair.images for pair in pairs)
        for matched in self._sync.reset():
            held += (matched.left is not None) + (matched.right is not None)
        self._without_info.clear()
        with self._lock:
            self._epoch += 1
        self._pictures.forget()
        if held:
            self.dropped(reason, f"{held} images of before", held)

    def _vectorize(self, item: tuple[Pair, Infos]) -> None:
        """Decode, vectorize and publish a pair; in the computing thread."""
        pair, infos = item
        try:
            images = self._calibrated(infos)
            left = images.read(pair.left, "left")
            right = images.read(pair.right, "right") if self._stereo else None
            frame = self._vectorizer.process(pair.stamp_ns, images.rig, left, right, images.unseen)
            frame_id = self.settings.frames.left_optical or str(pair.left.header.frame_id)
            given = (infos.left, infos.right) if images.infos_hold else (None, None)
            message = vectorized_message(self.messages, frame, frame_id, *given)
            with self._lock:
                wanted = pair.epoch == self._epoch
                if wanted:
                    # Before it is known to others: an answer may be quick.
                    self._pictures.take(frame_id, left, right, frame)
                    self._vectorized_out.publish(message)
        except Exception as error:  # noqa: BLE001 - one pair is lost, not the node
            self.refused("pair", error, pair.images)
            return
        if wanted:
            self.answered(pair.stamp_ns, pair.images)
        else:
            self.dropped("result_of_before", f"pair of {pair.stamp_ns} ns", pair.images)

    def _calibrated(self, infos: Infos) -> StereoImages:
        if self._images is None or self._images[0] is not infos:
            right = infos.right if self._stereo else None
            self._images = infos, StereoImages(self.settings, infos.left, right)
        return self._images[1]


def main(args: Sequence[str] | None = None) -> int:
    """Run the node; return the exit code."""
    prepare_transport(local=False)
    return run_nodes([StereoVectorizer], args)


if __name__ == "__main__":
    sys.exit(main())
