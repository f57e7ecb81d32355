"""The error for wrong input, and the warning for input that is probably wrong."""


class InputError(ValueError):
    """An option, argument or file is wrong; the message names it and says what is allowed.

    The command line prints it as one line; any other error keeps its traceback.
    """


class InputWarning(UserWarning):
    """Input is used as it is, though it is probably wrong; the message says why and what to do.

    The command line prints it as one line.
    """
