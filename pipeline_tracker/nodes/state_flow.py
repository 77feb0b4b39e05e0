"""Status, segment and poses of each frame put together; and the watch over their absence."""

from __future__ import annotations

from collections import OrderedDict, deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from statistics import median

from pipeline_tracker.geometry.pose import Pose
from pipeline_tracker.geometry.pose_buffer import SECOND_NS, PoseBuffer
from pipeline_tracker.nodes.clerk import Clerk
from pipeline_tracker.nodes.live_clock import STANDSTILL, LiveClock, Mark
from pipeline_tracker.nodes.timeline import Step, Timeline
from pipeline_tracker.relative_state import RelativeStateEstimator
from pipeline_tracker.settings import Settings
from pipeline_tracker.tracking.tracker import NO_POSE
from pipeline_tracker.types import PipeSegment, RelativeState, State, TrackingStatus

# Statuses and segments held at most.
QUEUE = 20
# The segment is published before its status: it is either there or on its way.
SEGMENT_WITHIN = 1.0


@dataclass(frozen=True)
class FrameState:
    """A frame with all that is known of it.

    Attributes:
        status: what became of it.
        segment: the pipe in base_link; None while searching.
        state: the relative state.
        pose: odom <- base_link at its stamp; None without.
    """

    status: TrackingStatus
    segment: PipeSegment | None
    state: RelativeState
    pose: Pose | None


class StateFlow:
    """Joins status and segment by their stamp and gives one relative state for each status.

    A status waits for its segment (at most ``SEGMENT_WITHIN``) and for its pose (at most
    ``pose.wait``), the next ones behind it. All calls come from one thread.
    """

    def __init__(
        self,
        estimator: RelativeStateEstimator,
        settings: Settings,
        clock: LiveClock,
        publish: Callable[[FrameState], None],
        clerk: Clerk,
        timeline: Timeline | None = None,
    ) -> None:
        """Start without frames.

        Args:
            estimator: the core's estimator.
            settings: ``pose.max_gap`` and ``pose.wait`` are used.
            clock: the node's time.
            publish: called with each frame, in the order of the statuses.
            clerk: keeps the account of the inputs, a status being an item of it.
            timeline: notices time going backward.
        """
        self._estimator = estimator
        self._poses = PoseBuffer(settings.pose.max_gap)
        self._no_poses = PoseBuffer(settings.pose.max_gap)
        self._pose_wait = settings.pose.wait
        self._clock = clock
        self._publish = publish
        self._clerk = clerk
        self._timeline = timeline or Timeline()
        self._statuses: deque[tuple[TrackingStatus, Mark]] = deque()
        self._segments: OrderedDict[int, PipeSegment] = OrderedDict()
        self._newest: int | None = None

    def add_pose(self, stamp_ns: int, pose: Pose) -> None:
        """Take in a pose of base_link in odom."""
        if not self._goes_on("pose", stamp_ns):
            return
        if not self._poses.add(stamp_ns, pose):
            self._clerk.dropped(
                "pose_late_or_repeated", f"stamp {stamp_ns} ns is not after the last one"
            )
        self.poll()

    def add_segment(self, segment: PipeSegment) -> None:
        """Take in a segment."""
        if not self._goes_on("segment", segment.stamp_ns):
            return
        self._segments[segment.stamp_ns] = segment
        if len(self._segments) > QUEUE:
            stamp, _ = self._segments.popitem(last=False)
            self._clerk.dropped("segment_without_status", f"stamp {stamp} ns")
        self.poll()

    def add_status(self, status: TrackingStatus) -> None:
        """Take in a status."""
        if not self._goes_on("status", status.stamp_ns):
            return
        stamp = status.stamp_ns
        if self._newest is not None and stamp <= self._newest:
            self._clerk.dropped(
                "status_late_or_repeated", f"stamp {stamp} ns is not after the last one", 1
            )
            return
        self._newest = stamp
        self._statuses.append((status, self._clock.mark()))
        while len(self._statuses) > QUEUE:
            self._finish()
        self.poll()

    def change(self, settings: Settings) -> None:
        """Go on with another ``pose.wait`` and other settings of the motion."""
        self._pose_wait = settings.pose.wait
        self._estimator.change(settings)

    def set_reference(self) -> bool:
        """Set the chainage to 0 where the vehicle is now.

        Returns:
            Whether that is known; else it is 0 where the pipe is seen next.
        """
        return self._estimator.set_reference()

    def clock_went_back(self, now_ns: int, way_ns: int) -> None:
        """Forget everything, the simulated clock has gone back."""
        if self._timeline.clock_went_back(now_ns, way_ns):
            self.forget("time_went_backward")

    def poll(self) -> None:
        """Go on with what has waited long enough; to be called every few tens of ms."""
        while self._statuses and self._is_complete(*self._statuses[0]):
            self._finish()

    def _goes_on(self, kind: str, stamp_ns: int) -> bool:
        """Whether a stamp is to be used; time going back makes all forget the past."""
        step, reason, details = self._timeline.refusal(kind, stamp_ns)
        if reason:
            self._clerk.dropped(reason, details, int(kind == "status"))
        if step is Step.BACKWARD:
            self.forget("time_went_backward")
        return not reason

    def forget(self, reason: str) -> None:
        """Drop what is held and forget the past."""
        if self._statuses:
            count = len(self._statuses)
            self._clerk.dropped(reason, f"{count} statuses of before", count)
        self._poses.clear()
        self._statuses.clear()
        self._segments.clear()
        self._newest = None
        self._estimator.reset()

    def _is_complete(self, status: TrackingStatus, since: Mark) -> bool:
        waited = self._clock.since(since)
        has_segment = status.state is State.SEARCHING or status.stamp_ns in self._segments
        settled = _has_no_pose(status) or self._poses.settled(status.stamp_ns)
        has_pose = settled or waited >= self._pose_wait
        return (has_segment or waited >= SEGMENT_WITHIN) and has_pose

    def _finish(self) -> None:
        """Give the relative state of the oldest status."""
        status, _ = self._statuses.popleft()
        segment = self._segments.pop(status.stamp_ns, None)
        if segment is None and status.state is not State.SEARCHING:
            self._clerk.dropped("segment_missing", f"stamp {status.stamp_ns} ns")
            status = replace(status, state=State.SEARCHING, support=0.0)
        # A frame that the tracker took without a pose stands alone here too.
        poses = self._no_poses if _has_no_pose(status) else self._poses
        try:
            state = self._estimator.update(status, segment, poses)
            self._publish(FrameState(status, segment, state, poses.at(status.stamp_ns)))
        except Exception as error:  # noqa: BLE001 - no frame may end the node
            self._clerk.dropped("internal_error", f"{type(error).__name__}: {error}")
            self._estimator.reset()
            state = RelativeState(status.stamp_ns, False, 0.0, status.reset_counter)
            self._publish(FrameState(status, None, state, poses.at(status.stamp_ns)))
        self._clerk.answered(status.stamp_ns)


def _has_no_pose(status: TrackingStatus) -> bool:
    return status.reason.startswith(NO_POSE)


class OutputWatch:
    """Tells when a state "not valid" is due because no frame comes any more."""

    def __init__(self, timeout: float, clock: LiveClock, *, simulated: bool = False) -> None:
        """Start to watch.

        Args:
            timeout: longest time without a frame, s; 0: three periods of the images, at least
                0.5 s.
            clock: the node's time.
            simulated: whether that is simulated time.
        """
        self._timeout = timeout
        self._simulated = simulated
        self._clock = clock
        self._stamps: deque[int] = deque(maxlen=6)
        self._since = clock.mark()
        self._silent = False

    @property
    def timeout(self) -> float:
        """The longest time without a frame that is allowed now, s."""
        if self._timeout > 0.0:
            return self._timeout
        periods = [after - before for before, after in pairwise(self._stamps)]
        return max(0.5, 3.0 * median(periods) / SECOND_NS) if periods else 0.5

    def change(self, timeout: float) -> None:
        """Go on with another timeout; it counts from the last frame too."""
        self._timeout = timeout

    def heard(self, stamp_ns: int, age: float = 0.0) -> bool:
        """Take notice of a frame.

        Args:
            stamp_ns: its stamp, ns.
            age: time since then, s, where it is known: it counts for the timeout.

        Returns:
            Whether it is in time: older than the timeout it must not be taken for valid.
        """
        if self._stamps and stamp_ns <= self._stamps[-1]:
            self._stamps.clear()
        self._stamps.append(stamp_ns)
        now = self._clock.mark()
        self._since = Mark(now.now_ns - round(age * SECOND_NS), now.steady - age)
        self._silent = False
        if age <= self.timeout:
            return True
        # What is said of it is that it is not valid: no need to say it again.
        self._since, self._silent = now, True
        return False

    def restart(self) -> None:
        """Count from now on, the clock has gone back."""
        self._stamps.clear()
        self._since = self._clock.mark()

    def due(self, step: float) -> int | None:
        """Return the stamp (ns) for a state "not valid" that is due now, else None.

        Args:
            step: time between two calls, s; the first state comes rather before the timeout than
                after it. Then one comes each second.
        """
        wanted = 1.0 if self._silent else self.timeout - step
        # A clock that stops must not make a short timeout longer.
        if self._clock.since(self._since, min(STANDSTILL, max(wanted, 0.0))) < wanted:
            return None
        self._since = self._clock.mark()
        self._silent = True
        now = self._clock.now_ns()
        # A simulated clock may show the very stamp of a frame that is still under way.
        return now + 1 if self._simulated else now
