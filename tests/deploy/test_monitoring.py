"""Alert rules and dashboard: every metric that they use exists."""

import json
import re
import shutil
import subprocess
from typing import Any

import numpy as np
import pytest
from jsonschema import Draft202012Validator, ValidationError, validate
from prometheus_client.parser import text_string_to_metric_families
from ruamel.yaml import YAML

from connectors.web.run_metrics import RunMetrics
from operators.batch import Clocks, Faults, Scores, Slips, s
from operators.health import FaultKind
from operators.ports import ClockStep, Run, SinkStatus, SourceStatus
from tests.deploy.shipped import DEPLOY

RULES = DEPLOY / "prometheus" / "alerts.yml"
DASHBOARD = DEPLOY / "grafana" / "slipflow.json"


def closed(required: str, **properties: Any) -> dict[str, Any]:  # noqa: ANN401 - JSON
    """An object with these properties only, some required."""
    return {
        "type": "object",
        "required": required.split(),
        "properties": properties,
        "additionalProperties": False,
    }


TEXT = {"type": "string", "minLength": 1}
# fields of https://grafana.com/docs/grafana/latest/dashboards/build-dashboards/view-dashboard-json-model/
DATASOURCE = closed("type uid", type={"const": "prometheus"}, uid={"const": "${datasource}"})
GRID = {name: {"type": "integer", "minimum": 0, "maximum": 24} for name in "xwh"} | {"y": {"type": "integer"}}
PANEL = closed(
    "id title type datasource gridPos fieldConfig targets",
    id={"type": "integer", "minimum": 1},
    title=TEXT,
    type={"enum": ["timeseries", "state-timeline", "stat", "table", "gauge", "bargauge"]},
    datasource=DATASOURCE,
    gridPos=closed("x y w h", **GRID),
    fieldConfig=closed("defaults overrides", defaults={"type": "object"}, overrides={"type": "array"}),
    options={"type": "object"},
    targets={
        "type": "array",
        "minItems": 1,
        "items": closed("refId expr", refId=TEXT, expr=TEXT, legendFormat=TEXT, instant={"type": "boolean"}),
    },
)
DASHBOARD_SCHEMA = closed(
    "title uid schemaVersion time panels templating",
    title=TEXT,
    uid={"type": "string", "pattern": "^[\\w-]{1,40}$"},
    schemaVersion={"type": "integer", "minimum": 39},
    tags={"type": "array", "items": TEXT},
    timezone={"enum": ["utc", "browser", ""]},
    refresh={"type": "string", "pattern": "^[0-9]+[smh]$"},
    time=closed("from to", **{"from": TEXT, "to": TEXT}),
    templating=closed(
        "list",
        list={
            "type": "array",
            "items": closed("name type query", name=TEXT, type={"const": "datasource"}, query=TEXT),
        },
    ),
    panels={"type": "array", "minItems": 1, "items": PANEL},
)


def samples(run: Run) -> dict[str, set[str]]:
    """Return the labels of each sample name that a run serves."""
    run.sources["touch"], run.sinks["dataset"] = SourceStatus(newest=s, up=True), SinkStatus()
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


def test_the_dashboard_has_the_structure_that_grafana_reads() -> None:
    validate(json.loads(DASHBOARD.read_text()), DASHBOARD_SCHEMA, Draft202012Validator)
    broken = DASHBOARD.read_text().replace('"fieldConfig"', '"fieldconfig"')
    with pytest.raises(ValidationError, match="fieldconfig"):
        validate(json.loads(broken), DASHBOARD_SCHEMA, Draft202012Validator)


def test_panels_do_not_overlap_and_have_unique_numbers() -> None:
    panels = json.loads(DASHBOARD.read_text())["panels"]
    assert len({panel["id"] for panel in panels}) == len(panels)
    assert len({(panel["gridPos"]["x"], panel["gridPos"]["y"]) for panel in panels}) == len(panels)


def test_promtool_accepts_the_rules_and_the_scrape_configuration() -> None:
    promtool = shutil.which("promtool")
    if promtool is None:
        pytest.skip("promtool is not installed: apt-get install prometheus")
    for words in (("rules", RULES), ("config", "--syntax-only", RULES.with_name("prometheus.yml"))):
        done = subprocess.run([promtool, "check", *words], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stdout + done.stderr
