"""A replay's results for other programs: tables (CSV) and maps (GeoJSON)."""

from pipeline_tracker.export.command import ExportOutcome, export

__all__ = ["ExportOutcome", "export"]
