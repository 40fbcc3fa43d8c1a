"""Runs the tests, one process per processor core; arguments go to pytest.

Slow ones run with `-m slow`, all of them with `-m ""`; `-n 0` keeps them in one process. The first run sets up what it
needs in `.venv/`.
"""

import environment

environment.enter(__file__, extras=("bpy", "test"))

import os  # noqa: E402  only of use in the environment
import sys  # noqa: E402

import pytest  # noqa: E402

#: Each process holds Blender and a scene or two, about half a gigabyte.
MOST_PROCESSES = 8

#: Of pytest-xdist. Neighbors stay together as long as there is enough to do, for the fixtures they share.
DISTRIBUTION = ["-n", "auto", "--maxprocesses", str(MOST_PROCESSES), "--dist", "worksteal"]


def main() -> None:
    os.chdir(environment.ROOT)
    status = pytest.main([*DISTRIBUTION, *sys.argv[1:]])
    sys.stdout.flush()
    sys.stderr.flush()
    # Not sys.exit: the bpy module can crash or hang while Python takes itself apart.
    os._exit(int(status))


if __name__ == "__main__":
    main()
