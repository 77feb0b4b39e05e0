"""The schema of the JSON as tables for people.

``python -m pipeline_tracker.bench.document`` prints them.
"""

from __future__ import annotations

import sys

from pipeline_tracker.bench.schema import bench_schema
from pipeline_tracker.evaluation.document import tables_of

if __name__ == "__main__":
    sys.stdout.write(tables_of(bench_schema()))
