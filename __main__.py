"""`python -m radiosity`: the command line with Blender's Python module."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from . import register, unregister
from .addon.command_line import main


@contextmanager
def registered() -> Iterator[None]:
    """The add-on is registered within; a class left behind can stop Python from ending."""
    register()
    try:
        yield
    finally:
        unregister()


def run() -> None:
    """End the process with the command's exit status."""
    status = main(sys.argv[1:], session=registered())
    sys.stdout.flush()
    sys.stderr.flush()
    # Not sys.exit: the bpy module can crash or hang while Python takes itself apart.
    os._exit(status)


if __name__ == "__main__":
    run()
