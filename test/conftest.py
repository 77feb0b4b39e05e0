"""Settings of the whole test run."""

from __future__ import annotations

from hypothesis import settings

# A busy machine is slow, not wrong.
settings.register_profile("pipeline_tracker", deadline=None)
settings.load_profile("pipeline_tracker")
