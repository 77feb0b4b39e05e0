"""Mutate settings files: settings or SettingsError, in bounded time and memory.

``python test/soak/fuzz_settings.py --count 20000`` prints what became of them; exit 1 at the first
that raised anything else, hung, took too much memory, or gave settings that are out of their range.
"""

from __future__ import annotations

import argparse
import math
import random
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "helpers"))

from soaking import attempt, bounded, memory_mib, say, say_counts

from pipeline_tracker.errors import SettingsError
from pipeline_tracker.nodes.launcher import node_parameters
from pipeline_tracker.resources import config_path
from pipeline_tracker.settings import Settings
from pipeline_tracker.settings_io import dotted_values, dump_settings, load_settings
from pipeline_tracker.settings_rows import describe_settings

SECONDS, GROWTH_MIB = 10, 256

VALUES = (
    *(".nan", ".inf", "-.inf", "1e999", "-1", "0", "1e-320", "true", "null", "~", "''", "'0.6'"),
    *("[1, 2]", "[1, 2, 3, 4]", "[.nan, 0, 0]", "[[1], 2, 3]", "{a: 1}", "0x7fffffffffffffff"),
    *(
        "9" * 400,
        "1:30:00",
        "2026-11-25",
        "!!python/object/apply:os.system [true]",
        "!!binary aGk=",
    ),
    *("&a [*a, *a]", "*missing", "|", "? x", "é" * 200, "stereo", "mono", "yes", "0.6", "3"),
)
LINES = (
    *("unknown.key: 1", "pipe.diameter: 0.6", "pipe: 3", "pipe: {diameter: 0.6}", "---", "..."),
    *("camera: {translation: [0, 0, 0], rotation_rpy: [0, 0, 0]}", "<<: {a: 1}", "- 1", "\t x: 1"),
    *("qos_overrides./vnm/pose.subscription.depth: 5", "? [a, b]", ": 1", "%YAML 9.9", "@", "`"),
)


def sound() -> str:
    """Return the shipped file with what must be given."""
    text = config_path("default.yaml").read_text(encoding="utf-8")
    given = "    pipe.diameter: 0.6\n    camera.translation: [0.3, 0.1, -0.1]\n"
    head = "  ros__parameters:\n"
    assert head in text
    return text.replace(head, f"{head}{given}    camera.rotation_rpy: [-2.618, 0.0, -1.571]\n")


def value(text: str, rng: random.Random) -> str:
    """Give some settings another value."""
    lines = text.splitlines()
    places = [i for i, line in enumerate(lines) if ":" in line and "#" not in line]
    for place in rng.sample(places, rng.choice((1, 1, 1, 3))):
        lines[place] = f"{lines[place].partition(':')[0]}: {rng.choice(VALUES)}"
    return "\n".join(lines)


def line(text: str, rng: random.Random) -> str:
    """Put a line in, take one out, or give one twice."""
    lines = text.splitlines()
    place = rng.randrange(len(lines))
    choice = rng.randrange(3)
    if choice == 0:
        lines.insert(place, " " * rng.choice((0, 2, 4, 5)) + rng.choice(LINES))
    elif choice == 1:
        del lines[place]
    else:
        lines.insert(rng.randrange(len(lines)), lines[place])
    return "\n".join(lines)


def characters(text: str, rng: random.Random) -> str:
    """Change some characters."""
    out = list(text)
    for _ in range(rng.choice((1, 1, 4, 40))):
        out[rng.randrange(len(out))] = rng.choice(
            "\x00\t\n :#[]{}&*!|>'\"%@`,-?0.eé\ufeff\u2028\ud7ff"
        )
    return "".join(out)


def cut(text: str, rng: random.Random) -> str:
    return text[: rng.randrange(len(text))]


def name(text: str, rng: random.Random) -> str:
    """Misspell a setting."""
    key = rng.choice(list(describe_settings())).key
    letters = list(key)
    letters[rng.randrange(len(letters))] = rng.choice("abcdefgxyz._ ")
    return text.replace(f"    {key}:", f"    {''.join(letters)}:")


def bomb(text: str, rng: random.Random) -> str:
    """Grow by references, by depth or by width."""
    depth = rng.choice((5, 20, 200, 5000))
    rows = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    rows += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, min(depth, 30))]
    groups = ["g0: &g0 {x: 1, y: 2}"]
    groups += [
        f"g{i}: &g{i} {{{', '.join(f'k{j}: *g{i - 1}' for j in range(9))}}}"
        for i in range(1, min(depth, 30))
    ]
    kinds = (
        "\n".join(rows),
        "\n".join(groups),
        "\n".join([*groups, f"/**: {{ros__parameters: {{qos_overrides: *g{len(groups) - 1}}}}}"]),
        "/**: {ros__parameters: &a {pipe.diameter: 0.6, qos_overrides: {x: *a}}}",
        f"pipe.diameter: {'[' * depth}{']' * depth}",
        f"pipe: {'{a: ' * depth}1{'}' * depth}",
        f"{'- ' * depth}1",
        f"{'? ' * depth}1",
        f"[{'? ' * depth}",
        "\n".join(f"{' ' * i}k:" for i in range(min(depth, 1000))),
        "\n".join(f"k{i}: {i}" for i in range(depth)),
        f"frames.odom: {'x' * depth * 100}",
        f"{text}\n{' ' * depth}pipe.diameter: 0.6",
    )
    return rng.choice(kinds)


MUTATIONS: tuple[Callable[[str, random.Random], str], ...] = (
    value,
    line,
    characters,
    cut,
    name,
    bomb,
)


def check(settings: Settings) -> None:
    """Check that settings hold what they promise."""
    values = dotted_values(settings)
    for row in describe_settings():
        found = values[row.key]
        for number in found if isinstance(found, list) else [found]:
            if isinstance(number, float | int) and not isinstance(number, bool):
                assert math.isfinite(number), row.key
                assert row.minimum is None or number >= row.minimum, row.key
                assert row.maximum is None or number <= row.maximum, row.key
                assert row.above is None or number > row.above, row.key


def load(file: Path) -> None:
    """Load a file as `run` does, and what is written down of its settings again."""
    settings = load_settings(file)
    check(settings)
    node_parameters(settings, file)
    file.write_text(dump_settings(settings), encoding="utf-8")
    assert load_settings(file) == settings


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=20000)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    outcomes: Counter[str] = Counter()
    slowest, text = 0.0, sound()
    started = time.monotonic()
    with tempfile.TemporaryDirectory() as directory:
        file = Path(directory) / "settings.yaml"
        file.write_text(text, encoding="utf-8")
        check(load_settings(file))
        before = memory_mib()
        for index in range(given.seed, given.seed + given.count):
            rng = random.Random(index)  # noqa: S311 - a test's dice
            mutation = rng.choice(MUTATIONS)
            raw = mutation(text, rng).encode("utf-8", "surrogatepass")
            if rng.random() < 0.1:
                # Another encoding, or bytes that are none.
                raw = rng.choice((raw[:50] + b"\xff\xfe" + raw[50:], raw.decode().encode("utf-16")))
            file.write_bytes(raw)
            start = time.monotonic()
            with bounded(SECONDS, f"{mutation.__name__}; --seed {index} --count 1"):
                what = attempt(lambda: load(file), SettingsError)
            slowest = max(slowest, time.monotonic() - start)
            outcomes[f"{mutation.__name__}: {what}"] += 1
    growth = memory_mib() - before
    say_counts(outcomes)
    spent = time.monotonic() - started
    say(
        f"{given.count} files in {spent:.0f} s; slowest {slowest:.2f} s; "
        f"memory grew by {growth:.0f} MiB"
    )
    return int(growth > GROWTH_MIB)


if __name__ == "__main__":
    sys.exit(main())
