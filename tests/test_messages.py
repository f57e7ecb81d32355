"""What the command line prints of an error."""

import errno

import pytest
from two_view_pose.__main__ import message
from two_view_pose.core.errors import InputError


@pytest.mark.parametrize(
    ("error", "end"),
    [
        (InputError("damaged.json is damaged: " + "x" * 100_000 + ", train again"), "train again"),
        (OSError(errno.ENAMETOOLONG, "name too long", "damaged" + "9" * 5000), "name too long"),
    ],
)
def test_long_messages_are_shortened(error: Exception, end: str) -> None:
    """Some repeat all of a damaged file."""
    text = message(error)
    assert len(text) < 2000
    assert text.startswith("damaged") and text.endswith(end)
