"""The page of promises names tests that exist."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "explanations" / "promises.md"


def test_each_promise_names_a_test_that_exists() -> None:
    tests = "\n".join(path.read_text() for path in (ROOT / "tests").rglob("test_*.py"))
    rows = re.findall(r"^\| (?!\*\*|promise|-)(.+?) \| (.+?) \|$", PAGE.read_text(), re.MULTILINE)
    assert len(rows) >= 15
    for promise, cell in rows:
        [name] = re.findall(r"`(test_\w+|[\w/]+\.(?:py|toml)|tests/[\w/]*)`", cell)[:1]
        exists = f"def {name}(" in tests if name.startswith("test_") else (ROOT / name).exists()
        assert exists, promise
