"""What all errors about the user's input have in common."""


class UserError(Exception):
    """About what the user gave or asked for; the message is for them as it stands.

    The command line prints it in place of a traceback and exits with code 2.
    """
