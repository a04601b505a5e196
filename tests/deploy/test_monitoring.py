"""Alert rules and dashboard: every metric that they use exists."""

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from grafana_foundation_sdk.cog.encoder import JSONEncoder
from grafana_foundation_sdk.cog.plugins import register_default_plugins
from grafana_foundation_sdk.models.dashboard import Dashboard
from prometheus_client.parser import text_string_to_metric_families
from ruamel.yaml import YAML

from connectors.web.run_metrics import RunMetrics
from operators.batch import Clocks, Faults, Scores, Slips, s
from operators.health import FaultKind
from operators.ports import ClockStep, Run, SinkStatus, SourceStatus
from tests.deploy.shipped import DEPLOY

RULES = DEPLOY / "prometheus" / "alerts.yml"
DASHBOARD = DEPLOY / "grafana" / "slipflow.json"


def leaves(data: object, path: str = "") -> Iterator[tuple[str, object]]:
    """Yield the values of a JSON document with their paths."""
    if isinstance(data, dict):
        for key, value in cast("dict[str, object]", data).items():
            yield from leaves(value, f"{path}/{key}")
    elif isinstance(data, list):
        for n, value in enumerate(cast("list[object]", data)):
            yield from leaves(value, f"{path}/{n}")
    else:
        yield path, data


def unknown_to_grafana(text: str) -> set[str]:
    """Return the paths of values of a dashboard that the types of Grafana's schema do not keep."""
    data = json.loads(text)
    kept = json.loads(JSONEncoder().encode(Dashboard.from_json(data)))
    return {path for path, _ in set(leaves(data)) - set(leaves(kept))}


def samples(run: Run) -> dict[str, set[str]]:
    """Return the labels of each sample name that a run serves."""
    run.sources["touch"], run.sinks["dataset"] = SourceStatus(newest=s, up=True), SinkStatus(waiting=0)
    run.clock_steps.append(ClockStep(s, s))
    metrics, time = RunMetrics(run), np.array([run.clock.now()])
    one = np.ones(1)
    metrics.add(Slips(time, np.array([1], np.int8), time, one, finger=0))
    metrics.add(Scores(time, one, finger=0))
    cell, kind = np.array([3], np.int8), np.array([FaultKind.STUCK], np.int8)
    metrics.add(Faults(time, cell, kind, np.array([True]), finger=0))
    metrics.add(Clocks(time, np.array([s]), one, np.array([s]), finger=0))
    return {
        sample.name: set(sample.labels)
        for family in text_string_to_metric_families(metrics.text().decode())
        for sample in family.samples
    }


def expressions() -> list[str]:
    parser: Any = YAML(typ="safe")
    rules = [rule["expr"] for group in parser.load(RULES)["groups"] for rule in group["rules"]]
    panels = json.loads(DASHBOARD.read_text())["panels"]
    return [*rules, *(target["expr"] for panel in panels for target in panel["targets"])]


@pytest.mark.parametrize("expression", expressions())
def test_every_metric_and_label_of_an_expression_exists(expression: str, run: Run) -> None:
    served = samples(run)
    used = re.findall(r"(slipflow_\w+)(?:\{([^}]*)\})?", expression)
    assert used or expression.startswith("up{")
    for name, selectors in used:
        assert name in served
        assert set(re.findall(r"(\w+)[!=]", selectors)) <= served[name]


def test_the_labels_of_texts_exist(run: Run) -> None:
    known = {label for labels in samples(run).values() for label in labels} | {"instance"}
    assert set(re.findall(r"\$labels\.(\w+)", RULES.read_text())) <= known
    assert set(re.findall(r"\{\{(\w+)\}\}", DASHBOARD.read_text())) <= known


def test_grafana_s_schema_has_all_fields_of_the_dashboard() -> None:
    register_default_plugins()
    text = DASHBOARD.read_text()
    assert unknown_to_grafana(text) == set()
    for right, wrong in (("gridPos", "gridpos"), ("expr", "expression"), ("refresh", "reload")):
        assert f'"{right}"' in text
        found = unknown_to_grafana(text.replace(f'"{right}"', f'"{wrong}"'))
        assert found
        assert all(f"/{wrong}" in path for path in found)


def test_every_panel_reads_the_chosen_data_source() -> None:
    dashboard = json.loads(DASHBOARD.read_text())
    assert [each["type"] for each in dashboard["templating"]["list"]] == ["datasource"]
    source = {"type": "prometheus", "uid": "${datasource}"}
    assert all(panel["datasource"] == source for panel in dashboard["panels"])


def test_panels_do_not_overlap_and_have_unique_numbers() -> None:
    panels = json.loads(DASHBOARD.read_text())["panels"]
    assert len({panel["id"] for panel in panels}) == len(panels)
    assert len({(panel["gridPos"]["x"], panel["gridPos"]["y"]) for panel in panels}) == len(panels)


def promtool(*words: str | Path) -> subprocess.CompletedProcess[str]:
    program = shutil.which("promtool", path=f"{Path(sys.executable).parent}:{os.environ['PATH']}")
    if program is None:
        pytest.skip("promtool is missing: deploy/prepare test unpacks it on Debian")
    return subprocess.run([program, *words], capture_output=True, text=True, check=False)


def test_promtool_accepts_the_rules_and_the_scrape_configuration() -> None:
    for words in (("rules", RULES), ("config", "--syntax-only", RULES.with_name("prometheus.yml"))):
        done = promtool("check", *words)
        assert done.returncode == 0, done.stdout + done.stderr


def test_events_that_wait_raise_an_alert_and_rows_of_a_recorder_none(tmp_path: Path) -> None:
    series = {
        'slipflow_sink_waiting_rows{sink="mqtt", instance="i"}': "3x60",
        'slipflow_sink_unstored_rows{sink="mqtt", instance="i"}': "1x60",
        'slipflow_sink_unstored_rows{sink="dataset", instance="i"}': "4x60",
    }
    expected = {
        "SlipflowEventsWait": ("warning", "3 events for mqtt on i are not acknowledged"),
        "SlipflowEventsUnstored": ("critical", "1 events for mqtt on i are neither stored nor sent"),
    }
    tests = [
        {
            "eval_time": "3m",
            "alertname": name,
            "exp_alerts": [
                {
                    "exp_labels": {"sink": "mqtt", "instance": "i", "severity": severity},
                    "exp_annotations": {"summary": summary},
                }
            ],
        }
        for name, (severity, summary) in expected.items()
    ]
    early: list[dict[str, Any]] = [
        {"eval_time": "30s", "alertname": name, "exp_alerts": []} for name in expected
    ]
    inputs = [{"series": name, "values": values} for name, values in series.items()]
    check_alerts(tmp_path, {"interval": "5s", "input_series": inputs, "alert_rule_test": early + tests})


def check_alerts(folder: Path, case: dict[str, Any]) -> None:
    """Run a test case of promtool on the rules."""
    file = folder / "tests.yml"
    file.write_text(json.dumps({"rule_files": [str(RULES)], "tests": [case]}))  # JSON is YAML
    done = promtool("test", "rules", file)
    assert done.returncode == 0, done.stdout + done.stderr


def test_late_rows_raise_an_alert_only_for_sources_with_frequent_rows(tmp_path: Path) -> None:
    series = [
        (f'slipflow_source_{metric}{{source="{source}", instance="i"}}', f"{start}+{step}x30")
        for source, rate in (("touch", 500), ("episodes", 0))
        for metric, start, step in (("lag_seconds", 5, 0), ("up", 1, 0), ("rows_total", 0, rate))
    ]
    labels = {"source": "touch", "instance": "i", "severity": "warning"}
    summary = "rows of touch on i are 5s old"
    case = {
        "interval": "5s",
        "input_series": [{"series": name, "values": values} for name, values in series],
        "alert_rule_test": [
            {
                "eval_time": "2m",
                "alertname": "SlipflowRowsLate",
                "exp_alerts": [{"exp_labels": labels, "exp_annotations": {"summary": summary}}],
            }
        ],
    }
    check_alerts(tmp_path, case)
