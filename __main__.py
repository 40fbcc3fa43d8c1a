"""`python -m radiosity`: the command line with Blender's Python module."""

import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def registered() -> Iterator[None]:
    """The add-on is registered within; a class left behind can stop Python from ending."""
    from . import register, unregister

    register()
    try:
        yield
    finally:
        unregister()


def open_standard_streams() -> None:
    """Give a process that was started without input, output or error streams empty ones in their place."""
    for descriptor, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest number that is free, which is this
            setattr(sys, name, open(descriptor, "w" if descriptor else "r", encoding="utf-8", closefd=False))


def run() -> None:
    """End the process with the command's exit status."""
    open_standard_streams()
    # An exception in the middle of an import leaves a trace, and in bpy's a crash. Until the bake takes over, Ctrl-C
    # just ends the process.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    from .addon.command_line import main

    status = main(sys.argv[1:], session=registered())
    sys.stdout.flush()
    sys.stderr.flush()
    # Not sys.exit: the bpy module can crash or hang while Python takes itself apart.
    os._exit(status)


if __name__ == "__main__":
    run()
