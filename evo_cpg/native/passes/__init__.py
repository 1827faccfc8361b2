"""Passes: functions from a graph of scalars to a new one."""
