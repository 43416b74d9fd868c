"""Failures as sentences."""


class InputError(ValueError):
    """The user's input cannot be used. The message is one sentence: which file, camera or frame, what was found,
    what was expected, what to do. The command line prints it without a traceback and exits with code 2."""
