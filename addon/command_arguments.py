"""Arguments of the command line: what can be typed, and which settings it gives.

Arguments are checked before Blender is loaded and before the first file is opened. An option that is given replaces the
setting stored in the file; one that is not leaves it.
"""

from __future__ import annotations

import argparse
from typing import NoReturn

from ..core.settings import BAKE_TYPES, METHODS, QUALITY_ACCURACY, SOLVERS
from ..core.verification.verification import PLACES

#: Exit status after arguments that make no sense.
BAD_ARGUMENTS = 2

_DESCRIPTION = "Bake diffuse interreflection into a color attribute of the meshes of a scene."
_VERIFY_DESCRIPTION = "Measure the error of the last bake in a file, by light that is followed without short-cuts."
_VERIFY_EPILOG = """\
The file is opened, never written. The error is relative and RMS, as --accuracy asks for it, with the interval that
holds the true one in 95 of 100 cases. Exit status as for bake."""
_COMPARE_DESCRIPTION = "Bake a scene by every method, measure the error of each, and say which to take."
_COMPARE_EPILOG = """\
The file is opened, never written. Each bake is one line on the output, the last line is the advice: the fastest that
keeps the accuracy asked for. Errors are relative and RMS, as --accuracy asks for them, with the interval that holds the
true one in 95 of 100 cases. Exit status as for bake."""
_EPILOG = """\
IN is a .blend, .gltf, .glb, .obj, .ply, .fbx or .usd* file; with `blender -b FILE --command` it may be left out.
All meshes that the render shows are baked, whatever was selected when the file was saved.
At least one of --output, --report and --image says what is to be written; nothing else is. With several files
they name folders, where each result gets the name of its file. Exit status: 0 done, 1 a file failed, 2 bad
arguments, 130 stopped by Ctrl-C. A result appears complete or not at all."""

# Options that are handed on: destination here -> name of the override in the bake's options.
_OVERRIDES = {
    "quality": "quality",
    "accuracy": "accuracy",
    "method": "method",
    "solver": "solver",
    "bake": "bake_type",
    "attribute": "attribute_name",
    "domain": "domain",
    "type": "data_type",
    "seed": "seed",
    "threads": "threads",
    "time_limit": "time_limit",
    "world_strength": "world_strength",
}


def _name(text: str) -> str:
    """Names may be typed with hyphens or underscores, in upper or lower case."""
    return text.strip().lower().replace("-", "_")


class _Parser(argparse.ArgumentParser):
    """Says what is wrong in one line, without the list of all options."""

    def error(self, message: str) -> NoReturn:
        self.exit(BAD_ARGUMENTS, f"{self.prog}: error: {message} (--help lists all options)\n")


def build_parser(program: str, may_be_open: bool = False) -> argparse.ArgumentParser:
    """The arguments; `may_be_open` says that a file may be open already, so that IN can be left out."""
    parser = _Parser(prog=program, description=_DESCRIPTION, allow_abbrev=False)
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    bake = commands.add_parser(
        "bake",
        help="bake scenes",
        description=_DESCRIPTION,
        epilog=_EPILOG,
        allow_abbrev=False,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    bake.add_argument("inputs", metavar="IN", nargs="*" if may_be_open else "+", help="scene file")
    bake.add_argument("--output", metavar="OUT.blend", help="save the baked scene here")
    bake.add_argument("--report", metavar="R.json", help="save the report here")
    bake.add_argument("--image", metavar="I.png", help="save a picture of the baked scene here")
    error = bake.add_mutually_exclusive_group()
    error.add_argument("--quality", type=_name, choices=tuple(QUALITY_ACCURACY), help="preset of the accuracy")
    error.add_argument("--accuracy", type=float, metavar="A", help="relative error to aim for, 0.02 is 2 %%")
    bake.add_argument(
        "--method",
        type=_name,
        choices=METHODS,
        help="how the exchange of light is found; contour_integral has no shadows of its own, rays add them",
    )
    bake.add_argument("--solver", type=_name, choices=SOLVERS, help="how the bounces are summed")
    bake.add_argument("--attribute", metavar="NAME", help="color attribute to write")
    bake.add_argument("--domain", type=_name, choices=("corner", "point"), help="where colors are stored")
    bake.add_argument("--type", type=_name, choices=("float", "byte"), help="kind of number that stores colors")
    bake.add_argument("--bake", type=_name, choices=BAKE_TYPES, help="which part of the light")
    bake.add_argument("--selected", action="store_true", help="bake only what is selected in the file")
    bake.add_argument("--world-strength", type=float, metavar="W", help="light with a white sky of this strength")
    bake.add_argument("--seed", type=int, metavar="N", help="pattern of random numbers")
    bake.add_argument("--threads", type=int, metavar="N", help="processor cores to use, 0 for all")
    bake.add_argument("--time-limit", type=float, metavar="S", help="refine no further after S seconds")
    bake.add_argument("--verify", action="store_true", help="measure the error of the result as well")
    _add_common(bake)
    verify = commands.add_parser(
        "verify",
        help="measure the error of baked scenes",
        description=_VERIFY_DESCRIPTION,
        epilog=_VERIFY_EPILOG,
        allow_abbrev=False,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    verify.add_argument("inputs", metavar="IN", nargs="*" if may_be_open else "+", help="baked .blend file")
    verify.add_argument("--report", metavar="R.json", help="save the report with what was measured here")
    verify.add_argument("--places", type=int, metavar="N", default=PLACES, help="vertices compared (%(default)s)")
    verify.add_argument("--seed", type=int, metavar="N", default=0, help="other numbers choose other vertices")
    verify.add_argument("--threads", type=int, metavar="N", help="processor cores to use, 0 for all")
    _add_common(verify)
    _add_compare(commands, may_be_open)
    return parser


def _add_compare(commands, may_be_open: bool) -> None:
    compare = commands.add_parser(
        "compare",
        help="bake by every method and measure each",
        description=_COMPARE_DESCRIPTION,
        epilog=_COMPARE_EPILOG,
        allow_abbrev=False,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    compare.add_argument("inputs", metavar="IN", nargs="*" if may_be_open else "+", help="scene file")
    compare.add_argument("--table", metavar="T.csv", help="save time and error of every bake here")
    compare.add_argument("--image", metavar="I.png", help="save a plot of error against time here")
    compare.add_argument("--accuracy", type=float, metavar="A", help="what is asked for; the file's unless given")
    compare.add_argument(
        "--accuracies",
        type=_numbers,
        metavar="A,B,...",
        help="what each method is baked at; the presets down to what is asked for unless given",
    )
    compare.add_argument(
        "--methods", type=_methods, metavar="M,N,...", default=METHODS, help=f"some of {', '.join(METHODS)}"
    )
    compare.add_argument("--selected", action="store_true", help="bake only what is selected in the file")
    compare.add_argument("--world-strength", type=float, metavar="W", help="light with a white sky of this strength")
    compare.add_argument("--places", type=int, metavar="N", default=PLACES, help="vertices compared (%(default)s)")
    compare.add_argument("--seed", type=int, metavar="N", help="pattern of random numbers")
    compare.add_argument("--threads", type=int, metavar="N", help="processor cores to use, 0 for all")
    _add_common(compare)


def _numbers(text: str) -> tuple[float, ...]:
    return tuple(float(part) for part in text.split(","))


def _methods(text: str) -> tuple[str, ...]:
    names = tuple(_name(part) for part in text.split(","))
    if unknown := [name for name in names if name not in METHODS]:
        raise argparse.ArgumentTypeError(f"unknown method {unknown[0]!r}: choose from {', '.join(METHODS)}")
    return names


def _add_common(command: argparse.ArgumentParser) -> None:
    command.add_argument("--enable-scripts", action="store_true", help="let Python scripts inside a .blend run")
    command.add_argument("--verbose", action="store_true", help="show what Blender itself has to say")


def overrides(arguments: argparse.Namespace) -> dict[str, object]:
    """Settings that were given, by the names of the bake's options."""
    return {
        new: getattr(arguments, old) for old, new in _OVERRIDES.items() if getattr(arguments, old, None) is not None
    }
