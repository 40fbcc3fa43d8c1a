"""`python -m radiosity`: the command line with Blender's Python module."""

import os
import sys

from .addon.command_line import main


def run() -> None:
    """End the process with the command's exit status."""
    status = main(sys.argv[1:])
    sys.stdout.flush()
    sys.stderr.flush()
    # Not sys.exit: the bpy module can crash or hang while Python takes itself apart.
    os._exit(status)


if __name__ == "__main__":
    run()
