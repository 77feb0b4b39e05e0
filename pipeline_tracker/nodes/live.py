"""All four nodes in one process."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from pipeline_tracker.nodes.local_recognizer import LocalRecognizer
from pipeline_tracker.nodes.pipe_tracker import PipeTracker
from pipeline_tracker.nodes.process import Stop
from pipeline_tracker.nodes.relative_state_publisher import RelativeStatePublisher
from pipeline_tracker.nodes.runtime import run_nodes
from pipeline_tracker.nodes.stereo_vectorizer import StereoVectorizer

NODES = (StereoVectorizer, LocalRecognizer, PipeTracker, RelativeStatePublisher)


def run_all(
    args: Sequence[str],
    parameters: Mapping[str, Any],
    stop: Stop,
    after: Callable[[], int] | None = None,
) -> int:
    """Run the four nodes in this process; see ``run_nodes``."""
    return run_nodes(NODES, args, parameters, stop, after)
