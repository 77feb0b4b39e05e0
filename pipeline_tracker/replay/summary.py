"""What came out of a replay, in words."""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median

import numpy as np

from pipeline_tracker.geometry.pose_buffer import SECOND_NS
from pipeline_tracker.replay.input import InputCounts
from pipeline_tracker.report.reasons import count, in_words
from pipeline_tracker.settings import Settings

# So many stretches without the pipe, and reasons, are told one by one.
_SHOWN = 5
_MOST_REASONS = 50
# Medians are those of the last frames: memory does not grow with the bag.
_TIMED = 1000


@dataclass
class Stretch:
    """Frames one after another that are not valid, or are lost."""

    first: int
    last: int
    start_ns: int
    end_ns: int
    reasons: Counter[str] = field(default_factory=Counter)


@dataclass
class ReplaySummary:
    """Counts of a replay, filled frame by frame in bounded memory."""

    frames: int = 0
    valid: int = 0
    without_pose: int = 0
    lost: int = 0
    states: Counter[str] = field(default_factory=Counter)
    modes: Counter[str] = field(default_factory=Counter)
    stretches: list[Stretch] = field(default_factory=list)
    further_stretches: int = 0
    distance_along: float = 0.0
    warnings: list[str] = field(default_factory=list)
    least_overlap: float | None = None
    interrupted: bool = False
    taken_over: int = 0
    seconds: float = 0.0
    _times: dict[str, deque[float]] = field(default_factory=dict)
    _open: Stretch | None = None
    _start_ns: int | None = None
    _chainage: tuple[float, float] | None = None

    @property
    def found(self) -> bool:
        """Whether the pipe was found in any frame."""
        return self.valid > 0

    def add(self, row: dict[str, str], *, has_pose: bool) -> None:
        """Take in a row of estimates.csv."""
        stamp = int(row["stamp_ns"])
        if self._start_ns is None:
            self._start_ns = stamp
        self.frames += 1
        valid = row["valid"] == "1"
        if "state" in row:
            self.states[row["state"]] += 1
            self.without_pose += not has_pose
        else:
            self.lost += 1
        if valid:
            self.valid += 1
            self.modes[row.get("mode", "")] += 1
            self._open = None
            if "chainage" in row:
                self._follow(float(row["chainage"]))
            return
        reason = row.get("reason", "") or "no reason given"
        self._miss(stamp, reason)

    def add_watched(self, overlap: float | None, warnings: tuple[str, ...]) -> None:
        """Take in what was watched over: overlap with the frame before (5.3.1), and warnings."""
        self.warnings += warnings
        if overlap is not None:
            least = overlap if self.least_overlap is None else self.least_overlap
            self.least_overlap = min(least, overlap)

    def add_times(self, vectorization_ms: float, rest_ms: float, mode: str) -> None:
        """Take in what a frame took.

        Args:
            vectorization_ms: for one image, ms.
            rest_ms: all other steps, ms.
            mode: "tracking" where a track was followed, else "recognition".
        """
        for step, spent in (("vectorization", vectorization_ms), (mode, rest_ms)):
            self._times.setdefault(step, deque(maxlen=_TIMED)).append(spent)

    def _follow(self, chainage: float) -> None:
        low, high = self._chainage or (chainage, chainage)
        self._chainage = min(low, chainage), max(high, chainage)
        self.distance_along = self._chainage[1] - self._chainage[0]

    def _miss(self, stamp: int, reason: str) -> None:
        if self._open is None:
            self._open = Stretch(self.frames, self.frames, stamp, stamp)
            if len(self.stretches) < _SHOWN:
                self.stretches.append(self._open)
            else:
                self.further_stretches += 1
        self._open.last, self._open.end_ns = self.frames, stamp
        reasons = self._open.reasons
        if reason in reasons or len(reasons) < _MOST_REASONS:
            reasons[reason] += 1

    def in_words(
        self,
        bag: Path,
        output: Path,
        settings: Settings,
        counts: InputCounts,
        pictures: list[Path],
        *,
        has_truth: bool,
    ) -> str:
        """Return the summary for a person: what, where lost and why, where it is, what next."""
        lines = [self._headline(bag)]
        lines += [f"  {line}" for line in self._about_states()]
        lines += [f"  {line}" for line in self._about_times()]
        lines += [f"  {line}" for line in self._about_stretches()]
        lines += [f"  {line}" for line in self.notes(settings, counts)]
        lines.append(f"Written to {output}: estimates.csv (one row for each left image),")
        names = ", ".join(picture.name for picture in pictures)
        lines.append(
            "  report.html (open it in a browser), result/ (for Foxglove or `ros2 bag`), "
            "settings.yaml (this run again)" + (f", {names}" if names else "")
        )
        lines.append(f"Next: {self._next(bag, output, pictures, has_truth=has_truth)}")
        return "\n".join(lines)

    def notes(self, settings: Settings, counts: InputCounts) -> list[str]:
        """Return what else is to be known: warnings, poses, echoes, images that were not used."""
        return [
            *(f"warning: {line}" for line in self.warnings),
            *self._about_poses(settings, counts),
            *_about_echoes(settings, counts),
            *_about_input(counts),
        ]

    def _headline(self, bag: Path) -> str:
        share = 100.0 * self.valid / self.frames if self.frames else 0.0
        rate = self.frames / self.seconds if self.seconds > 0 else 0.0
        # What was taken over went by faster: no speed of anything.
        speed = "" if self.taken_over else f", {rate:.1f} frames/s"
        begun = "interrupted after " if self.interrupted else ""
        return (
            f"{bag.name or bag}: {begun}{count(self.frames, 'frame')}, pipe found in {self.valid} "
            f"({share:.0f} %), {self.seconds:.1f} s{speed}"
        )

    def _about_states(self) -> list[str]:
        parts = [f"{n} {state}" for state, n in sorted(self.states.items())]
        if self.lost:
            parts.append(f"{self.lost} not processed")
        lines = ["states: " + ", ".join(parts)] if parts else []
        if self.taken_over:
            taken = f"{self.taken_over} of the frames were vectorized before"
            lines.insert(0, f"resumed: {taken}, and only tracked again")
        if self.valid:
            lines.append(
                f"found by tracking in {self.modes['tracking']}, by recognition in "
                f"{self.modes['recognition']}"
            )
        if self.distance_along > 0.0:
            along = f"way along the pipe {self.distance_along:.2f} m"
            if self.least_overlap is not None:
                along += f", overlap of images at least {self.least_overlap:.2f}"
            lines.append(along)
        return lines

    def _about_times(self) -> list[str]:
        names = {
            "vectorization": "vectorization of an image",
            "tracking": "tracking step",
            "recognition": "recognition",
        }
        parts = [
            f"{name} {median(self._times[step]):.0f} ms"
            for step, name in names.items()
            if step in self._times
        ]
        return ["time (medians): " + ", ".join(parts)] if parts else []

    def times_in_words(self) -> str:
        """Return what the steps took: median, 95th percentile and the most of the last frames."""
        lines = [
            f"{step}: median {median(spent):.1f} ms, 95 % {np.percentile(list(spent), 95):.1f} ms, "
            f"at most {max(spent):.1f} ms ({len(spent)})"
            for step, spent in self._times.items()
        ]
        return "\n".join(lines) or "no frame was computed"

    def _about_stretches(self) -> list[str]:
        lines = []
        for stretch in self.stretches:
            assert self._start_ns is not None  # noqa: S101 - a stretch has frames
            start = (stretch.start_ns - self._start_ns) / SECOND_NS
            end = (stretch.end_ns - self._start_ns) / SECOND_NS
            where = (
                f"frame {stretch.first} ({start:.1f} s)"
                if stretch.first == stretch.last
                else f"frames {stretch.first} to {stretch.last} ({start:.1f} to {end:.1f} s)"
            )
            why = "; ".join(
                in_words(reason) + (f" ({n})" if len(stretch.reasons) > 1 else "")
                for reason, n in stretch.reasons.most_common(3)
            )
            lines.append(f"not found in {where}: {why}")
        if self.further_stretches:
            lines.append(f"and in {count(self.further_stretches, 'further stretch', 'es')}")
        return lines

    def _about_poses(self, settings: Settings, counts: InputCounts) -> list[str]:
        if settings.recognition.only:
            return ["nothing was tracked: each frame was recognised by itself, as asked"]
        processed = self.frames - self.lost
        if not self.without_pose or not processed:
            return []
        alone = "each frame was recognised by itself"
        if not settings.topics.pose:
            return [f"nothing was tracked, {alone}: the bag has no vehicle poses (vnm/pose)"]
        topic = settings.topics.pose
        if not counts.poses:
            return [f"nothing was tracked, {alone}: no pose of {topic} could be used"]
        if self.without_pose == processed:
            line = (
                f"nothing was tracked, {alone}: no pose of {topic} is near an image in time "
                f"(pose.max_gap={settings.pose.max_gap:g} s)"
            )
        else:
            line = (
                f"{count(self.without_pose, 'frame')} had no pose of {topic} and stood alone: "
                f"the poses leave gaps beyond pose.max_gap={settings.pose.max_gap:g} s, or begin "
                "late or end early"
            )
        return [line]

    def _next(self, bag: Path, output: Path, pictures: list[Path], *, has_truth: bool) -> str:
        if self.interrupted:
            return f"pipeline-tracker replay {bag} --output {output} --resume for the rest of it"
        if not self.found:
            look = f"look at {output / pictures[0].name}; " if pictures else ""
            return (
                f"{look}is there a pipe in the pictures, and is pipe.diameter right? "
                "A lower recognition.min_support finds more, and more that is no pipe"
            )
        if has_truth:
            return f"compare with the truth: pipeline-tracker evaluate {output} --truth {bag}"
        look = f"look at {output / pictures[0].name}: " if pictures else ""
        return (
            f"{look}do the lines lie on the pipe's edges? If not, check pipe.diameter, "
            "the calibration and the camera's mounting"
        )


def _about_echoes(settings: Settings, counts: InputCounts) -> list[str]:
    if settings.mode != "mono":
        return []
    if not counts.pings and not counts.refused_pings:
        why = "the distance is known by the width of the pipe alone"
        return [f"the bag has no echo sounder (altimeter/range): {why}"]
    told = f"echo sounder: {counts.echoes} of {count(counts.pings, 'ping')} with an echo"
    if counts.refused_pings:
        told += f"; {counts.refused_pings} refused (the first: {counts.first_refused_ping})"
    return [told]


def _about_input(counts: InputCounts) -> list[str]:
    lines = []
    if counts.alone:
        why = ", ".join(f"{n} {in_words(reason)}" for reason, n in counts.alone.most_common())
        lines.append(f"{count(sum(counts.alone.values()), 'image')} without a partner: {why}")
    if counts.unused_poses:
        why = ", ".join(f"{n} {reason}" for reason, n in counts.unused_poses.most_common())
        if counts.first_invalid_pose:
            why += f" (the first: {counts.first_invalid_pose})"
        lines.append(f"{count(sum(counts.unused_poses.values()), 'pose')} not used: {why}")
    for topic, n in counts.unreadable.most_common(_SHOWN):
        lines.append(f"{count(n, 'message')} of {topic} could not be read")
    return lines
