"""Follow an underwater pipeline with cameras alone."""

__version__ = "0.1.0"
