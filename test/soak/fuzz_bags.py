"""Damage bags in many ways: only our error type, in bounded time and memory.

``python test/soak/fuzz_bags.py --count 5000`` prints what became of them; exit 1 at the first that
raised anything else, hung, took too much memory or was salvaged to a bag that is not sound.
"""

from __future__ import annotations

import argparse
import random
import shutil
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "helpers"))

from bag_maker import Sea, mcap_of, write_bag
from rosbags.rosbag2 import CompressionMode, StoragePlugin
from soaking import attempt, bounded, memory_mib, say, say_counts

from pipeline_tracker.bags.reader import BagReader
from pipeline_tracker.bags.salvage import salvage
from pipeline_tracker.errors import PipelineTrackerError
from pipeline_tracker.geometry.pose_buffer import PoseBuffer
from pipeline_tracker.replay.bag_info import bag_info
from pipeline_tracker.replay.input import ReplayInput
from pipeline_tracker.settings_io import settings_from_values

SETTINGS = settings_from_values({"pipe.diameter": 0.6})
SECONDS, GROWTH_MIB = 20, 1024


def flips(data: bytearray, rng: random.Random) -> None:
    for _ in range(rng.choice((1, 2, 8, 64))):
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)


def numbers(data: bytearray, rng: random.Random) -> None:
    """Put extreme numbers where lengths and offsets may be."""
    for _ in range(rng.randint(1, 4)):
        place = rng.randrange(len(data) - 8)
        value = rng.choice((0, 1, 2**31 - 1, 2**32 - 1, 2**40, 2**63 - 1, 2**64 - 1))
        data[place : place + 8] = value.to_bytes(8, "little")


def cut(data: bytearray, rng: random.Random) -> None:
    del data[rng.randrange(1, len(data)) :]


def splice(data: bytearray, rng: random.Random) -> None:
    """Copy or take out a piece."""
    start, place = rng.randrange(len(data)), rng.randrange(len(data))
    piece = data[start : start + rng.randint(1, 5000)]
    if rng.random() < 0.5:
        data[place:place] = piece
    else:
        del data[start : start + len(piece)]


def swap(data: bytearray, rng: random.Random) -> None:
    """Let two records change places, as far as they are found from the beginning."""
    ends, place = [], 8
    while place + 9 <= len(data):
        end = place + 9 + int.from_bytes(data[place + 1 : place + 9], "little")
        if end > len(data):
            break
        ends.append((place, end))
        place = end
    if len(ends) < 2:
        flips(data, rng)
        return
    (a, b), (c, d) = sorted(rng.sample(ends, 2))
    data[:] = data[:a] + data[c:d] + data[b:c] + data[a:b] + data[d:]


MUTATIONS: tuple[Callable[[bytearray, random.Random], None], ...] = (
    flips,
    numbers,
    cut,
    splice,
    swap,
)


def sound_bags(place: Path) -> list[Path]:
    """Return bags to damage: plain, compressed, compressed images, and a database."""
    bags = [
        write_bag(place / "plain"),
        write_bag(place / "zstd", compression=CompressionMode.STORAGE),
        write_bag(place / "jpeg", Sea(encoding="jpeg").items()),
        write_bag(place / "database", storage=StoragePlugin.SQLITE3),
    ]
    return [*bags, mcap_of(bags[0])]


def damaged(source: Path, place: Path, rng: random.Random) -> tuple[Path, str]:
    """Write a damaged copy; return it and the name of the damage."""
    mutation = rng.choice(MUTATIONS)
    if source.is_dir():
        copy = place / "damaged"
        shutil.copytree(source, copy)
        (storage,) = (file for file in copy.iterdir() if file.suffix != ".yaml")
        target, metadata = storage, copy / "metadata.yaml"
        # Now and then its metadata.yaml is what is damaged, or is gone.
        if rng.random() < 0.2:
            target = metadata
        elif rng.random() < 0.2:
            metadata.unlink()
    else:
        copy = target = place / "damaged.mcap"
        shutil.copy(source, copy)
    data = bytearray(target.read_bytes())
    mutation(data, rng)
    target.write_bytes(data)
    return copy, mutation.__name__


def read(bag: Path) -> None:
    with BagReader(bag) as reader:
        source = ReplayInput(reader, SETTINGS)
        poses = PoseBuffer(SETTINGS.pose.max_gap)
        for _frame in source.frames(poses, lambda: None):
            pass


def save(bag: Path, output: Path) -> None:
    report = salvage(bag, output)
    with BagReader(output) as reader:
        count = 0
        for record in reader.records(reader.topics):
            record.unpack()
            count += 1
    assert count == sum(topic.saved for topic in report.topics), "not all that was saved is there"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=5000)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    outcomes: Counter[str] = Counter()
    slowest = 0.0
    with tempfile.TemporaryDirectory() as name:
        sources = sound_bags(Path(name))
        for source in sources:
            read(source)
        before = memory_mib()
        for index in range(given.seed, given.seed + given.count):
            place = Path(name) / "work"
            place.mkdir()
            rng = random.Random(index)  # noqa: S311 - a test's dice
            bag, damage = damaged(rng.choice(sources), place, rng)
            start = time.process_time()
            tasks: dict[str, Callable[[], object]] = {
                "replay": lambda bag=bag: read(bag),
                "info": lambda bag=bag: bag_info(bag, SETTINGS, has_diameter=True),
                "salvage": lambda bag=bag, place=place: save(bag, place / "saved"),
            }
            for what, task in tasks.items():
                doing = f"{what}, {damage}"
                with bounded(SECONDS, f"{doing}; --seed {index} --count 1"):
                    outcomes[f"{doing}: {attempt(task, PipelineTrackerError)}"] += 1
            slowest = max(slowest, time.process_time() - start)
            shutil.rmtree(place)
    growth = memory_mib() - before
    say_counts(outcomes)
    say(f"{given.count} bags; slowest {slowest:.2f} s; memory grew by {growth:.0f} MiB")
    return int(growth > GROWTH_MIB)


if __name__ == "__main__":
    sys.exit(main())
