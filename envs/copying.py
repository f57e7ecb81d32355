"""Deep copies of environments, which search algorithms make to try actions."""

from copy import deepcopy
from typing import Any


class CopyableEnv:
    """A deep copy continues the episode by itself, in the same random states.

    What episodes do not change is shared: the estimator, the objects and a bank. The copy has no
    window, and its own OpenGL context, which it opens with its next image.
    """

    def __deepcopy__(self, memo: dict[int, Any]) -> Any:
        names = ("_estimator", "bank")
        shared = [getattr(self, name) for name in names if hasattr(self, name)]
        shared += getattr(self, "_objects", {}).values()
        memo.update((id(part), part) for part in shared)
        memo[id(self)] = copied = type(self).__new__(type(self))
        copied.__dict__.update(deepcopy(self.__dict__, memo))
        return copied
