"""Packages the extension, installs it into a real Blender, bakes there, and runs all tests inside.

The tools that open a real Blender lie in the folder that RADIOSITY_REAL_BLENDER names: `setup` prepares it (minutes,
the first time), `blender` takes Blender's own arguments, `enter` runs anything else beside it, `screenshot` drives the
window. Without them nothing can be checked: exit status 77.

Blender's Python may be newer than any that official builds have; the test copy of the extension then carries the wheel
that the tools keep for it. Pictures land in `output/real-blender/`. Arguments go to pytest.
"""

import environment

environment.enter(__file__, extras=("bpy", "test"))

import json  # noqa: E402  only of use in the environment
import os  # noqa: E402
import shutil  # noqa: E402
import subprocess  # noqa: E402
import sys  # noqa: E402
import tempfile  # noqa: E402
from concurrent.futures import ThreadPoolExecutor  # noqa: E402
from pathlib import Path  # noqa: E402

import fetch_wheels  # noqa: E402

ROOT = environment.ROOT
NOT_AVAILABLE = 77
VARIABLE = "RADIOSITY_REAL_BLENDER"
# What the tools promise: wheels for this Blender's Python, as `enter` sees them.
_KEPT_WHEELS = "/opt/wheels"
# What the tests need beside pytest, which the tools have.
_TEST_PACKAGES = ("hypothesis",)

#: What is tested in a Blender of its own, each beside the others: about as long.
PARTS = [
    ("tests/core/form_factors", "tests/core/solvers"),
    ("tests", "--ignore=tests/core/form_factors", "--ignore=tests/core/solvers"),
]

DUMP = """
import bpy, sys, numpy as np
bpy.ops.wm.open_mainfile(filepath=sys.argv[-2])
colors = {}
for obj in bpy.data.objects:
    attribute = obj.type == 'MESH' and obj.data.color_attributes.get("Radiosity")
    if attribute:
        values = np.empty(4 * len(attribute.data), dtype=np.float32)
        attribute.data.foreach_get("color", values)
        colors[obj.name] = values
np.savez(sys.argv[-1], **colors)
"""

BAKE_BY_OPERATOR = """
import bpy, sys
assert bpy.ops.radiosity.bake() == {'FINISHED'}
bpy.ops.wm.save_as_mainfile(filepath=sys.argv[-1], copy=True)
"""

# One object selected and in Edit Mode, as people leave files.
LEAVE_IN_EDIT_MODE = """
import bpy, sys
objects = [obj for obj in bpy.context.view_layer.objects if obj.type == 'MESH']
for obj in objects:
    obj.select_set(obj is objects[0])
bpy.context.view_layer.objects.active = objects[0]
bpy.ops.object.mode_set(mode='EDIT')
bpy.ops.wm.save_as_mainfile(filepath=sys.argv[-1], copy=True)
"""


class TestError(Exception):
    """A check failed; the text is one line."""


class RealBlender:
    """The tools, with a home that keeps what is installed until the end of the run."""

    def __init__(self, tools: Path, scratch: Path):
        self.tools = tools
        self.scratch = scratch
        self.environment = {
            **os.environ,
            "REAL_BLENDER_HOME": str(scratch / "home"),
            "REAL_BLENDER_OUT": str(scratch / "out"),
            "REAL_BLENDER_PROJECT": str(ROOT),
        }
        (scratch / "out").mkdir()
        self.python_version = ""

    def run(self, *arguments: object, tool: str = "blender", **extra: str) -> subprocess.CompletedProcess:
        """Run a tool; its output is kept, to be shown when something is wrong."""
        command = [str(self.tools / tool), *map(str, arguments)]
        variables = {**self.environment, **extra}
        return subprocess.run(command, env=variables, cwd=ROOT, capture_output=True, text=True, check=False)

    def must(self, what: str, *arguments: object, says: str = "", **extra: str) -> str:
        """Run Blender and return its output; raise TestError unless it succeeds and says what it must."""
        result = self.run(*arguments, **extra)
        if result.returncode or says not in result.stdout + result.stderr:
            print(result.stdout, result.stderr, sep="\n", file=sys.stderr)
            raise TestError(f"{what}: exit status {result.returncode}" + (f", and no {says!r}" if says else ""))
        print(f"{what}: passed", flush=True)
        return result.stdout


def find_tools() -> Path | None:
    """The folder that the variable names."""
    folder = os.environ.get(VARIABLE)
    return Path(folder) if folder and Path(folder, "blender").is_file() else None


def not_available(reason: str) -> int:
    """Say it so that nobody overlooks it."""
    rule = "!" * 100
    print(f"{rule}\nNOT TESTED IN A REAL BLENDER: {reason}\n{rule}", file=sys.stderr)
    return NOT_AVAILABLE


def copy_for(blender: RealBlender) -> Path:
    """The extension's own files, with the wheel for this Blender's Python."""
    script = "import sys; print('PYTHON', *sys.version_info[:2])"
    said = blender.must("Blender starts", "-b", "--factory-startup", "--python-expr", script, says="PYTHON")
    major, minor = said.split("PYTHON", 1)[1].split()[:2]
    blender.python_version = f"{major}.{minor}"
    tag = f"-cp{major}{minor}-"
    source = blender.scratch / "source"
    unwanted = shutil.ignore_patterns("__pycache__")
    for folder in ("core", "addon", "operators"):
        shutil.copytree(ROOT / folder, source / folder, ignore=unwanted)
    for name in ("__init__.py", "LICENSE", "README.md"):
        shutil.copy(ROOT / name, source)
    manifest = (ROOT / "blender_manifest.toml").read_text(encoding="utf-8")
    names = fetch_wheels.manifest_wheels(ROOT / "blender_manifest.toml")
    fitting = [name for name in names if tag in name and "linux" in name]
    (source / "wheels").mkdir()
    if fitting:
        fetch_wheels.fetch(fitting[0], source / "wheels")
    else:
        kept = blender.scratch / "out" / "wheels"
        blender.run("cp", "-r", _KEPT_WHEELS, kept, tool="enter")
        fitting = [path.name for path in kept.glob(f"*{tag}*.whl")]
        if not fitting:
            raise TestError(f"there is no wheel of embreex for Python {major}.{minor}")
        shutil.copy(kept / fitting[0], source / "wheels")
    start, end = manifest.index("wheels = ["), manifest.index("]", manifest.index("wheels = ["))
    manifest = f'{manifest[:start]}wheels = ["./wheels/{fitting[0]}"{manifest[end:]}'
    manifest = manifest.replace(manifest[manifest.index("platforms = [") :].split("\n")[0], 'platforms = ["linux-x64"]')
    (source / "blender_manifest.toml").write_text(manifest, encoding="utf-8")
    return source


def install(blender: RealBlender) -> Path:
    """Validate, build and install the test copy, without a network; return its zip."""
    source, out = copy_for(blender), blender.scratch / "out"
    blender.must("validate", "--command", "extension", "validate", source)
    blender.must("build", "--command", "extension", "build", "--source-dir", source, "--output-dir", out)
    (package,) = out.glob("radiosity-*.zip")
    arguments = ("--command", "extension", "install-file", "-r", "user_default", "-e", package)
    blender.must("install", *arguments, says="STATUS Installed")
    return package


def bake(blender: RealBlender, pictures: Path) -> None:
    """Bake the example in the installed extension, by command and by operator, and with the bpy module; compare."""
    import numpy as np

    out = blender.scratch / "out"
    example = ROOT / "examples" / "cornell_box.blend"
    results = ("--output", out / "command.blend", "--report", out / "command.json", "--image", out / "command.png")
    blender.must("bake by command", "-b", example, "--command", "radiosity", "bake", *results)
    shutil.copy(out / "command.png", pictures / "cornell_box.png")
    arguments = ("--python-exit-code", 1, "--python-expr", BAKE_BY_OPERATOR, "--", out / "operator.blend")
    blender.must("bake by operator", "-b", example, *arguments)
    refused = blender.run("-b", example, "--command", "radiosity", "bake", "--method", "nonsense")
    if refused.returncode != 2 or "invalid choice" not in refused.stderr:
        raise TestError(f"a wrong argument gives exit status {refused.returncode}, not 2: {refused.stderr}")
    module = out / "module.blend"
    command = [sys.executable, "-m", "radiosity", "bake", str(example), "--output", str(module)]
    command += ["--report", str(out / "module.json")]
    if subprocess.run(command, check=False).returncode:
        raise TestError("the bpy module cannot bake the example")
    colors = {}
    for name in ("command", "operator"):
        arguments = ("--python-exit-code", 1, "--python-expr", DUMP, "--", out / f"{name}.blend", out / f"{name}.npz")
        blender.must(f"read what {name} baked", "-b", "--factory-startup", *arguments)
    arguments = [
        sys.executable,
        "-c",
        DUMP + "sys.stdout.flush()\nimport os\nos._exit(0)",
        str(module),
        str(out / "module.npz"),
    ]
    subprocess.run(arguments, check=True, stdout=subprocess.DEVNULL)
    for name in ("command", "operator", "module"):
        with np.load(out / f"{name}.npz") as stored:
            colors[name] = {key: stored[key] for key in stored.files}
    _compare(colors, json.loads((out / "command.json").read_text()), json.loads((out / "module.json").read_text()))


def _compare(colors: dict, report: dict, module_report: dict) -> None:
    import numpy as np

    if not colors["command"]:
        raise TestError("the command baked no attribute")
    for name, values in colors["command"].items():
        if not np.array_equal(values, colors["operator"][name]):
            raise TestError(f"{name}: command and operator give different colors")
    print(f"command and operator agree bit for bit on {len(colors['command'])} meshes")
    joined = {key: np.concatenate([value[name] for name in sorted(value)]) for key, value in colors.items()}
    error = np.sqrt(np.mean((joined["command"] - joined["module"]) ** 2)) / np.abs(joined["command"]).mean()
    versions = report["blender_version"], module_report["blender_version"]
    print(f"Blender {versions[0]} and bpy {versions[1]} differ by {error:.2e} (relative RMS)")
    if versions[0] == versions[1] and error:
        raise TestError("the same version gives other colors in the program than in the module")
    # Each has at most the error it estimates; both estimates together bound the difference.
    if error > report["estimated_error"] + module_report["estimated_error"]:
        raise TestError(f"the program and the module differ by {error:.1%}, more than both errors allow")


def bake_as_left(blender: RealBlender) -> None:
    """A file that was saved in Edit Mode with one mesh selected is baked whole."""
    out = blender.scratch / "out"
    example, left = ROOT / "examples" / "cornell_box.blend", out / "left in edit mode.blend"
    blender.must(
        "leave in Edit Mode", "-b", example, "--python-exit-code", 1, "--python-expr", LEAVE_IN_EDIT_MODE, "--", left
    )
    reports = {}
    for name, options in (("all", ()), ("selected", ("--selected",))):
        report = out / f"{name}.json"
        arguments = ("--command", "radiosity", "bake", "--report", report, "--quality", "draft", *options)
        blender.must(f"bake {name} of a file in Edit Mode", "-b", left, *arguments)
        reports[name] = json.loads(report.read_text(encoding="utf-8"))["scene"]["baked_objects"]
    if reports["selected"] != 1 or reports["all"] < 2:
        raise TestError(f"a file left in Edit Mode: baked {reports} objects")


def run_suite(blender: RealBlender, arguments: list[str]) -> None:
    """All tests inside the program, on the checkout, with embreex and the test packages beside Blender's Python."""
    packages = blender.scratch / "packages"
    command = [
        sys.executable,
        "-m",
        "pip",
        "install",
        "--quiet",
        "--disable-pip-version-check",
        "--target",
        str(packages),
    ]
    command += [
        "--python-version",
        blender.python_version,
        "--only-binary=:all:",
        "--platform",
        "manylinux_2_28_x86_64",
    ]
    if subprocess.run([*command, *_TEST_PACKAGES], check=False).returncode:
        raise TestError(f"packages for tests cannot be installed for Python {blender.python_version}")

    def run(name: int, part: tuple[str, ...]) -> subprocess.CompletedProcess:
        options = ["-p", "no:cacheprovider", "-q", *part]
        script = f"import sys, pytest; sys.exit(int(pytest.main({options!r})))"
        command = ("-b", "--factory-startup", "--python-exit-code", "1", "--python-expr", script)
        return blender.run(
            *command,
            REAL_BLENDER_HOME=str(blender.scratch / f"home of tests {name}"),
            REAL_BLENDER_WITH=f"pytest embreex {packages}",
            HYPOTHESIS_STORAGE_DIRECTORY=str(blender.scratch / f"hypothesis {name}"),
            REAL_BLENDER_PASS="HYPOTHESIS_STORAGE_DIRECTORY",
        )

    parts = [tuple(arguments)] if arguments else PARTS
    with ThreadPoolExecutor(len(parts)) as pool:
        results = list(pool.map(run, range(len(parts)), parts))
    for result in results:
        print(result.stdout, result.stderr, sep="\n")
    if any(result.returncode for result in results):
        raise TestError(f"tests failed inside Blender: exit status {[result.returncode for result in results]}")


def run_window_tests(blender: RealBlender, package: Path, pictures: Path) -> None:
    """The tests that press buttons, under a virtual display; they start the program themselves."""
    if not any((ROOT / "tests" / "gui").glob("test_*.py")):
        return
    variables = {
        **os.environ,
        VARIABLE: str(blender.tools),
        "RADIOSITY_TEST_ZIP": str(package),
        "RADIOSITY_TEST_PICTURES": str(pictures),
    }
    command = [sys.executable, "-m", "pytest", "-q", "-rs", "-m", "slow", "tests/gui"]
    if subprocess.run(command, cwd=ROOT, env=variables, check=False).returncode:
        raise TestError("the tests with a window failed")


def main() -> int:
    tools = find_tools()
    if tools is None:
        return not_available(f"{VARIABLE} names no folder with the tools that open one")
    if subprocess.run([str(tools / "setup")], check=False).returncode:
        return not_available(f"{tools / 'setup'} failed")
    pictures = ROOT / "output" / "real-blender"
    pictures.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="radiosity-real-blender-") as scratch:
        blender = RealBlender(tools, Path(scratch))
        failures = []
        try:
            package = install(blender)
        except (TestError, fetch_wheels.FetchError) as error:
            print(f"run_tests_in_blender: FAILED: {error}", file=sys.stderr)
            return 1
        for check, arguments in (
            (bake, (pictures,)),
            (bake_as_left, ()),
            (run_suite, (sys.argv[1:],)),
            (run_window_tests, (package, pictures)),
        ):
            try:
                check(blender, *arguments)
            except TestError as error:
                failures.append(str(error))
        for failure in failures:
            print(f"run_tests_in_blender: FAILED: {failure}", file=sys.stderr)
        if failures:
            return 1
    print(f"All checks in the real Blender passed; pictures: {pictures}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
