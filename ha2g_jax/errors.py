"""The one exception that a user's mistake raises."""


class UserError(Exception):
    """Bad input from outside: a file, a flag, a checkpoint.

    The message is one line: what was found, what was expected, what to do next.
    The command line prints it without a traceback and exits with code 2.
    """
