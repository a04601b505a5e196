"""The output of `slipflow run`."""

import json
import re

from tests.command import slipflow


def test_a_live_run_prints_one_json_object() -> None:
    done = slipflow("run", "live", "--for", "100ms", "--json")
    found = json.loads(done.stdout)
    assert list(found) == ["session", "flow", "seconds", "sources", "sinks", "error"]
    assert (found["flow"], found["error"]) == ("live", None)
    assert re.fullmatch(r"live-\d{8}T\d{6}\.\d{6}Z", found["session"])
