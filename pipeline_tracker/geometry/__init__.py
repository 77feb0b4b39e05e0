"""Poses, cameras and cylinders."""
