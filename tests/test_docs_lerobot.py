"""LeRobot's own loader reads what docs/how-to/lerobot.md exports."""

import os
import subprocess
from pathlib import Path

import pytest

from tests.command import succeed
from tests.pages import ROOT, block, commands

PAGE = ROOT / "docs" / "how-to" / "lerobot.md"
PYTHON = os.environ.get("LEROBOT_PYTHON", "")
# torchvision's compiled operators, for images and videos only, may be built for another torch than ours
RUN = """
import runpy, sys, types
sys.modules["torchvision._meta_registrations"] = types.ModuleType("_meta_registrations")
runpy.run_path("read_lerobot.py")
"""


@pytest.mark.skipif(not PYTHON, reason="LEROBOT_PYTHON names no Python that has lerobot")
def test_lerobot_reads_the_export_and_finds_the_touch_of_a_frame(tmp_path: Path) -> None:
    for words in commands(PAGE):
        succeed(*words, cwd=tmp_path)
    (tmp_path / "read_lerobot.py").write_text(block(PAGE, "read_lerobot.py"))
    env = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(
        [PYTHON, "-c", RUN],
        cwd=tmp_path,
        env={**env, "HF_HUB_OFFLINE": "1"},
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    assert f"\n    {done.stdout}" in PAGE.read_text()
