"""What a frame costs in a replay, and in a resumed one that takes over what was computed.

``python test/soak/resume_cost.py [BAG]`` prints both, the least of three rounds.
"""

from __future__ import annotations

import io
import sys
import tempfile
from pathlib import Path

from pipeline_tracker.replay import replay
from pipeline_tracker.replay.record import RECORD
from pipeline_tracker.settings_io import settings_from_values

DEMO = Path(__file__).resolve().parents[2] / "bags" / "demo"
ROUNDS = 3


def main() -> int:
    bag = Path(sys.argv[1]) if len(sys.argv) > 1 else DEMO
    settings = settings_from_values({"pipe.diameter": 0.6})
    new: list[float] = []
    again: list[float] = []
    with tempfile.TemporaryDirectory() as name:
        output = Path(name) / "out"
        for _ in range(ROUNDS):
            whole = replay(bag, settings, output, force=True, stream=io.StringIO()).summary
            new.append(whole.seconds / whole.frames)
            # As if it had been killed when all but its last second was done.
            record = output / RECORD
            record.write_text(record.read_text().replace("finished: true", "finished: false"))
            done = replay(bag, settings, output, resume=True, stream=io.StringIO()).summary
            rest = done.frames - done.taken_over
            again.append((done.seconds - rest * new[-1]) / done.taken_over)
    sys.stdout.write(
        f"{bag.name}: a frame costs {1e3 * min(new):.0f} ms, taken over {1e3 * min(again):.0f} ms "
        f"({min(new) / min(again):.1f} times as fast)\n"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
