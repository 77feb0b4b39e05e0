"""Which topics of a bag are the images, the calibration and the poses."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

from pipeline_tracker.bags.reader import BagTopic
from pipeline_tracker.errors import BagError
from pipeline_tracker.settings import Settings

RAW_IMAGE = "sensor_msgs/msg/Image"
COMPRESSED_IMAGE = "sensor_msgs/msg/CompressedImage"
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
RANGE = "sensor_msgs/msg/Range"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
POSE_TYPES = {
    "pose": "geometry_msgs/msg/PoseStamped",
    "pose_with_covariance": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "odometry": "nav_msgs/msg/Odometry",
}
_IMAGE_TYPES = (RAW_IMAGE, COMPRESSED_IMAGE)

# Names that are never taken: the truth, our own output ("/pipeline/..."), pictures for people.
_NEVER = {"ground_truth", "groundtruth", "truth", "gt", "/pipeline", "debug"}
_NO_IMAGE = {"depth", "disparity", "mask", "label", "labels", "segmentation", "theora", "overlay"}
_NO_POSE = {"goal", "target", "setpoint", "initialpose", "cmd", "command", "desired", "reference"}


@dataclass(frozen=True)
class ReplayTopics:
    """The topics that a replay reads; empty where there is none.

    Attributes:
        left_image, right_image: images; right empty in mono.
        left_info, right_info: their camera infos.
        pose: VNM poses, or empty.
        pose_type: which of the three types ``pose`` has.
        transforms: static transforms, or empty.
        range: echo sounder, or empty; looked for in mono only.
        rectified: whether the images' names say that they are rectified.
    """

    left_image: str
    right_image: str
    left_info: str
    right_info: str
    pose: str
    pose_type: str
    transforms: str
    rectified: bool
    range: str = ""


def find_topics(bag: str, topics: Mapping[str, BagTopic], settings: Settings) -> ReplayTopics:
    """Find the topics by type and name; settings win.

    Args:
        bag: name of the bag, for errors.
        topics: what is in it.
        settings: ``topics.*``, ``mode``, ``pose_type`` and ``camera.rectify``.

    Raises:
        BagError: no images, one camera only, no camera info, or several topics that would do (the
            line lists them and the setting that decides).
    """
    search = _Search(bag, topics, rectify=settings.camera.rectify)
    left, right = search.images(settings)
    given = settings.topics
    left_info = search.info(given.left_info, "left_info", left)
    right_info = search.info(given.right_info, "right_info", right) if right else ""
    pose, pose_type = search.pose(settings)
    return ReplayTopics(
        left_image=left,
        right_image=right,
        left_info=left_info,
        right_info=right_info,
        pose=pose,
        pose_type=pose_type,
        transforms=search.transforms(),
        rectified=bool(given.left_image) or _is_rectified(left),
        range=search.range(settings),
    )


class _Search:
    def __init__(self, bag: str, topics: Mapping[str, BagTopic], *, rectify: bool) -> None:
        self._bag = bag
        self._topics = {name: topic for name, topic in topics.items() if topic.count > 0}
        self._silent = [topic for topic in topics.values() if topic.count <= 0]
        self._rectify = rectify

    def images(self, settings: Settings) -> tuple[str, str]:
        """Return the left and the right image topic; right empty in mono."""
        names = [
            name for name in self._of_type(*_IMAGE_TYPES) if not _words(name) & (_NEVER | _NO_IMAGE)
        ]
        given = settings.topics
        mono = settings.mode == "mono"
        left, right = given.left_image, given.right_image
        if left:
            left = self._given("left_image", left, _IMAGE_TYPES)
        if right and not mono:
            right = self._given("right_image", right, _IMAGE_TYPES)
        if not names and not left:
            raise BagError(f"{self._bag}: no images in the bag, expected {self._expected_images()}")
        if not left:
            left = self._left(names, right, mono=mono)
        if mono:
            return left, ""
        return left, right or self._right(left, names)

    def _left(self, names: list[str], right: str, *, mono: bool) -> str:
        lefts = [n for n in names if "left" in _words(n)]
        if right:
            lefts = [n for n in lefts if _swapped(n, "left", "right") == right] or lefts
        # A camera whose partner is there too goes first.
        elif not mono and any(_swapped(n, "left", "right") in names for n in lefts):
            lefts = [n for n in lefts if _swapped(n, "left", "right") in names]
        best = _best(lefts, self._image_rank)
        if not best:
            best = _best([n for n in names if n != right], self._image_rank)
            if len(best) == 1 and not mono and not right:
                raise self._one_camera(best[0])
        if len(best) != 1:
            raise self._ambiguous("the left image", "left_image", best)
        return best[0]

    def _right(self, left: str, names: list[str]) -> str:
        partner = _swapped(left, "left", "right")
        if partner in names and partner != left:
            return partner
        others = [n for n in names if "right" in _words(n)]
        best = _best(others, self._image_rank)
        if not best:
            rest = [n for n in names if n != left and "left" not in _words(n)]
            if not rest:
                raise self._one_camera(left)
            best = _best(rest, self._image_rank)
        if len(best) != 1:
            raise self._ambiguous("the right image", "right_image", best)
        return best[0]

    def info(self, given: str, key: str, image: str) -> str:
        """Return the camera info that goes with an image topic."""
        if given:
            return self._given(key, given, (CAMERA_INFO,))
        infos = self._of_type(CAMERA_INFO)
        base = image.removesuffix("/compressed")
        names = (f"{base.rsplit('/', 1)[0]}/camera_info", f"{base}/camera_info")
        for name in names:
            if name in infos:
                return name
        for name in names:
            if name in self._topics:
                raise self._of_another_type(key, name, (CAMERA_INFO,))
        side = "right" if key == "right_info" else "left"
        near = [n for n in infos if side in _words(n) and not _words(n) & _NEVER]
        # A single camera needs no side in its name.
        alone = side == "left" and len(infos) == 1 and "right" not in _words(infos[0])
        near = near or (infos if alone else [])
        if len(near) == 1:
            return near[0]
        if not infos:
            raise BagError(
                f"{self._bag}: no camera info (sensor_msgs/CameraInfo) in the bag for {image}; "
                "record it with the images"
            )
        raise self._ambiguous(f"the camera info of {image}", key, near or infos)

    def pose(self, settings: Settings) -> tuple[str, str]:
        """Return the pose topic and its type; empty where the bag has no poses."""
        kinds = {type_name: kind for kind, type_name in POSE_TYPES.items()}
        if settings.topics.pose:
            name = self._given("pose", settings.topics.pose, tuple(kinds))
            return name, kinds[self._topics[name].type_name]
        wanted = tuple(kinds)
        # The default takes whatever type the bag has; another one was asked for.
        if settings.pose_type != "pose":
            wanted = (POSE_TYPES[settings.pose_type],)
        names = [n for n in self._of_type(*wanted) if not _words(n) & (_NEVER | _NO_POSE)]
        best = _best(names, _pose_rank)
        if not best:
            other = next((n for n in self._topics if _pose_rank(n) == 0), "")
            if other and not _words(other) & _NEVER:
                raise self._of_another_type("pose", other, wanted)
            return "", settings.pose_type
        if len(best) > 1:
            raise self._ambiguous("the vehicle's pose", "pose", best)
        return best[0], kinds[self._topics[best[0]].type_name]

    def range(self, settings: Settings) -> str:
        """Return the topic of the echo sounder; empty where the bag has none, and in stereo."""
        if settings.mode != "mono":
            return ""
        if settings.topics.range:
            return self._given("range", settings.topics.range, (RANGE,))
        names = [n for n in self._of_type(RANGE) if not _words(n) & _NEVER]
        best = _best(names, _range_rank)
        if len(best) > 1:
            raise self._ambiguous("the echo sounder", "range", best)
        return best[0] if best else ""

    def transforms(self) -> str:
        """Return the topic of static transforms, or nothing."""
        names = [n for n in self._of_type(TRANSFORMS) if n.rsplit("/", 1)[-1] == "tf_static"]
        return min(names, key=len, default="")

    def _image_rank(self, name: str) -> tuple[int, int]:
        compressed = self._topics[name].type_name == COMPRESSED_IMAGE
        # What is to be rectified comes unrectified.
        wanted = _is_rectified(name) != self._rectify
        return (0 if wanted else 1, 1 if compressed else 0)

    def _of_type(self, *types: str) -> list[str]:
        return [name for name, topic in self._topics.items() if topic.type_name in types]

    def _given(self, key: str, name: str, types: tuple[str, ...]) -> str:
        for candidate in (name, f"/{name}"):
            topic = self._topics.get(candidate)
            if topic is None:
                continue
            if topic.type_name in types:
                return candidate
            raise self._of_another_type(key, candidate, types)
        having = ", ".join(self._of_type(*types)[:8]) or "none"
        raise BagError(
            f"{self._bag}: topics.{key}={name} is not in the bag or has no messages; "
            f"topics of this type: {having}"
        )

    def _of_another_type(self, key: str, name: str, types: tuple[str, ...]) -> BagError:
        return BagError(
            f"{self._bag}: {name} has {self._type(name)}, expected {' or '.join(types)}; record "
            f"it so, or name another topic with --set topics.{key}=..."
        )

    def _type(self, name: str) -> str:
        kind = self._topics[name].type_name
        return f"the type {kind}" if kind else "messages of several types"

    def _one_camera(self, name: str) -> BagError:
        swapped = {_swapped(name, "left", "right"), _swapped(name, "right", "left")} - {name}
        partner = next((n for n in sorted(swapped) if n in self._topics), "")
        why = f", {partner} has {self._type(partner)}" if partner else ""
        return BagError(
            f"{self._bag}: images of one camera only ({name}), expected a left and a right one"
            f"{why}; use the one camera with --mono, or name the other with --set "
            "topics.right_image=..."
        )

    def _ambiguous(self, what: str, key: str, names: Iterable[str]) -> BagError:
        names = sorted(names)
        return BagError(
            f"{self._bag}: it is not clear which topic is {what}: {', '.join(names[:8])}; "
            f"choose one, for example --set topics.{key}={names[0]}"
        )

    def _expected_images(self) -> str:
        silent = [t.name for t in self._silent if t.type_name in _IMAGE_TYPES]
        if silent:
            return f"some; {', '.join(silent[:6])} without messages"
        some = list(self._topics.values())[:6]
        having = ", ".join(f"{t.name} ({t.type_name or 'several types'})" for t in some)
        return f"sensor_msgs/Image or CompressedImage; it has {having or 'no topics'}"


def _words(name: str) -> set[str]:
    parts = [part for part in name.lower().split("/") if part]
    words = {word for part in parts for word in (part, *re.split(r"[_\-.]", part))}
    return words | {f"/{part}" for part in parts}


def _swapped(name: str, one: str, other: str) -> str:
    return re.sub(rf"(?<![a-zA-Z]){one}(?![a-zA-Z])", other, name)


def _is_rectified(name: str) -> bool:
    return bool(_words(name) & {"rect", "rectified"})


def _pose_rank(name: str) -> int:
    words = _words(name)
    if "vnm" in words:
        return 0 if name.endswith("/pose") else 1
    return 2


def _range_rank(name: str) -> int:
    return 0 if "altimeter" in _words(name) else 1


def _best(names: Iterable[str], rank: Callable[[str], object]) -> list[str]:
    ranked = [(rank(name), name) for name in names]
    if not ranked:
        return []
    best = min(ranked, key=lambda item: item[0])[0]  # type: ignore[arg-type,return-value]
    return [name for value, name in ranked if value == best]
