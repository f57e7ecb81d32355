"""The modeling is no part of the wheel: where that is under test, it comes from the checkout."""

import sys
from importlib.util import find_spec, module_from_spec, spec_from_file_location
from pathlib import Path

NAME = "two_view_pose.assets.build"
FOLDER = Path(__file__).parents[3] / "assets" / "build"

if find_spec(NAME) is None:
    spec = spec_from_file_location(
        NAME, FOLDER / "__init__.py", submodule_search_locations=[str(FOLDER)]
    )
    assert spec is not None and spec.loader is not None
    sys.modules[NAME] = module_from_spec(spec)
    spec.loader.exec_module(sys.modules[NAME])
