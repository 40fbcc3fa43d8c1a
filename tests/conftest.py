"""Makes the checkout importable as `radiosity` where it is not installed, as inside the real Blender."""

import importlib.util
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def _make_importable() -> None:
    if "radiosity" in sys.modules or importlib.util.find_spec("radiosity") is not None:
        return
    spec = importlib.util.spec_from_file_location(
        "radiosity", ROOT / "__init__.py", submodule_search_locations=[str(ROOT)]
    )
    module = importlib.util.module_from_spec(spec)
    sys.modules["radiosity"] = module
    spec.loader.exec_module(module)


_make_importable()
