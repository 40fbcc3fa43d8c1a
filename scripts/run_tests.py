"""Runs the tests; arguments go to pytest. Slow ones run with `-m slow`, all of them with `-m ""`.

The first run sets up what it needs in `.venv/`.
"""

import environment

environment.enter(__file__, extras=("bpy", "test"))

import os  # noqa: E402  only of use in the environment
import sys  # noqa: E402

import pytest  # noqa: E402


def main() -> None:
    os.chdir(environment.ROOT)
    status = pytest.main(sys.argv[1:])
    sys.stdout.flush()
    sys.stderr.flush()
    # Not sys.exit: the bpy module can crash or hang while Python takes itself apart.
    os._exit(int(status))


if __name__ == "__main__":
    main()
