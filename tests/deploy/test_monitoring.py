"""Prometheus and Grafana files: tools load them as shipped, and every metric that they use exists."""

import asyncio
import json
import os
import re
import shutil
import sys
from pathlib import Path
from typing import Any

import pytest
from prometheus_client.parser import text_string_to_metric_families
from ruamel.yaml import YAML

from operators.batch import s
from operators.health import FaultKind
from operators.ports import ClockStep, Run, SinkStatus, SourceStatus
from tests.command import captured
from tests.connectors.web.reading import fault, scored, served, slip
from tests.deploy.shipped import DEPLOY, PAGE

RULES = DEPLOY / "prometheus" / "alerts.yml"
SCRAPES = DEPLOY / "prometheus" / "prometheus.yml"
DASHBOARD = (DEPLOY / "grafana" / "slipflow.json").read_text()


def samples(run: Run) -> dict[str, set[str]]:
    """Return the labels of each sample name that a run serves."""
    run.sources["touch"] = SourceStatus(newest=s, up=True)
    run.sinks["dataset"] = SinkStatus(waiting=0, connected=True)
    run.clock_steps.append(ClockStep(s, s))
    now = run.clock.now()
    batches = slip(now, 1), scored(now, 1.0), fault(now, 3, FaultKind.STUCK)
    families = text_string_to_metric_families(asyncio.run(served(run, *batches)))
    return {sample.name: set(sample.labels) for family in families for sample in family.samples}


def test_every_metric_and_label_of_rules_and_dashboard_exists(run: Run) -> None:
    served, known = samples(run), {"instance"}.union(*samples(run).values())
    parser: Any = YAML(typ="safe")
    rules = [rule["expr"] for group in parser.load(RULES)["groups"] for rule in group["rules"]]
    panels = json.loads(DASHBOARD)["panels"]
    for expression in (*rules, *(target["expr"] for panel in panels for target in panel["targets"])):
        used = re.findall(r"(slipflow_\w+)(?:\{([^}]*)\})?", expression)
        assert used or expression.startswith("up{")
        assert all({*re.findall(r"(\w+)[!=]", selectors)} <= served[name] for name, selectors in used)
    assert {*re.findall(r"\$labels\.(\w+)", RULES.read_text())} <= known
    assert {*re.findall(r"\{\{(\w+)\}\}", DASHBOARD)} <= known


def promtool(*words: str | Path) -> None:
    program = shutil.which("promtool", path=f"{Path(sys.executable).parent}:{os.environ['PATH']}")
    if program is None:
        pytest.skip("promtool is missing: deploy/prepare test unpacks it on Debian")
    done = captured(program, *words)
    assert done.returncode == 0, done.stdout + done.stderr


def test_an_installation_of_the_rules_keeps_the_token_of_a_machine() -> None:
    [pattern] = re.findall(r"-t /etc/prometheus deploy/prometheus/(\S+)", PAGE)
    assert {path.name for path in SCRAPES.parent.glob(pattern)} == {RULES.name, SCRAPES.name}


def test_promtool_loads_the_configuration_as_shipped() -> None:
    promtool("check", "config", SCRAPES)  # with the rules and the file of the token


def test_prometheus_scrapes_the_port_that_compose_publishes_and_systemd_serves() -> None:
    parser: Any = YAML(typ="safe")
    [job] = parser.load(SCRAPES)["scrape_configs"]
    [target] = [target for each in job["static_configs"] for target in each["targets"]]
    ports = parser.load(DEPLOY / "compose.yaml")["services"]["recorder"]["ports"]
    assert [each.rpartition(":")[0] for each in ports] == [target]
    assert f"--metrics {target.rpartition(':')[2]}" in (DEPLOY / "systemd" / "slipflow.service").read_text()
    assert (SCRAPES.parent / job["authorization"]["credentials_file"]).read_text() == ""


def test_a_missing_broker_waiting_events_and_late_rows_of_fast_sources_raise_alerts(tmp_path: Path) -> None:
    values = {("waiting_rows", "mqtt"): 3, ("unstored_rows", "mqtt"): 1, ("unstored_rows", "dataset"): 4}
    values |= {("connected", "mqtt"): 0, ("connected", "other"): 1}
    series = {
        f'slipflow_sink_{name}{{sink="{sink}", instance="i"}}': f"{count}x60"
        for (name, sink), count in values.items()
    }
    for source, rate in ("touch", 500), ("episodes", 0):
        for metric, value in ("lag_seconds", "5x60"), ("up", "1x60"), ("rows_total", f"0+{rate}x60"):
            series[f'slipflow_source_{metric}{{source="{source}", instance="i"}}'] = value
    waits, late = "3 events for mqtt on i are not acknowledged", "rows of touch on i are 5s old"
    unstored = "1 events for mqtt on i are neither stored nor sent"
    missing = "mqtt on i has no broker that accepts all its messages"
    alerts = (
        ("SlipflowBrokerMissing", {"sink": "mqtt", "severity": "warning"}, missing),
        ("SlipflowEventsWait", {"sink": "mqtt", "severity": "warning"}, waits),
        ("SlipflowEventsUnstored", {"sink": "mqtt", "severity": "critical"}, unstored),
        ("SlipflowRowsLate", {"source": "touch", "severity": "warning"}, late),
    )
    tests: list[dict[str, object]] = []
    for name, labels, summary in alerts:
        alert = {"exp_labels": {**labels, "instance": "i"}, "exp_annotations": {"summary": summary}}
        tests += [
            {"eval_time": time, "alertname": name, "exp_alerts": expected}
            for time, expected in (("30s", []), ("3m", [alert]))
        ]
    inputs = [{"series": name, "values": value} for name, value in series.items()]
    case = {"interval": "5s", "input_series": inputs, "alert_rule_test": tests}
    (tmp_path / "tests.yml").write_text(json.dumps({"rule_files": [str(RULES)], "tests": [case]}))
    promtool("test", "rules", tmp_path / "tests.yml")
