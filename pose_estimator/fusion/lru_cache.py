"""An LRU cache of results for views."""

import threading
from collections import OrderedDict
from typing import Any, Generic, TypeVar

from ...core.geometry import View

T = TypeVar("T")


class LruCache(Generic[T]):
    """Drops the least recently used entries beyond ``maxsize``, which may change; thread-safe.

    Views are compared by identity, which ``functools.lru_cache`` cannot do: hashing their pixels
    would cost more than it saves.
    """

    def __init__(self, maxsize: int) -> None:
        self.maxsize = maxsize
        self._entries: OrderedDict[tuple[int, Any], tuple[View, T]] = OrderedDict()
        self._lock = threading.Lock()

    def get(self, view: View, key: Any = None) -> T | None:
        """Returns the value stored for a view and a key, or None."""
        with self._lock:
            if (id(view), key) not in self._entries:
                return None
            self._entries.move_to_end((id(view), key))
            return self._entries[id(view), key][1]

    def put(self, view: View, key: Any, value: T) -> None:
        """Stores ``value``, and drops the entries beyond ``maxsize``."""
        with self._lock:
            # Holding the view keeps its id from being reused.
            self._entries[id(view), key] = view, value
            while len(self._entries) > self.maxsize:
                self._entries.popitem(last=False)
