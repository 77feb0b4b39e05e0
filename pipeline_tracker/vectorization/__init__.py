"""Images to straight segments and matches (4.1.1)."""
