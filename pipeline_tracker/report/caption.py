"""The numbers of a frame in a few lines, for pictures."""

from __future__ import annotations

import math

import numpy as np

from pipeline_tracker.types import PipeSegment, RelativeState, State, TrackingStatus


def caption(status: TrackingStatus, segment: PipeSegment | None, state: RelativeState) -> list[str]:
    """Return state and numbers of a frame in plain ASCII, a line each.

    Args:
        status, segment, state: what the tracker and the estimator said.
    """
    words = status.state.name.lower() + ("" if state.valid else ", not valid")
    lines = [words + (f": {status.reason}" if status.reason else "")]
    if status.state == State.SEARCHING or segment is None:
        return lines
    heading = math.degrees(state.heading_misalignment)
    pitch = math.degrees(state.pitch_misalignment)
    side = state.side.name.lower().replace("_", " ")
    lines += [
        f"distance {state.min_distance:.3f} m  support {status.support:.2f}",
        f"heading {heading:+.1f} deg  pitch {pitch:+.1f} deg",
        f"lateral {state.lateral_offset:+.3f} m  side: {side}",
    ]
    return lines + _sigmas(segment)


def _sigmas(segment: PipeSegment) -> list[str]:
    variances = np.diag(segment.covariance)
    if not (np.isfinite(variances).all() and (variances > 0.0).all()):
        return []
    left, up, heading, _ = np.sqrt(variances)
    offsets = f"left {1e3 * left:.1f} mm  up {1e3 * up:.1f} mm"
    return [f"sigma: {offsets}  heading {math.degrees(heading):.2f} deg"]
