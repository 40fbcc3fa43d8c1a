"""The real program with its window, driven by mouse and keys.

Needs RADIOSITY_REAL_BLENDER, the folder that holds the driver `screenshot`, and RADIOSITY_TEST_ZIP, an extension zip
for that program. RADIOSITY_TEST_PICTURES names a folder that keeps the pictures, to be looked at.
"""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

_TOOLS = os.environ.get("RADIOSITY_REAL_BLENDER", "")
_ZIP = os.environ.get("RADIOSITY_TEST_ZIP", "")

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not _TOOLS, reason="RADIOSITY_REAL_BLENDER does not name the tools that open the real program"),
    pytest.mark.skipif(bool(_TOOLS) and not _ZIP, reason="RADIOSITY_TEST_ZIP does not name an extension to install"),
]

_SECONDS = 420


def test_bake_from_the_button_and_stop_by_escape(tmp_path):
    picture = tmp_path / "end.png"
    command = [
        str(Path(_TOOLS, "screenshot")), "--zip", _ZIP, "--timeout", str(_SECONDS),
        str(Path(__file__).with_name("press_bake.py")), str(picture),
    ]  # fmt: skip
    result = subprocess.run(command, capture_output=True, text=True, check=False, timeout=_SECONDS + 60)
    if keep := os.environ.get("RADIOSITY_TEST_PICTURES"):
        Path(keep).mkdir(parents=True, exist_ok=True)
        for path in tmp_path.glob("*.png"):
            shutil.copy(path, keep)
    assert result.returncode == 0, (result.stdout + result.stderr)[-4000:]
    names = {path.stem for path in tmp_path.glob("*.png")}
    assert {"tab", "baked", "running", "stopped", "again", "cleared", "end"} <= names
