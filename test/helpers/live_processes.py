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


def known_to_the_recorder(vehicle: Any) -> None:
    """Wait until all that the vehicle sends is heard, by the recorder too."""
    node = vehicle.talker.node

    def heard(publisher: Any) -> bool:
        # A pose by two nodes, all else by one.
        listeners = 3 if "pose" in publisher.topic_name else 2
        recorded = "image" not in publisher.topic_name
        return bool(publisher.get_subscription_count() >= listeners - (not recorded))

    own = ("pose", "info", "image")
    vehicle.talker.wait(
        lambda: (
            "recorder" in node.get_node_names()
            and all(heard(p) for p in node.publishers if any(n in p.topic_name for n in own))
        ),
        "all that the vehicle sends is heard",
        within=60.0,
    )
