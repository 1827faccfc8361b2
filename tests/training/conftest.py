"""Tests of training share compiled programs."""

from shared_programs import forget_where_something_is_replaced, remember_programs

__all__ = ["forget_where_something_is_replaced", "remember_programs"]
