"""The exception that a mistake of the user raises."""


class UserError(Exception):
    """An input from outside, such as a file, a flag or a checkpoint, that cannot be used.

    The message is one line: what was found, what was expected, what to do. The command line prints it without a
    traceback and exits with code 2.
    """
