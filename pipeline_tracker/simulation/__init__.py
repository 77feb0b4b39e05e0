"""Scenes with truth."""
