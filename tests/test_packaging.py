"""The package, its manifest, the wheels and the set-up scripts fit together."""

import importlib.util
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
MANIFEST = tomllib.loads((ROOT / "blender_manifest.toml").read_text(encoding="utf-8"))
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))


def script(name):
    """A module of scripts/, which is no package."""
    spec = importlib.util.spec_from_file_location(f"radiosity_script_{name}", ROOT / "scripts" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


environment = script("environment")


def test_versions_agree():
    assert MANIFEST["version"] == PROJECT["project"]["version"]
    assert f"## {MANIFEST['version']}" in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")


def test_every_package_is_listed_for_installation():
    folders = {
        ".".join(("radiosity", *path.parent.relative_to(ROOT).parts))
        for top in ("core", "addon", "operators")
        for path in (ROOT / top).rglob("__init__.py")
    }
    assert set(PROJECT["tool"]["setuptools"]["packages"]) == {"radiosity", *folders}


def test_every_module_lies_in_a_package():
    for top in ("core", "addon", "operators"):
        for path in (ROOT / top).rglob("*.py"):
            assert (path.parent / "__init__.py").exists(), path


def test_texts_of_the_manifest_keep_blenders_rules():
    assert len(MANIFEST["tagline"]) <= 64
    assert MANIFEST["tagline"][-1].isalnum()
    assert "permissions" not in MANIFEST  # needs neither network nor files of its own
    assert MANIFEST["license"] == ["SPDX:GPL-3.0-or-later"]
    assert "GNU GENERAL PUBLIC LICENSE" in (ROOT / "LICENSE").read_text(encoding="utf-8")


def wheel_parts(name):
    """Platforms and Python tag of a wheel."""
    python, _, platforms = name.removesuffix(".whl").split("-")[-3:]
    return platforms, python


def test_wheels_serve_every_blender_that_has_one():
    served = {}
    for path in MANIFEST["wheels"]:
        platforms, python = wheel_parts(path)
        served.setdefault(platforms.split("_")[0] + ("_arm" if "arm64" in platforms else ""), set()).add(python)
    both = {"cp311", "cp313"}
    # Blender 5 and with it Python 3.13 is not built for Intel Macs.
    assert served == {"win": both, "manylinux": both, "macosx_arm": both, "macosx": {"cp311"}}


def test_oldest_blender_finds_its_wheel():
    # Blender 4.2.0 takes the name that sorts last, whatever its Python tag; its Python is 3.11.
    for platform in {wheel_parts(path)[0] for path in MANIFEST["wheels"]}:
        last = max(path for path in MANIFEST["wheels"] if wheel_parts(path)[0] == platform)
        assert wheel_parts(last)[1] == "cp311"


def test_every_wheel_has_a_hash():
    fetch_wheels = script("fetch_wheels")
    names = fetch_wheels.manifest_wheels(ROOT / "blender_manifest.toml")
    assert {fetch_wheels.published_name(name) for name in names} == set(fetch_wheels.SHA256)


def test_a_wheel_that_differs_is_not_taken(tmp_path):
    fetch_wheels = script("fetch_wheels")
    name = next(iter(fetch_wheels.SHA256))
    (tmp_path / name).write_bytes(b"something else")
    assert not fetch_wheels.is_whole(tmp_path / name, name)


LDD = """\
\tlinux-vdso.so.1 (0x00007ffd)
\tlibX11.so.6 => not found
\tlibXi.so.6 => not found
\tlibc.so.6 => /lib/x86_64-linux-gnu/libc.so.6 (0x00007f)
\tlibGL.so.1 => not found
\tlibX11.so.6 => not found
\tlibstrange.so.7 => not found
"""
LOADER = "ImportError: libSM.so.6: cannot open shared object file: No such file or directory"


def test_all_missing_libraries_are_named_at_once():
    missing = environment.missing_libraries(LOADER, LDD)
    assert missing == ["libGL.so.1", "libSM.so.6", "libX11.so.6", "libXi.so.6", "libstrange.so.7"]
    advice = environment.install_advice(missing)
    assert "sudo apt-get install libgl1 libsm6 libx11-6 libxi6 " in advice
    assert "libstrange.so.7" in advice
    assert "\n" not in advice


def test_without_ldd_known_libraries_are_looked_for(monkeypatch):
    have = {"libX11.so.6", "libXi.so.6", "libstdc++.so.6"}
    monkeypatch.setattr(environment, "_can_load", have.__contains__)
    missing = environment.missing_libraries(LOADER, "")
    assert {"libSM.so.6", "libXfixes.so.3", "libGL.so.1", "libxkbcommon.so.0"} <= set(missing)
    assert not {"libX11.so.6", "libXi.so.6", "libstdc++.so.6"} & set(missing)


def test_no_library_is_named_when_something_else_is_wrong():
    assert environment.missing_libraries("ModuleNotFoundError: No module named 'numpy'", "") == []


@pytest.mark.parametrize("version", [(3, 11), (3, 13)])
def test_fitting_python_is_taken(version):
    environment.check_python(version, True)


def test_other_python_is_refused_with_the_remedy(monkeypatch):
    monkeypatch.setattr(environment.shutil, "which", lambda name: f"/bin/{name}" if name == "python3.13" else None)
    monkeypatch.setattr(sys, "argv", ["scripts/bake_example.py"])
    with pytest.raises(environment.SetupError, match=r"not 3\.12; run: python3\.13 scripts/bake_example\.py$"):
        environment.check_python((3, 12), True)
    monkeypatch.setattr(environment.shutil, "which", lambda name: None)
    with pytest.raises(environment.SetupError, match=r"python\.org$"):
        environment.check_python((3, 9), True)
    with pytest.raises(environment.SetupError, match="64-bit"):
        environment.check_python((3, 11), False)


def test_setup_is_done_again_when_it_was_interrupted_and_not_when_it_is_complete(tmp_path, monkeypatch):
    venv = tmp_path / ".venv"
    done = []

    def make(interrupted):
        venv.mkdir(exist_ok=True)
        (venv / environment._MARK).touch()
        python = environment.venv_python(venv)
        python.parent.mkdir(exist_ok=True)
        python.touch()
        if interrupted:
            raise KeyboardInterrupt

    monkeypatch.setattr(environment, "VENV", venv)
    monkeypatch.setattr(environment, "check_python", lambda version, is_64_bit: None)
    monkeypatch.setattr(environment, "_install", done.append)
    monkeypatch.setattr(environment, "_check_blender", lambda: None)
    monkeypatch.setattr(environment, "_make_venv", lambda: make(interrupted=True))
    with pytest.raises(KeyboardInterrupt):
        environment.ensure(("bpy",))
    monkeypatch.setattr(environment, "_make_venv", lambda: make(interrupted=False))
    environment.ensure(("bpy",))
    assert done == [("bpy",)]
    assert not (venv / environment._MARK).exists()
    environment.ensure(("bpy",))
    assert done == [("bpy",)]  # at once
    environment.ensure(("test",))
    assert done[1:] == [("bpy", "test")]  # more is wanted, nothing is forgotten
    monkeypatch.setattr(environment, "ROOT", tmp_path)  # moved, or other requirements
    (tmp_path / "pyproject.toml").write_text("changed")
    environment.ensure(("bpy",))
    assert len(done) == 3


def test_readme_commands_exist():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    named = set(re.findall(r"scripts/\w+\.py", text))
    assert {"scripts/bake_example.py", "scripts/run_tests.py"} <= named
    assert all((ROOT / name).exists() for name in named)
    for name in re.findall(r"\]\(([^)#:]+)\)", text):
        assert (ROOT / name).exists(), name


@pytest.mark.parametrize("name", ["environment", "bake_example", "run_tests"])
def test_set_up_scripts_can_be_read_by_an_old_python(name):
    """An old Python must get as far as the line that says which one is needed."""
    import ast

    text = (ROOT / "scripts" / f"{name}.py").read_text(encoding="utf-8")
    ast.parse(text, feature_version=(3, 8))


def test_importing_the_package_needs_no_blender():
    code = "import sys; sys.modules['bpy'] = None; import radiosity; assert radiosity.register"
    code = f"import sys; sys.path[:] = {sys.path!r}; " + code
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, cwd=ROOT.parent)
    if "No module named 'radiosity'" in result.stderr:
        pytest.skip("not installed in this Python, as inside the program")
    assert result.returncode == 0, result.stderr
