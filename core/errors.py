"""The one error that a wrong input raises."""

from __future__ import annotations


class InputError(ValueError):
    """An option, argument or file is wrong; the message names it and says what is allowed.

    The command line prints it as one line. Any other error is a fault of the program and keeps its
    traceback.
    """
