"""Sets up the checkout's own Python environment in `.venv/` and runs scripts in it.

Runs on any Python 3.8 or newer, before anything is installed: it uses the standard library alone. A stamp that is
written last says that the set-up is complete; a mark that is written first says that one of ours was interrupted.
"""

from __future__ import annotations

import ctypes
import hashlib
import json
import os
import platform
import re
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
VENV = ROOT / ".venv"
#: Blender's Python module has wheels for these; see pyproject.toml.
PYTHON_VERSIONS = ((3, 11), (3, 13))
_MARK = "radiosity-setup-unfinished"

# Libraries of the system that bpy needs, and the packages that bring them: Debian and Ubuntu, Fedora.
LIBRARY_PACKAGES = {
    "libX11.so.6": ("libx11-6", "libX11"),
    "libXi.so.6": ("libxi6", "libXi"),
    "libXfixes.so.3": ("libxfixes3", "libXfixes"),
    "libXrender.so.1": ("libxrender1", "libXrender"),
    "libXxf86vm.so.1": ("libxxf86vm1", "libXxf86vm"),
    "libXext.so.6": ("libxext6", "libXext"),
    "libxkbcommon.so.0": ("libxkbcommon0", "libxkbcommon"),
    "libSM.so.6": ("libsm6", "libSM"),
    "libICE.so.6": ("libice6", "libICE"),
    "libGL.so.1": ("libgl1", "libglvnd-glx"),
    "libEGL.so.1": ("libegl1", "libglvnd-egl"),
    "libgomp.so.1": ("libgomp1", "libgomp"),
    "libstdc++.so.6": ("libstdc++6", "libstdc++"),
    "libuuid.so.1": ("libuuid1", "libuuid"),
    "libz.so.1": ("zlib1g", "zlib-ng-compat"),
}


class SetupError(Exception):
    """Set-up cannot go on; the text is one line that names the remedy."""


def venv_python(venv: Path) -> Path:
    return venv / ("Scripts/python.exe" if os.name == "nt" else "bin/python")


def enter(script: str, extras: tuple[str, ...]) -> None:
    """Return if this process runs in the finished environment; else set it up and run `script` again in it.

    Parameters
    ----------
    script : str
        `__file__` of the caller.
    extras : tuple of str
        Optional dependencies of pyproject.toml that are needed.
    """
    try:
        python = ensure(extras)
    except SetupError as error:
        print(f"radiosity: {error}", file=sys.stderr)
        raise SystemExit(1) from None
    except KeyboardInterrupt:
        print("radiosity: set-up stopped; the next run starts it again", file=sys.stderr)
        raise SystemExit(130) from None
    if Path(sys.prefix).resolve() == VENV.resolve():
        return
    command = [str(python), str(Path(script).resolve()), *sys.argv[1:]]
    if os.name == "nt":  # exec there starts a second process and ends the first at once
        try:
            raise SystemExit(subprocess.call(command))
        except KeyboardInterrupt:
            raise SystemExit(130) from None
    sys.stdout.flush()
    sys.stderr.flush()
    os.execv(command[0], command)


def ensure(extras: tuple[str, ...]) -> Path:
    """Set up the environment unless it is; return its Python.

    Raises
    ------
    SetupError
        If this Python cannot serve, a package cannot be installed, or a system library is missing.
    """
    stamp = VENV / "radiosity-environment.json"
    done = _read_stamp(stamp)
    if done is not None and done.get("key") == _key(done.get("python")) and set(extras) <= set(done["extras"]):
        python = venv_python(VENV)
        if python.exists():
            return python
    check_python(sys.version_info[:2], sys.maxsize > 2**32)
    kept = done["extras"] if done else []
    wanted = tuple(sorted({*extras, *kept}))
    print(f"Setting up {VENV} (once; downloads about 400 MB) ...", file=sys.stderr, flush=True)
    _make_venv()
    stamp.unlink(missing_ok=True)
    _install(wanted)
    (VENV / _MARK).unlink()  # complete, even if the system lacks something: what was downloaded is kept
    _check_blender()
    version = f"{sys.version_info[0]}.{sys.version_info[1]}"
    stamp.write_text(json.dumps({"key": _key(version), "python": version, "extras": wanted}), encoding="utf-8")
    print("Set-up finished.", file=sys.stderr, flush=True)
    return venv_python(VENV)


def _read_stamp(stamp: Path) -> dict | None:
    try:
        return json.loads(stamp.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None


def _key(version: str | None) -> str:
    """Changes with what is to be installed and with where the checkout lies, since environments cannot be moved."""
    needs = (ROOT / "pyproject.toml").read_bytes() + str(ROOT).encode() + str(version).encode()
    return hashlib.sha256(needs).hexdigest()


def check_python(version: tuple[int, int], is_64_bit: bool) -> None:
    """Refuse a Python that Blender's module does not exist for."""
    known = " or ".join(f"{major}.{minor}" for major, minor in PYTHON_VERSIONS)
    if version not in PYTHON_VERSIONS:
        names = (f"python{major}.{minor}" for major, minor in PYTHON_VERSIONS)
        found = next((name for name in names if shutil.which(name)), None)
        script = os.path.basename(sys.argv[0])
        remedy = f"run: {found} scripts/{script}" if found else "install one of them from python.org"
        raise SetupError(f"Blender's module needs Python {known}, not {version[0]}.{version[1]}; {remedy}")
    if not is_64_bit:
        raise SetupError(f"Blender's module needs a 64-bit Python {known}; install one from python.org")


def _make_venv() -> None:
    python = venv_python(VENV)
    if Path(sys.prefix).resolve() != VENV.resolve() and (not _is_usable(python) or (VENV / _MARK).exists()):
        if find_spec("ensurepip") is None:
            name = f"python{sys.version_info[0]}.{sys.version_info[1]}-venv"
            raise SetupError(f"this Python comes without ensurepip; run: sudo apt-get install {name}")
        if VENV.exists():
            shutil.rmtree(VENV)
        VENV.mkdir()
        (VENV / _MARK).touch()
        _run([sys.executable, "-m", "venv", str(VENV)], "the virtual environment cannot be made")
    (VENV / _MARK).touch()


def _is_usable(python: Path) -> bool:
    """Whether an environment is there, complete, and of this Python's version."""
    if not python.exists():
        return False
    script = "import sys, pip; print(sys.version_info[0], sys.version_info[1])"
    result = subprocess.run([str(python), "-c", script], capture_output=True, text=True, check=False)
    return result.returncode == 0 and result.stdout.split() == [str(number) for number in sys.version_info[:2]]


def _install(extras: tuple[str, ...]) -> None:
    # Names without a path: pip reads the checkout's own pyproject.toml.
    target = f".[{','.join(extras)}]" if extras else "."
    command = [str(venv_python(VENV)), "-m", "pip", "install", "--disable-pip-version-check", "-e", target]
    if not sys.stderr.isatty():
        command.append("--quiet")
    system, machine = platform.system(), platform.machine()
    _run(command, f"packages cannot be installed for {system} {machine}; pip says why above")


def _run(command: list[str], failure: str) -> None:
    """Run a command with all its output on standard error, so that standard output is the caller's."""
    if subprocess.run(command, cwd=ROOT, stdout=sys.stderr.fileno(), check=False).returncode:
        raise SetupError(failure)


def _check_blender() -> None:
    """Import bpy once; where it fails for want of system libraries, name all packages that bring them."""
    python = str(venv_python(VENV))
    # Ended hard: taking Blender apart is slower than starting it.
    script = "import os, sys, bpy; sys.stdout.write('works'); sys.stdout.flush(); os._exit(0)"
    result = subprocess.run([python, "-c", script], capture_output=True, text=True, check=False)
    if result.returncode == 0:
        return
    missing = missing_libraries(result.stderr, _linked_libraries(python))
    if missing:
        raise SetupError(install_advice(missing))
    reason = result.stderr.strip().splitlines()
    raise SetupError(f"Blender's module cannot be imported: {reason[-1] if reason else result.returncode}")


def _linked_libraries(python: str) -> str:
    """What ldd says about bpy's binary; empty where there is no ldd."""
    if platform.system() != "Linux" or shutil.which("ldd") is None:
        return ""
    # Not imported: that is what fails.
    script = "from importlib.util import find_spec; print(find_spec('bpy').origin)"
    origin = subprocess.run([python, "-c", script], capture_output=True, text=True, check=False).stdout.strip()
    if not origin:
        return ""
    # This one alone, with all it needs in turn: plug-ins beside it want drivers of graphics cards, and can do without.
    return subprocess.run(["ldd", origin], capture_output=True, text=True, check=False).stdout


def missing_libraries(loader_error: str, ldd_output: str) -> list[str]:
    """Names of shared libraries that the system lacks, sorted.

    ldd knows all of them; without it, the loader names only the first, and the rest is found by looking for each
    library that some release of bpy needs.

    Parameters
    ----------
    loader_error : str
        What Python said when bpy could not be imported.
    ldd_output : str
        What ldd says about bpy's binaries, or nothing.
    """
    named = set(re.findall(r"^\s*(\S+\.so\S*) => not found", ldd_output, re.MULTILINE))
    first = re.search(r"(\S+\.so[.\d]*): cannot open shared object file", loader_error)
    if first:
        named.add(os.path.basename(first.group(1)))
        if not ldd_output:
            named.update(library for library in LIBRARY_PACKAGES if not _can_load(library))
    return sorted(named)


def _can_load(library: str) -> bool:
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True


def install_advice(missing: list[str]) -> str:
    """One line that says which packages to install."""
    known = [LIBRARY_PACKAGES[library] for library in missing if library in LIBRARY_PACKAGES]
    unknown = [library for library in missing if library not in LIBRARY_PACKAGES]
    parts = []
    if known:
        debian = " ".join(sorted({names[0] for names in known}))
        fedora = " ".join(sorted({names[1] for names in known}))
        parts.append(f"run: sudo apt-get install {debian} (Fedora: sudo dnf install {fedora})")
    if unknown:
        parts.append(f"install the packages that bring {', '.join(unknown)}")
    return f"Blender's module needs system libraries; {', and '.join(parts)}; then repeat the command"
