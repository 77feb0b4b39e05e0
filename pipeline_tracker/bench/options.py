"""What a bench is asked for, checked before anything is measured."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

from pipeline_tracker.errors import BenchError

Size = tuple[int, int]

# The size of the keys at the top of the JSON, and of the live measurement.
REFERENCE: Size = (1200, 800)
SIZES: tuple[Size, ...] = ((640, 480), REFERENCE, (2448, 2048), (4008, 2672))
_REPEAT = 30
# Above this many pixels rounds are so long that without --repeat there are fewer of them.
_LARGE, _REPEAT_LARGE = 2_000_000, 10
_LEAST_SIDE, _MOST_SIDE = 160, 8192
_MOST_REPEAT = 100_000
_LEAST_FRAMES, _MOST_FRAMES = 20, 10_000_000


@dataclass(frozen=True)
class BenchOptions:
    """What to measure.

    Attributes:
        images: the bag; None: the demo.
        settings: ``key=value`` each.
        sizes: width and height of the images, px; the bag's are resized to each.
        repeat: rounds at each size; None: 30, 10 above 2 million pixels.
        frames: pairs to run while memory is watched; None: not at all.
        live: measure over DDS too.
        plots: directory for growth plots and flame graph; None: not measured.
    """

    images: Path | None = None
    settings: tuple[str, ...] = ()
    sizes: tuple[Size, ...] = field(default=SIZES)
    repeat: int | None = None
    frames: int | None = None
    live: bool = False
    plots: Path | None = None

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            BenchError: one is out of its range.
        """
        for width, height in self.sizes:
            if min(width, height) < _LEAST_SIDE or max(width, height) > _MOST_SIDE:
                raise BenchError(
                    f"--sizes {width}x{height}: expected sides of {_LEAST_SIDE} to {_MOST_SIDE} px"
                )
        if self.repeat is not None and not 1 <= self.repeat <= _MOST_REPEAT:
            raise BenchError(f"--repeat {self.repeat}: expected 1 to {_MOST_REPEAT}")
        if self.frames is not None and not _LEAST_FRAMES <= self.frames <= _MOST_FRAMES:
            raise BenchError(f"--frames {self.frames}: expected {_LEAST_FRAMES} to {_MOST_FRAMES}")

    def rounds(self, size: Size) -> int:
        """Return how often each candidate is measured at a size."""
        if self.repeat is not None:
            return self.repeat
        return _REPEAT_LARGE if size[0] * size[1] > _LARGE else _REPEAT

    @property
    def main_size(self) -> Size:
        """The size at which shares, memory and live are measured: 1200 x 800, else the first."""
        return REFERENCE if REFERENCE in self.sizes else self.sizes[0]


def parse_sizes(text: str) -> tuple[Size, ...]:
    """Read ``--sizes``: WIDTHxHEIGHT, several with commas between them; repeated ones count once.

    Raises:
        BenchError: it is not that.
    """
    found: list[Size] = []
    for word in text.split(","):
        match = re.fullmatch(r"\s*(\d{1,6})\s*[x×]\s*(\d{1,6})\s*", word)
        if match is None:
            raise BenchError(
                f"--sizes {text}: expected WIDTHxHEIGHT, several with commas between them, "
                "such as 640x480,1200x800"
            )
        found.append((int(match[1]), int(match[2])))
    return tuple(dict.fromkeys(found))
