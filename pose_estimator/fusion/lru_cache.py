"""A cache of what was computed for the views used last."""

from __future__ import annotations

import threading
from collections import OrderedDict
from typing import Any, Generic, TypeVar

from ...core.geometry import View

T = TypeVar("T")


class LruCache(Generic[T]):
    """Keeps the least recently used entries out; safe for threads.

    Views are compared by identity, since two equal images may be two measurements, and hashing the
    pixels would cost more than it saves. This is what ``functools.lru_cache`` cannot do.

    Args:
        maxsize: how many entries are kept; may be raised later.
    """

    def __init__(self, maxsize: int) -> None:
        self.maxsize = maxsize
        self._entries: OrderedDict[tuple[int, Any], tuple[View, T]] = OrderedDict()
        self._lock = threading.Lock()

    def get(self, view: View, key: Any = None) -> T | None:
        """What was put under a view and a key, or None."""
        with self._lock:
            if (id(view), key) not in self._entries:
                return None
            self._entries.move_to_end((id(view), key))
            return self._entries[id(view), key][1]

    def put(self, view: View, key: Any, value: T) -> None:
        """Stores ``value``, and drops the entries beyond ``maxsize``."""
        with self._lock:
            # The view is held, so that no other one has its identity.
            self._entries[id(view), key] = view, value
            while len(self._entries) > self.maxsize:
                self._entries.popitem(last=False)
