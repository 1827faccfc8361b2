"""Errors about what cannot be said in the other program's words, or in ours."""

from evo_cpg.errors import UserError


class ExchangeError(UserError):
    """A model that cannot be exchanged; the message is for the user as it stands."""
