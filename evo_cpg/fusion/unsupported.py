"""The exception for programs that cannot become native code."""


class Unsupported(Exception):
    """The program has a part that cannot become scalar code, or not on this machine."""
