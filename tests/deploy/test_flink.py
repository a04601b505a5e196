import re
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML

from tests.deploy.shipped import DEPLOY

ROOT, FLINK = DEPLOY.parent, DEPLOY / "flink"
COMPOSE, KUBERNETES, DOCKERFILE = FLINK / "compose.yaml", FLINK / "kubernetes.yaml", FLINK / "Dockerfile"
TEXT = DOCKERFILE.read_text()
STEPS = [line for line in re.sub(r"\\\n\s*", "", TEXT).splitlines() if line and not line.startswith("#")]
LAST = STEPS[max(n for n, step in enumerate(STEPS) if step.startswith("FROM")) :]


def read(path: Path) -> list[Any]:
    parser: Any = YAML(typ="safe")
    return list(parser.load_all(path))


def judged(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-m", *words], capture_output=True, text=True, check=False)


def compose_judged(path: Path) -> subprocess.CompletedProcess[str]:
    return judged("check_jsonschema", "--builtin-schema", "vendor.compose-spec", str(path))


def kubernetes_judged(path: Path) -> subprocess.CompletedProcess[str]:
    return judged("kubernetes_validate", "--strict", "--kubernetes-version", "1.30", str(path))


def pods() -> dict[str, Any]:
    return {
        each["metadata"]["name"]: each["spec"]["template"]["spec"]
        for each in read(KUBERNETES)
        if each["kind"] == "Deployment"
    }


def test_the_compose_file_satisfies_the_schema_of_the_specification() -> None:
    done = compose_judged(COMPOSE)
    assert done.returncode == 0, done.stdout


def test_the_schema_rejects_a_misspelt_service_key(tmp_path: Path) -> None:
    broken = tmp_path / "compose.yaml"
    broken.write_text(COMPOSE.read_text().replace("mem_limit", "memory_limit"))
    assert "memory_limit" in compose_judged(broken).stdout


def test_the_kubernetes_file_satisfies_its_schemas() -> None:
    done = kubernetes_judged(KUBERNETES)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count("passed for resource") == len(read(KUBERNETES))


@pytest.mark.parametrize(
    ("right", "wrong"), [("runAsNonRoot:", "runAsNonroot:"), ("periodSeconds: 2", "periodSeconds: two")]
)
def test_the_schemas_reject_misspelt_keys_and_wrong_types(right: str, wrong: str, tmp_path: Path) -> None:
    broken = tmp_path / "kubernetes.yaml"
    broken.write_text(KUBERNETES.read_text().replace(right, wrong))
    assert kubernetes_judged(broken).returncode == 1


def test_hadolint_finds_nothing_in_the_dockerfile() -> None:
    program = Path(sys.executable).with_name("hadolint")
    done = subprocess.run([program, "-t", "style", DOCKERFILE], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_the_image_has_java_17_and_a_pinned_supported_python() -> None:
    images = [step.split()[1] for step in STEPS if step.startswith("FROM")]
    assert [re.sub(r"-slim", "", image) for image in images] == ["python:3.11.13-bookworm"] * 2
    assert any("openjdk-17-jre-headless" in step for step in LAST)


def test_every_package_is_installed_by_its_hash() -> None:
    installs = [part for step in STEPS for part in step.split("&&") if "pip install" in part]
    *packages, ours = installs
    assert len(packages) == 2
    assert all("--require-hashes" in each for each in packages)
    assert "--no-deps /wheels/slipflow-" in ours
    pins = (FLINK / "requirements.txt").read_text().replace("\\\n", "").splitlines()[1:]
    assert [
        pin for pin in pins if not re.fullmatch(r"[\w.-]+==\S+( +--hash=sha256:[0-9a-f]{64})+", pin)
    ] == []


def test_the_image_has_the_same_flink_as_one_machine_and_all_dependencies() -> None:
    pins = [line.split()[0] for line in (FLINK / "requirements.txt").read_text().splitlines() if "==" in line]
    [flink] = re.findall(r"apache-flink==\S+", (DEPLOY / "cluster").read_text())
    assert flink in pins
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    wanted = {re.split(r"[<>=~!]", each)[0].lower() for each in project["dependencies"]}
    assert wanted <= {pin.split("==")[0] for pin in pins}


def test_the_image_runs_unprivileged_without_installers() -> None:
    assert not [step for step in LAST if re.search(r"\b(pip|gcc|curl)\b", step)]
    assert [step for step in LAST if step.startswith("USER")] == ["USER 10001:10001"]


def test_the_build_context_has_the_copied_files() -> None:
    sent = (FLINK / "Dockerfile.dockerignore").read_text().splitlines()
    steps = [step for step in STEPS if step.startswith("COPY") and "--from" not in step]
    copied = [source for step in steps for source in step.split()[1:-1]]
    assert "*" in sent
    assert sorted(copied) == sorted(line[1:] for line in sent if line.startswith("!"))
    assert [source for source in copied if not (ROOT / source).exists()] == []


def test_name_and_ports_of_the_job_manager_match() -> None:
    [settings] = read(FLINK / "config.yaml")
    manager, server = settings["jobmanager"]["rpc"], settings["blob"]["server"]
    ports = {"rpc": manager["port"], "blob": server["port"], "rest": settings["rest"]["port"]}
    assert manager["address"] == settings["rest"]["address"] == "jobmanager"
    assert manager["address"] in read(COMPOSE)[0]["services"]
    [service] = [each for each in read(KUBERNETES) if each["kind"] == "Service"]
    assert service["metadata"]["name"] == manager["address"]
    assert {each["name"]: each["port"] for each in service["spec"]["ports"]} == ports
    [container] = pods()["jobmanager"]["containers"]
    metrics = settings["metrics"]["reporter"]["prometheus"]["port"]
    named = {each["name"]: each["containerPort"] for each in container["ports"]}
    assert named == ports | {"metrics": metrics}
    [container] = pods()["taskmanager"]["containers"]
    named = {each["name"]: each["containerPort"] for each in container["ports"]}
    assert named == {"rpc": settings["taskmanager"]["rpc"]["port"], "metrics": metrics}


def test_prometheus_may_scrape_the_metrics_of_every_process() -> None:
    [settings] = read(FLINK / "config.yaml")
    port = settings["metrics"]["reporter"]["prometheus"]["port"]
    [scrape] = read(DEPLOY / "prometheus" / "prometheus.yml")
    [job] = [each for each in scrape["scrape_configs"] if each["job_name"] == "flink"]
    [names] = job["dns_sd_configs"]
    assert set(names["names"]) == read(COMPOSE)[0]["services"].keys()
    assert names["port"] == port
    [policy] = [each["spec"] for each in read(KUBERNETES) if each["kind"] == "NetworkPolicy"]
    assert policy["ingress"][1]["ports"] == [{"port": port}]


def test_the_cluster_of_one_machine_opens_no_port_for_metrics() -> None:
    """Flink's reporter would listen on all addresses; its REST API has the same figures."""
    assert "metrics" not in read(DEPLOY / "cluster.yaml")[0]


@pytest.mark.parametrize("folder", ["flink/Dockerfile", "cluster"])
def test_flink_logs_json(folder: str) -> None:
    assert re.search(r"sed -i -f \S*json_logs.sed \S*/log4j", (DEPLOY / folder).read_text())
    properties = "appender.main.layout.type = PatternLayout\nappender.main.layout.pattern = %d - %m%n\n"
    script = FLINK / "json_logs.sed"
    done = subprocess.run(["sed", "-f", script], input=properties, capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == [
        "appender.main.layout.type = JsonTemplateLayout",
        "appender.main.layout.eventTemplateUri = classpath:EcsLayout.json",
    ]


def test_selectors_match_the_pods() -> None:
    documents = read(KUBERNETES)
    [service] = [each for each in documents if each["kind"] == "Service"]
    labels = {
        each["metadata"]["name"]: each["spec"]["template"]["metadata"]["labels"]
        for each in documents
        if each["kind"] == "Deployment"
    }
    wanted = service["spec"]["selector"].items()
    assert [name for name, own in labels.items() if wanted <= own.items()] == ["jobmanager"]
    for each in documents:
        if each["kind"] == "Deployment":
            assert each["spec"]["selector"]["matchLabels"] == labels[each["metadata"]["name"]]


def test_recordings_and_checkpoints_are_on_the_shared_volume() -> None:
    [settings] = read(FLINK / "config.yaml")
    assert settings["execution"]["checkpointing"]["dir"].startswith("file:///data/")
    [compose] = read(COMPOSE)
    assert all(service["volumes"] == ["data:/data"] for service in compose["services"].values())
    [claim] = [each for each in read(KUBERNETES) if each["kind"] == "PersistentVolumeClaim"]
    assert claim["spec"]["accessModes"] == ["ReadWriteMany"]
    for pod in pods().values():
        assert pod["volumes"][0]["persistentVolumeClaim"]["claimName"] == claim["metadata"]["name"]
        assert {"name": "data", "mountPath": "/data"} in pod["containers"][0]["volumeMounts"]


def test_the_job_manager_is_not_reachable_from_outside() -> None:
    services = read(COMPOSE)[0]["services"]
    assert all(port.startswith("127.0.0.1:") for each in services.values() for port in each.get("ports", ()))
    documents = read(KUBERNETES)
    [service] = [each for each in documents if each["kind"] == "Service"]
    assert "type" not in service["spec"]  # it has an address inside only
    [policy] = [each["spec"] for each in documents if each["kind"] == "NetworkPolicy"]
    everyone = policy["podSelector"]
    assert policy["ingress"][0] == {"from": [{"podSelector": everyone}]}
    assert all("ports" in each for each in policy["ingress"][1:])
    assert [each for each in documents if each["kind"] == "Deployment"
            and not everyone["matchLabels"].items() <= each["spec"]["template"]["metadata"]["labels"].items()
            ] == []  # fmt: skip


def test_containers_are_unprivileged_and_have_probes() -> None:
    for name, service in read(COMPOSE)[0]["services"].items():
        assert service["read_only"], name
        assert service["cap_drop"] == ["ALL"], name
        assert service["security_opt"] == ["no-new-privileges:true"], name
        assert {"healthcheck", "mem_limit", "pids_limit"} <= service.keys(), name
    for name, pod in pods().items():
        [container], own = pod["containers"], pod["securityContext"]
        assert (own["runAsNonRoot"], own["runAsUser"], pod["automountServiceAccountToken"]) == (
            True,
            10001,
            False,
        )
        assert container["securityContext"] == {
            "allowPrivilegeEscalation": False,
            "readOnlyRootFilesystem": True,
            "capabilities": {"drop": ["ALL"]},
        }, name
        assert {"startupProbe", "livenessProbe"} <= container.keys(), name
        assert {"requests", "limits"} == container["resources"].keys(), name
