"""Builds the extension into `dist/`: one zip per platform, validated, each below 30 MB.

Uses the packaging tool that comes with Blender's Python module, which is what `blender --command extension build` runs.
"""

import environment

environment.enter(__file__, extras=("bpy",))

import subprocess  # noqa: E402  only of use in the environment
import sys  # noqa: E402
import tomllib  # noqa: E402
import zipfile  # noqa: E402
from importlib.util import find_spec  # noqa: E402
from pathlib import Path  # noqa: E402

import fetch_wheels  # noqa: E402

MAX_BYTES = 30_000_000
# Folders of the repository that are of no use in Blender, and files that must be there.
UNWANTED = ("tests/", "scripts/", "benchmarks/", "examples/", "docs/", "output/", "dist/", ".venv/", ".git/")
WANTED = ("__init__.py", "blender_manifest.toml", "LICENSE", "core/__init__.py", "addon/__init__.py")


class BuildError(Exception):
    """The package is not as it should be; the text is one line."""


def packaging_tool() -> Path:
    """Blender's own packaging script inside the bpy module."""
    folder = Path(find_spec("bpy").origin).parent
    return next(folder.glob("*/scripts/addons_core/bl_pkg/cli/blender_ext.py"))


def run_tool(*arguments: str) -> None:
    """Run Blender's packaging script.

    Raises
    ------
    BuildError
        If it fails; what it said stands on standard output.
    """
    command = [sys.executable, str(packaging_tool()), *arguments]
    if subprocess.run(command, check=False).returncode:
        raise BuildError(f"Blender's packaging tool failed: {' '.join(arguments)}")


def build(source: Path, target: Path, *, split: bool = True) -> list[Path]:
    """Validate a source folder and build its zips into another folder, in place of those of the same version.

    Raises
    ------
    BuildError
        If something fails, or a zip is too large or holds the wrong files.
    """
    manifest = tomllib.loads((source / "blender_manifest.toml").read_text(encoding="utf-8"))
    target.mkdir(parents=True, exist_ok=True)
    for old in target.glob(f"{manifest['id']}-{manifest['version']}*.zip"):
        old.unlink()
    run_tool("validate", str(source))
    options = ["--split-platforms"] if split else []
    run_tool("build", "--source-dir", str(source), "--output-dir", str(target), *options)
    zips = sorted(target.glob(f"{manifest['id']}-{manifest['version']}*.zip"))
    expected = len(manifest["platforms"]) if split else 1
    if len(zips) != expected:
        raise BuildError(f"expected {expected} zips, found {len(zips)} in {target}")
    return zips


def check_zip(path: Path) -> str:
    """Look into one zip and describe it in one line.

    Raises
    ------
    BuildError
        If it is too large, or holds too much or too little.
    """
    size = path.stat().st_size
    if size > MAX_BYTES:
        raise BuildError(f"{path.name} has {size / 1e6:.1f} MB, more than {MAX_BYTES / 1e6:.0f} MB")
    with zipfile.ZipFile(path) as archive:
        names = archive.namelist()
    missing = [name for name in WANTED if name not in names]
    unwanted = [name for name in names if name.startswith(UNWANTED) or "__pycache__" in name]
    if missing or unwanted:
        raise BuildError(f"{path.name} lacks {missing} and should not hold {unwanted[:5]}")
    wheels = [name for name in names if name.endswith(".whl")]
    return f"{path}  {size / 1e6:.1f} MB, {len(names)} files, {len(wheels)} wheels"


def main() -> int:
    try:
        if fetch_wheels.main():
            return 1
        for path in build(environment.ROOT, environment.ROOT / "dist"):
            print(check_zip(path))
    except BuildError as error:
        print(f"build_extension: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
