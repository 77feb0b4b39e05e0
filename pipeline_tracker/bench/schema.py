"""What the JSON of a bench holds: the models are its schema, each field with its meaning."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, ConfigDict, Field

SCHEMA_VERSION = 1


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Machine(_Model):
    """What it was measured on."""

    processor: str = Field(description="Name of the processor, as far as the system tells")
    cores: int = Field(description="Cores that this process may use, all together")
    core: int | None = Field(
        description="The one that it was kept to; null where the system knows no such thing"
    )
    load_before: list[float] | None = Field(
        description="Load average over 1, 5 and 15 min before; above 0.5 other programs disturb"
    )
    load_after: list[float] | None = Field(description="The same at the end, this program included")
    versions: dict[str, str] = Field(description="Python and the libraries that compute")


class Timing(_Model):
    """Durations of one candidate; of two images, where it works on images."""

    label: str = Field(description="As in the table")
    rounds: int = Field(description="How often it was run")
    counted: int = Field(
        description="Rounds that count: those in which a recognition found the pipe, a tracking "
        "step tracked it; for all others: all"
    )
    min_ms: float | None = Field(description="Shortest; null where no round counts")
    median_ms: float | None = Field(description="Median")
    p95_ms: float | None = Field(description="95th percentile")
    ratio: float | None = Field(description="Median of the stock chain / median of this one")


class SizeReport(_Model):
    """One size of images."""

    width: int = Field(description="px")
    height: int = Field(description="px")
    pairs: int = Field(description="Different pairs that the rounds went through")
    segments: int = Field(description="Median number of segments of a left image")
    pair_ms: float | None = Field(description="Median of a tracked pair (timings.pair)")
    stock_pair_ms: float | None = Field(
        description="Median of the stock chain on the two images (timings.stock)"
    )
    ratio: float | None = Field(description="stock_pair_ms / pair_ms")
    hough_ratio: float | None = Field(
        description="Median of the pixel Hough transform / that of the modified one"
    )
    matching_ms: float | None = Field(
        description="Median over rounds of vectorize_match less vectorize: the matches of a pair"
    )
    stock_steps_ms: dict[str, float] = Field(
        description="Medians of the stock chain's steps, two images: clahe, canny, skeleton, "
        "contours_polygons"
    )
    timings: dict[str, Timing] = Field(
        description="vectorize, vectorize_match, stock, lsd, edlines, hough_p (two images); "
        "hough_modified, hough_pixel, voting (left image); recognition_1 to recognition_4, "
        "recognition_auto; tracking_vote, tracking_fit; pair_vote, pair, pair_recognition. What "
        "cannot be measured is not there"
    )


class Share(_Model):
    """A function of ours within a tracked pair."""

    path: list[str] = Field(description="Its callers below the pair's, and itself")
    share: float = Field(description="Share of the pair's time in it and what it calls, 0 to 1")


class Shares(_Model):
    """Where the time of a tracked pair goes, by samples of the running program."""

    width: int = Field(description="Of the images, px")
    height: int = Field(description="px")
    samples: int = Field(description="Number of samples")
    pairs: int = Field(description="Pairs processed meanwhile")
    steps: list[Share] = Field(description="Depth first, the largest first; those of 1 % or more")


class GrowthLine(_Model):
    """Time of something against the size of its input."""

    label: str = Field(description="What")
    unit: str = Field(description="Of x: pixels or segments")
    x: list[float] = Field(description="Size of the input")
    ms: list[float] = Field(description="Median time of each")
    exponent: float = Field(
        description="Slope of log time over log size, least squares: 1 is linear, less is better"
    )


class LiveRow(_Model):
    """Nodes under load: images published at a rate, relative states received over DDS."""

    hertz: float = Field(description="Pairs a second")
    processes: int = Field(description="1: all nodes in one; 4: one each")
    one_core: bool = Field(description="Whether the nodes were kept to one core")
    ready_s: float = Field(description="From start to all nodes ready, kernels compiled before")
    published: int = Field(description="Pairs published")
    answered: int = Field(description="Pairs whose relative state came")
    valid: int = Field(description="Of these, valid")
    dropped: int = Field(description="published - answered")
    first_ms: float | None = Field(
        description="Latency of the first pair, which is recognised; null where it was dropped"
    )
    p50_ms: float | None = Field(
        description="Median from image stamp to receipt of the relative state, all pairs"
    )
    p99_ms: float | None = Field(description="99th percentile of the same")
    max_ms: float | None = Field(description="Longest of the same")
    load: float | None = Field(
        description="Load average over 1 min at the end of the row, this load included"
    )
    cpu_percent: float = Field(description="CPU time of the nodes / time; 100 is one core")
    memory_mb: float = Field(
        description="Resident memory of the nodes at most, all processes (what they share counts "
        "in each), 10^6 bytes"
    )


class Live(_Model):
    """Latency over DDS on this machine."""

    width: int = Field(description="Of the images, px")
    height: int = Field(description="px")
    ready_cold_s: float = Field(
        description="From start to ready with nothing compiled, all nodes in one process"
    )
    rows: list[LiveRow] = Field(description="Rates and processes")


class Memory(_Model):
    """Resident memory over many tracked pairs in one process."""

    frames: int = Field(description="Pairs processed")
    tracked: int = Field(description="Of these, tracked")
    start_mb: float = Field(description="After the first tenth of them, 10^6 bytes")
    end_mb: float = Field(description="After the last")
    most_mb: float = Field(description="At most")
    growth_mb_per_1000: float = Field(
        description="Slope of a line through the memory after the first tenth, a thousand pairs"
    )


class BenchReport(_Model):
    """Speed on one machine. The first four are those of 1200 x 800, null where not measured."""

    pair_ms: float | None = Field(
        description="Median time of a tracked pair with the joint fit, images in to relative "
        "state out, ms"
    )
    stock_pair_ms: float | None = Field(
        description="Median time of the stock chain on the same two images, vectorization alone"
    )
    ratio: float | None = Field(description="stock_pair_ms / pair_ms")
    stock_skeleton: str = Field(
        description="Which skeletonization the stock chain had: cv2.ximgproc.thinning, "
        "skimage.morphology.skeletonize, or none where neither is installed"
    )
    schema_version: int = Field(default=SCHEMA_VERSION, description="Version of this schema")
    pipeline_tracker: str = Field(description="Version that was measured")
    bag: str = Field(description="Name of the bag whose images were used")
    machine: Machine = Field(description="What it was measured on")
    sizes: list[SizeReport] = Field(description="One for each size")
    shares: Shares = Field(description="Steps of a tracked pair at 1200 x 800, or the first size")
    growth: list[GrowthLine] | None = Field(description="null without --plots")
    live: Live | None = Field(description="null without --live")
    memory: Memory | None = Field(description="null without --frames")


def bench_schema() -> dict[str, Any]:
    """Return the JSON Schema of what ``bench --json`` writes."""
    return BenchReport.model_json_schema()
