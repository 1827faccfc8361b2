"""Why a program cannot become native code."""


class Unsupported(Exception):
    """A program holds something that cannot be written as scalars, or not for this machine."""
