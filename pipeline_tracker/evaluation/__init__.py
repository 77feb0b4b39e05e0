"""Figures against the truth."""
