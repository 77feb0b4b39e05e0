"""A frame with a past: where the pipe goes on (4.1)."""
