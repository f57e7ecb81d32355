"""Reads text files as different programs write them."""

import json
from pathlib import Path

from .errors import InputError


def read_text(path: Path) -> str:
    """Returns the content of a text file in UTF-8, UTF-16 or UTF-32, without a byte order mark.

    Windows' editors and PowerShell write UTF-16 or a byte order mark. The encoding is told from the
    first bytes as for JSON, which takes the first two characters to be ASCII, as in all our files.

    Raises:
        OSError: if the file cannot be read.
        InputError: if it has another encoding.
    """
    content = Path(path).read_bytes()
    try:
        return content.decode(json.detect_encoding(content)).removeprefix("\ufeff")
    except UnicodeDecodeError as error:
        raise InputError(
            f"{path} is not a text file in UTF-8 or UTF-16 ({error.reason} at byte {error.start}): "
            "save it as UTF-8"
        ) from error
