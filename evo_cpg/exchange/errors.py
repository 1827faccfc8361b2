"""Errors about what cannot be said in the other program's words, or in ours."""


class ExchangeError(Exception):
    """A model that cannot be exchanged; the message is for the user as it stands."""
