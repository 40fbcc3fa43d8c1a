"""Bakes the Cornell box of examples/ and says where the result, its pictures and the report are.

The first run sets up what it needs in `.venv/`. More options are handed on: `--quality final`, and all others of
`python -m radiosity bake --help`.
"""

import environment

environment.enter(__file__, extras=("bpy",))

import json  # noqa: E402  only of use in the environment
import os  # noqa: E402
import sys  # noqa: E402


def bake() -> int:
    """Bake and print; return the exit status."""
    import bpy
    from radiosity.addon.adapters.picture import render_comparison
    from radiosity.addon.command_line import main

    output = environment.ROOT / "output"
    output.mkdir(exist_ok=True)
    result, picture, report = (output / f"cornell_box{suffix}" for suffix in (".blend", ".png", ".json"))
    example = environment.ROOT / "examples" / "cornell_box.blend"
    places = ["--output", str(result), "--image", str(picture), "--report", str(report)]
    status = main(["bake", str(example), *places, *sys.argv[1:]], "scripts/bake_example.py")
    if status:
        return status
    comparison = output / "cornell_box_before_after.png"
    attribute = json.loads(report.read_text(encoding="utf-8"))["settings"]["attribute_name"]
    render_comparison(bpy.context, comparison, attribute)  # of the scene that is still open
    for name, path in (("result", result), ("picture", picture), ("before and after", comparison), ("report", report)):
        print(f"{name + ':':18}{path}")
    return 0


def run() -> int:
    """Bake with the add-on registered, which must not be left behind."""
    import radiosity

    radiosity.register()
    try:
        return bake()
    finally:
        radiosity.unregister()


if __name__ == "__main__":
    status = run()
    sys.stdout.flush()
    sys.stderr.flush()
    # Not sys.exit: the bpy module can crash or hang while Python takes itself apart.
    os._exit(status)
