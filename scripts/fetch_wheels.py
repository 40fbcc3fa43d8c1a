"""Fetches the wheels that blender_manifest.toml names into `wheels/`, with pip, and checks their hashes.

Wheels that are there and whole are kept, so that a second run needs no network.
"""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]

# What was tested is what is packed: one line "hash  name" per wheel.
_HASHES = Path(__file__).with_name("wheels.sha256").read_text(encoding="ascii")
SHA256 = {name: digest for digest, name in (line.split() for line in _HASHES.splitlines())}


class FetchError(Exception):
    """A wheel cannot be had; the text is one line."""


def manifest_wheels(manifest: Path) -> list[str]:
    """File names of the wheels a manifest lists."""
    return [Path(path).name for path in tomllib.loads(manifest.read_text(encoding="utf-8"))["wheels"]]


def published_name(name: str) -> str:
    """The name a wheel has at its publisher: without the build number that we add."""
    parts = name.split("-")
    return "-".join(parts[:2] + parts[-3:])


def is_whole(wheel: Path, name: str) -> bool:
    return wheel.is_file() and hashlib.sha256(wheel.read_bytes()).hexdigest() == SHA256[name]


def fetch(name: str, folder: Path) -> None:
    """Put one wheel into a folder, complete or not at all.

    Raises
    ------
    FetchError
        If pip cannot download it, or gets another file than the one that was tested.
    """
    wheel = folder / name
    if is_whole(wheel, published_name(name)):
        return
    project, version, python, _abi, platforms = published_name(name).removesuffix(".whl").split("-")
    with tempfile.TemporaryDirectory(dir=folder) as temporary:
        command = [sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check", "--no-deps"]
        command += ["--only-binary=:all:", "--python-version", f"{python[2]}.{python[3:]}", "--dest", temporary]
        command += [part for tag in platforms.split(".") for part in ("--platform", tag)]
        result = subprocess.run(
            [*command, f"{project}=={version}"],
            stdout=sys.stderr.fileno(),
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
        if result.returncode:
            reason = (result.stderr.strip().splitlines() or ["pip gives no reason"])[-1]
            raise FetchError(f"{name} cannot be fetched: {reason}")
        (found,) = Path(temporary).iterdir()
        if not is_whole(found, published_name(name)):
            raise FetchError(f"{name} is not the file that was tested: its hash differs")
        os.replace(found, wheel)


def main() -> int:
    folder = ROOT / "wheels"
    folder.mkdir(exist_ok=True)
    for name in manifest_wheels(ROOT / "blender_manifest.toml"):
        try:
            fetch(name, folder)
        except FetchError as error:
            print(f"fetch_wheels: {error}", file=sys.stderr)
            return 1
        print(f"{folder / name}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
