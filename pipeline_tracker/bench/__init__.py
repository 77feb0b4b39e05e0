"""How fast: every step beside stock methods, live over DDS, growth and memory."""

from pipeline_tracker.bench.command import bench_command
from pipeline_tracker.bench.options import BenchOptions
from pipeline_tracker.bench.schema import BenchReport

__all__ = ["BenchOptions", "BenchReport", "bench_command"]
