"""`run` as a process of a test, and its children."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

NODES = ("stereo_vectorizer", "local_recognizer", "pipe_tracker", "relative_state_publisher")


def command(*arguments: str) -> str:
    return f"from pipeline_tracker.cli import main; main({list(arguments)!r})"


def run_command(scene: Any, *arguments: str) -> str:
    return command("run", *(word for s in scene.settings for word in ("--set", s)), *arguments)


def is_ready(text: str) -> bool:
    return all(re.search(rf"\[{name}\]: ready", text) for name in NODES)


def children_of(pid: int) -> list[int]:
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                status = (entry / "stat").read_text()
            except OSError:
                continue
            if int(status.rpartition(")")[2].split()[1]) == pid:
                found.append(int(entry.name))
    return found


def module_of(pid: int) -> str:
    """Return what a process of ``python -m MODULE`` runs."""
    return Path(f"/proc/{pid}/cmdline").read_text().split("\0")[2]


def _sent(vehicle: Any) -> list[Any]:
    """The publishers of the vehicle."""
    names = ("pose", "info", "image")
    return [p for p in vehicle.talker.node.publishers if any(n in p.topic_name for n in names)]


def known_to_all(vehicle: Any, *, images: bool = False) -> None:
    """Wait until the vehicle knows that nodes and recorder listen to all it sends.

    Args:
        vehicle: a vehicle of the tests.
        images: the recorder takes images too.
    """
    node = vehicle.talker.node

    def heard(publisher: Any) -> bool:
        # A pose by two nodes, all else by one, and all but images by the recorder.
        recorded = images or "image" not in publisher.topic_name
        listeners = (2 if "pose" in publisher.topic_name else 1) + recorded
        return bool(publisher.get_subscription_count() >= listeners)

    vehicle.talker.wait(
        lambda: "recorder" in node.get_node_names() and all(map(heard, _sent(vehicle))),
        "all that the vehicle sends is heard",
        within=60.0,
    )


def known_to_the_recorder(vehicle: Any, process: Any, *, images: bool = False) -> None:
    """Wait until all that the vehicle sends is heard, by the recorder's own account too.

    What a writer knows of a reader, the reader need not know of the writer yet.

    Args:
        vehicle, images: see ``known_to_all``.
        process: of `run`, not a quiet one.
    """
    known_to_all(vehicle, images=images)
    wanted = [p.topic_name for p in _sent(vehicle) if images or "image" not in p.topic_name]
    process.wait_for(
        lambda text: all(f"[recorder]: hears {name}\n" in text for name in wanted),
        "the recorder hears the vehicle",
    )
