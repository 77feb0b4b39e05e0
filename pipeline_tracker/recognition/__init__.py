"""A frame with no past: is there a pipe, and where (4.2)."""
