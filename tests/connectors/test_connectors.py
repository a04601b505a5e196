import subprocess
import sys

import connectors

CODE = """
import sys
from connectors import Console, Mqtt
Console(), Mqtt("mqtt://localhost")
print(*{"aiomqtt", "polars", "pyarrow", "rich", "scipy"} & set(sys.modules))
"""


def test_building_connectors_imports_nothing_heavy() -> None:
    done = subprocess.run([sys.executable, "-c", CODE], check=True, capture_output=True, text=True)
    assert done.stdout == "\n"


def test_exports_exist_and_are_sorted() -> None:
    assert connectors.__all__ == sorted(connectors.__all__)
    assert all(hasattr(connectors, name) for name in connectors.__all__)
