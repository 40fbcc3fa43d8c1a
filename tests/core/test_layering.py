"""One direction of dependency: core < adapters < properties < operators < panels and command line."""

import ast
import importlib.util
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]

# The first entry that a module's path starts with is its rank; a module imports from its own rank or lower.
RANKS = (
    ("core", 0),
    ("addon/adapters", 1),
    ("addon/properties", 2),
    ("operators", 3),
    ("addon/panels", 4),
    ("addon/command_", 4),
    ("addon", 5),  # addon/__init__.py puts all of them together
    ("__init__", 6),
    ("__main__", 6),
)
BLENDER_MODULES = frozenset(
    {"bpy", "bmesh", "mathutils", "gpu", "blf", "bl_math", "freestyle", "imbuf", "aud", "idprop"}
)


def modules(root: Path) -> list[Path]:
    """The extension's own modules, relative to `root`."""
    found = [path for folder in ("core", "addon", "operators") for path in (root / folder).rglob("*.py")]
    found += [path for path in (root / "__init__.py", root / "__main__.py") if path.exists()]
    return sorted(path.relative_to(root) for path in found)


def rank(module: Path) -> int:
    name = module.with_suffix("").as_posix()
    for start, value in RANKS:
        if name == start or name.startswith(start + "/"):
            return value
    raise AssertionError(f"{module} has no rank")


def imported(root: Path, module: Path) -> list[tuple[int, str, Path | None]]:
    """(line, spelled name, file inside the package or None) of every import of a module, nested ones included."""
    found = []
    for node in ast.walk(ast.parse((root / module).read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found += [(node.lineno, alias.name, None) for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and not node.level:
            found.append((node.lineno, node.module, None))
        elif isinstance(node, ast.ImportFrom):
            if node.level > len(module.parts):
                found.append((node.lineno, "." * node.level, Path("outside")))
                continue
            base = Path(*module.parts[: len(module.parts) - node.level]) if node.level < len(module.parts) else Path()
            base = base.joinpath(*(node.module.split(".") if node.module else ()))
            for alias in node.names:
                candidates = (
                    (base / alias.name).with_suffix(".py"),
                    base / alias.name / "__init__.py",
                    base.parent / f"{base.name}.py",
                )
                target = next((path for path in candidates if (root / path).exists()), base / "__init__.py")
                found.append((node.lineno, f"{'.' * node.level}{node.module or ''}:{alias.name}", target))
    return found


def violations(root: Path) -> list[str]:
    """One line for every import that breaks the order of the layers."""
    broken = []
    for module in modules(root):
        own = rank(module)
        for line, name, target in imported(root, module):
            where = f"{module}:{line} imports {name}"
            top = name.lstrip(".").split(".")[0].split(":")[0]
            if target is None:
                if own == 0 and top in BLENDER_MODULES:
                    broken.append(f"{where}: the core knows no Blender")
                if top in ("radiosity", "core", "addon", "operators", "bl_ext"):
                    broken.append(f"{where}: imports inside the extension are relative")
                continue
            if target == Path("outside"):
                broken.append(f"{where}: above the extension")
            # `from .. import __package__` is how a sub-package learns the extension's name.
            elif rank(target) > own and not name.endswith(":__package__"):
                broken.append(f"{where}: {target} ranks above it")
    return broken


def test_every_module_imports_from_its_own_rank_or_lower():
    assert len(modules(ROOT)) > 10
    assert violations(ROOT) == []


MADE_UP = {
    "core reads Blender": ("core/light.py", "def f():\n    import bpy\n"),
    "core reads an adapter": ("core/light.py", "from ..addon.adapters import reader\n"),
    "an adapter reads an operator": ("addon/adapters/writer.py", "from ...operators.bake import run\n"),
    "an operator reads a panel": ("operators/clear.py", "from ..addon.panels import bake\n"),
    "a property reads an operator": ("addon/properties/scene.py", "from ... import operators\n"),
    "an absolute name of our own": ("addon/panels/more.py", "import radiosity.core\n"),
    "above the extension": ("core/light.py", "from ... import secrets\n"),
}


@pytest.mark.parametrize("name", MADE_UP)
def test_a_broken_layer_is_found(tmp_path, name):
    tree = ("core/__init__.py", "addon/adapters/reader.py", "operators/__init__.py", "operators/bake.py")
    for path in (*tree, "addon/panels/bake.py"):
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / path).write_text("", encoding="utf-8")
    assert violations(tmp_path) == []
    path, text = MADE_UP[name]
    (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / path).write_text(text, encoding="utf-8")
    (line,) = violations(tmp_path)
    assert line.startswith(path)


def import_all_of_core(root: Path) -> subprocess.CompletedProcess:
    """Import every module of the core in a fresh Python in which Blender's modules cannot be imported."""
    names = [".".join(("radiosity", *path.with_suffix("").parts)) for path in modules(root) if path.parts[0] == "core"]
    script = f"""
        import importlib, importlib.util, sys
        for blocked in {sorted(BLENDER_MODULES | {"scipy"})!r}:
            sys.modules[blocked] = None
        spec = importlib.util.spec_from_file_location(
            "radiosity", {str(root / "__init__.py")!r}, submodule_search_locations=[{str(root)!r}])
        package = importlib.util.module_from_spec(spec)
        sys.modules["radiosity"] = package
        spec.loader.exec_module(package)
        for name in {names!r}:
            importlib.import_module(name.removesuffix(".__init__"))
        print(len({names!r}))
    """
    # Inside the real program sys.executable is Blender's Python, which needs the path to find the same packages.
    script = f"import sys; sys.path[:] = {sys.path!r}\n" + textwrap.dedent(script)
    return subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)


def test_core_imports_without_blender():
    result = import_all_of_core(ROOT)
    assert result.returncode == 0, result.stderr
    assert int(result.stdout) > 5


def test_importing_a_core_that_needs_blender_fails(tmp_path):
    (tmp_path / "core").mkdir()
    (tmp_path / "__init__.py").write_text("", encoding="utf-8")
    (tmp_path / "core" / "__init__.py").write_text("import mathutils\n", encoding="utf-8")
    assert "mathutils" in import_all_of_core(tmp_path).stderr


@pytest.mark.skipif(importlib.util.find_spec("ruff") is None, reason="needs ruff")
@pytest.mark.parametrize(("folder", "banned"), [("core", True), ("addon/adapters", False), ("operators", False)])
def test_lint_bans_blender_in_the_core_alone(folder, banned):
    command = [sys.executable, "-m", "ruff", "check", "--stdin-filename", f"{folder}/light.py", "-"]
    text = "import bpy\n\nbpy.app.version\n"
    result = subprocess.run(command, input=text, cwd=ROOT, capture_output=True, text=True, check=False)
    assert ("TID251" in result.stdout) == banned, result.stdout + result.stderr
