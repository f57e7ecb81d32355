"""The error for wrong input."""


class InputError(ValueError):
    """An option, argument or file is wrong; the message names it and says what is allowed.

    The command line prints it as one line; any other error keeps its traceback.
    """
