"""Kill replays at random moments and resume them: the table must come out as without the kills.

``python test/soak/kill_replay.py --kills 20`` prints each kill; exit 1 at the first replay that
comes out otherwise. What a kill leaves is looked at too: estimates.csv must be the beginning of the
whole one, and the result bag must be one that can be salvaged.
"""

from __future__ import annotations

import argparse
import csv
import random
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from pipeline_tracker.bags.reader import BagReader
from pipeline_tracker.bags.salvage import salvage
from pipeline_tracker.bags.typestore import our_typestore

ROOT = Path(__file__).resolve().parents[2]


def command(bag: Path, output: Path, *options: str) -> list[str]:
    program = [sys.executable, "-m", "pipeline_tracker.cli", "replay"]
    return [*program, str(bag), "--output", str(output), "--set", "pipe.diameter=0.6", *options]


def rows(output: Path) -> list[list[str]]:
    """Return the table without the times."""
    with (output / "estimates.csv").open(newline="") as file:
        return [[*row[:-3], *row[-2:]] for row in csv.reader(file)]


def messages(bag: Path) -> list[tuple[str, int, bytes]]:
    """Return the messages of a result bag, but for how long each took."""
    store, found = our_typestore(), []
    with BagReader(bag) as reader:
        for record in reader.records(reader.topics):
            message = record.unpack()
            if hasattr(message, "processing_time"):
                message.processing_time = 0.0
            raw = bytes(store.serialize_cdr(message, record.type_name))
            found.append((record.topic, record.log_ns, raw))
    return found


def until_frames(process: subprocess.Popen[bytes], output: Path, before: int | None) -> None:
    """Wait until a new result bag is there: imports and compiled kernels are behind."""
    while process.poll() is None and bag_number(output) in {None, before}:
        time.sleep(0.01)


def bag_number(output: Path) -> int | None:
    """Return what tells the result bag from another of the same name."""
    try:
        return (output / "result").stat().st_ino
    except FileNotFoundError:
        return None


def whole(bag: Path, output: Path) -> float:
    """Replay without a kill; return how long its frames took, s."""
    process = subprocess.Popen(command(bag, output), stdout=subprocess.DEVNULL)
    until_frames(process, output, None)
    start = time.monotonic()
    assert process.wait() == 0
    return time.monotonic() - start


def kill(bag: Path, output: Path, seconds: float) -> bool:
    """Resume and kill some time after the first frame; return whether it was still running."""
    before = bag_number(output)
    process = subprocess.Popen(command(bag, output, "--resume"), stdout=subprocess.DEVNULL)
    until_frames(process, output, before)
    try:
        code = process.wait(seconds)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
        return True
    assert code == 0, f"exit code {code}"
    return False


def look(output: Path, place: Path, expected: list[list[str]]) -> str:
    """Check what a kill has left; return it in words."""
    if not (output / "estimates.csv").exists():
        return "nothing yet"
    left = rows(output)
    assert left == expected[: len(left)], "estimates.csv is not the beginning of the whole one"
    saved = 0
    for name in ("result_before", "result"):
        bag = output / name
        if bag.exists() and any(file.stat().st_size > 100 for file in bag.glob("*.mcap")):
            topics = salvage(bag, place / name).topics
            saved = max(saved, *(t.saved for t in topics if t.name == "/pipeline/status"))
    return f"{max(0, len(left) - 1)} rows, {saved} frames in the result bag"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--bag", type=Path, default=ROOT / "bags" / "demo")
    given = parser.parse_args()
    rng = random.Random(given.seed)  # noqa: S311 - a test's dice
    with tempfile.TemporaryDirectory() as name:
        place = Path(name)
        seconds = whole(given.bag, place / "whole")
        expected, expected_bag = rows(place / "whole"), messages(place / "whole" / "result")
        killed = number = 0
        while killed < given.kills:
            number += 1
            output = place / f"out_{number}"
            # Most are killed once; some again, and again, until one run comes to its end.
            while killed < given.kills and kill(given.bag, output, rng.uniform(0.0, seconds)):
                killed += 1
                left = look(output, place / f"saved_{killed}", expected)
                sys.stdout.write(f"kill {killed}, replay {number}: {left}\n")
                sys.stdout.flush()
                if rng.random() < 0.5:
                    break
            subprocess.run(
                command(given.bag, output, "--resume"), check=True, stdout=subprocess.DEVNULL
            )
            assert rows(output) == expected, f"replay {number}: another estimates.csv"
            assert messages(output / "result") == expected_bag, f"replay {number}: another bag"
            for picture in (place / "whole").glob("*.png"):
                same = picture.read_bytes() == (output / picture.name).read_bytes()
                assert same, f"replay {number}: another {picture.name}"
        sys.stdout.write(
            f"{killed} kills, {number} replays resumed: all {len(expected) - 1} rows, "
            f"{len(expected_bag)} messages and the pictures as without\n"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
