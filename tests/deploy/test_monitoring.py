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


def test_every_metric_and_label_of_rules_and_dashboard_exists(run: Run) -> None:
    served, known = samples(run), {"instance"}.union(*samples(run).values())
    parser: Any = YAML(typ="safe")
    rules = [rule["expr"] for group in parser.load(RULES)["groups"] for rule in group["rules"]]
    panels = json.loads(DASHBOARD.read_text())["panels"]
    expressions = [*rules, *(target["expr"] for panel in panels for target in panel["targets"])]
    for expression in expressions:
        used = re.findall(r"(slipflow_\w+)(?:\{([^}]*)\})?", expression)
        assert used or expression.startswith("up{")
        assert all({*re.findall(r"(\w+)[!=]", selectors)} <= served[name] for name, selectors in used)
    assert {*re.findall(r"\$labels\.(\w+)", RULES.read_text())} <= known
    assert {*re.findall(r"\{\{(\w+)\}\}", DASHBOARD.read_text())} <= known


def test_grafana_s_schema_has_all_fields_of_the_dashboard() -> None:
    register_default_plugins()
    text = DASHBOARD.read_text()
    assert unknown_to_grafana(text) == set()
    assert unknown_to_grafana(text.replace('"expr"', '"expression"'))
    panels = json.loads(text)["panels"]
    assert all(panel["datasource"]["uid"] == "${datasource}" for panel in panels)
    assert len({panel["id"] for panel in panels}) == len(panels)
    assert len({(panel["gridPos"]["x"], panel["gridPos"]["y"]) for panel in panels}) == len(panels)


def promtool(*words: str | Path) -> None:
    program = shutil.which("promtool", path=f"{Path(sys.executable).parent}:{os.environ['PATH']}")
    if program is None:
        pytest.skip("promtool is missing: deploy/prepare test unpacks it on Debian")
    done = subprocess.run([program, *words], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_promtool_accepts_the_rules_and_the_scrape_configuration() -> None:
    promtool("check", "rules", RULES)
    promtool("check", "config", "--syntax-only", RULES.with_name("prometheus.yml"))


def test_events_that_wait_and_late_rows_of_frequent_sources_raise_alerts(tmp_path: Path) -> None:
    series = {
        'slipflow_sink_waiting_rows{sink="mqtt", instance="i"}': "3x60",
        'slipflow_sink_unstored_rows{sink="mqtt", instance="i"}': "1x60",
        'slipflow_sink_unstored_rows{sink="dataset", instance="i"}': "4x60",
    }
    for source, rate in ("touch", 500), ("episodes", 0):
        for metric, values in ("lag_seconds", "5x60"), ("up", "1x60"), ("rows_total", f"0+{rate}x60"):
            series[f'slipflow_source_{metric}{{source="{source}", instance="i"}}'] = values
    alerts = {
        "SlipflowEventsWait": ("sink", "mqtt", "warning", "3 events for mqtt on i are not acknowledged"),
        "SlipflowEventsUnstored": (
            "sink",
            "mqtt",
            "critical",
            "1 events for mqtt on i are neither stored nor sent",
        ),
        "SlipflowRowsLate": ("source", "touch", "warning", "rows of touch on i are 5s old"),
    }
    tests = [{"eval_time": "30s", "alertname": name, "exp_alerts": list[object]()} for name in alerts]
    for name, (kind, who, severity, summary) in alerts.items():
        labels = {kind: who, "instance": "i", "severity": severity}
        alert = {"exp_labels": labels, "exp_annotations": {"summary": summary}}
        tests.append({"eval_time": "3m", "alertname": name, "exp_alerts": [alert]})
    inputs = [{"series": name, "values": values} for name, values in series.items()]
    case = {"interval": "5s", "input_series": inputs, "alert_rule_test": tests}
    (tmp_path / "tests.yml").write_text(json.dumps({"rule_files": [str(RULES)], "tests": [case]}))
    promtool("test", "rules", tmp_path / "tests.yml")
