"""Bakes the Cornell box of examples/ and says where result, picture and report are.

The first run sets up what it needs in `.venv/`. More options are handed on: `--quality final`, and all others of
`python -m radiosity bake --help`.
"""

import environment

environment.enter(__file__, extras=("bpy",))

import subprocess  # noqa: E402  only of use in the environment
import sys  # noqa: E402


def main() -> int:
    output = environment.ROOT / "output"
    output.mkdir(exist_ok=True)
    results = {
        "result": ("--output", output / "cornell_box.blend"),
        "picture": ("--image", output / "cornell_box.png"),
        "report": ("--report", output / "cornell_box.json"),
    }
    example = environment.ROOT / "examples" / "cornell_box.blend"
    places = [str(part) for option in results.values() for part in option]
    command = [sys.executable, "-m", "radiosity", "bake", str(example), *places, *sys.argv[1:]]
    try:
        status = subprocess.run(command, stdout=subprocess.DEVNULL, check=False).returncode
    except KeyboardInterrupt:
        return 130
    if status == 0:
        for name, (_, path) in results.items():
            print(f"{name + ':':9}{path}")
    return status


if __name__ == "__main__":
    sys.exit(main())
