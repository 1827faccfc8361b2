"""Tests of training share compiled programs."""

from shared_programs import programs_of_its_own, remember_programs

__all__ = ["programs_of_its_own", "remember_programs"]
