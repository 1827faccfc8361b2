"""The exception for programs that cannot become native code."""


class Unsupported(Exception):
    """Raised if a part of a program cannot become native code, or this machine has none."""
