"""`doctor`: what is wrong with this machine for pipeline_tracker, and what to do about it."""

from pipeline_tracker.doctor.command import doctor_command

__all__ = ["doctor_command"]
