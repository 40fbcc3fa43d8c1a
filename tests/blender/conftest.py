"""Registers the add-on once, in the bpy module or inside the program, and gives every test an empty file.

User resources point to a temporary folder before bpy is imported, so that no preference or extension of the person who
runs the tests takes part.
"""

import os
import shutil
import sys
import tempfile

import pytest

_INSIDE_PROGRAM = "bpy" in sys.modules
_RESOURCES = tempfile.mkdtemp(prefix="radiosity-tests-")
if not _INSIDE_PROGRAM:
    os.environ["BLENDER_USER_RESOURCES"] = _RESOURCES
bpy = pytest.importorskip("bpy", reason="needs Blender's Python module: pip install -e .[bpy]")


def pytest_collection_modifyitems(items):
    here = os.path.dirname(__file__)
    for item in items:
        if str(item.path).startswith(here):
            item.add_marker(pytest.mark.blender)


@pytest.fixture(scope="session", autouse=True)
def registered():
    """The add-on is registered while the tests of this folder run.

    It must be taken back: with the bpy module, a class that is still registered at exit crashes or hangs Python.
    """
    import radiosity

    radiosity.register()
    yield
    radiosity.unregister()


@pytest.fixture(autouse=True)
def empty_file(registered):
    """Each test starts from a file with a scene and nothing in it. Keeps the add-on, unlike read_factory_settings."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)


def pytest_unconfigure():
    shutil.rmtree(_RESOURCES, ignore_errors=True)
