"""What was made of the views used last, found again by the view itself."""

from __future__ import annotations

import threading
from collections import OrderedDict
from typing import Any, Generic, TypeVar

from .geometry import View

T = TypeVar("T")


class RecentlyUsed(Generic[T]):
    """Remembers one thing for each of the views used last.

    Views are told apart by identity, since two equal pictures are two pictures.

    Args:
        most: how many are remembered; may be raised later.
    """

    def __init__(self, most: int) -> None:
        self.most = most
        self._entries: OrderedDict[tuple[int, Any], tuple[View, T]] = OrderedDict()
        self._lock = threading.Lock()

    def get(self, view: View, key: Any = None) -> T | None:
        """What was put under a view and a key, or None."""
        with self._lock:
            entry = self._entries.get((id(view), key))
            if entry is None:
                return None
            self._entries.move_to_end((id(view), key))
        return entry[1]

    def put(self, view: View, key: Any, value: T) -> None:
        """Remembers ``value``, and forgets what was used longest ago if that is too much."""
        with self._lock:
            # The view is held, so that no other one has its identity.
            self._entries[id(view), key] = view, value
            while len(self._entries) > self.most:
                self._entries.popitem(last=False)
