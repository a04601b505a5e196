import subprocess
import sys
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML

from tests.deploy.shipped import DEPLOY

COMPOSE, KUBERNETES = DEPLOY / "dask" / "compose.yaml", DEPLOY / "dask" / "kubernetes.yaml"


def read(path: Path) -> list[Any]:
    parser: Any = YAML(typ="safe")
    return list(parser.load_all(path))


def judged(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-m", *words], capture_output=True, text=True, check=False)


def commands() -> list[list[str]]:
    """The command lines of scheduler and workers."""
    services = read(COMPOSE)[0]["services"]
    pods = [each["spec"]["template"]["spec"] for each in read(KUBERNETES) if each["kind"] == "Deployment"]
    found = [services[name]["entrypoint"] for name in ("scheduler", "worker")]
    return [*found, *(container["command"] for pod in pods for container in pod["containers"])]


def test_the_compose_file_satisfies_the_schema_of_the_specification() -> None:
    done = judged("check_jsonschema", "--builtin-schema", "vendor.compose-spec", str(COMPOSE))
    assert done.returncode == 0, done.stdout


def test_the_kubernetes_file_satisfies_its_schemas() -> None:
    done = judged("kubernetes_validate", "--strict", "--kubernetes-version", "1.30", str(KUBERNETES))
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count("passed for resource") == len(read(KUBERNETES))


def test_both_files_start_the_same_processes_with_options_that_dask_has() -> None:
    scheduler, worker, *others = commands()
    assert others == [scheduler, worker]
    for command in (scheduler, worker):
        assert command[0] == "dask"
        helped = judged("dask", command[1], "--help").stdout
        assert [word for word in command if word.startswith("--") and word not in helped] == []


def test_only_this_machine_can_reach_the_cluster_and_only_to_see_its_dashboard() -> None:
    published = {name: each.get("ports", []) for name, each in read(COMPOSE)[0]["services"].items()}
    assert published == {"scheduler": ["127.0.0.1:8787:8787"], "worker": [], "slipflow": []}
    [policy] = [each["spec"] for each in read(KUBERNETES) if each["kind"] == "NetworkPolicy"]
    assert policy["ingress"] == [{"from": [{"podSelector": policy["podSelector"]}]}]


def test_all_containers_are_unprivileged_and_share_the_recordings() -> None:
    for each in read(COMPOSE)[0]["services"].values():
        assert (each["read_only"], each["cap_drop"]) == (True, ["ALL"])
        assert "recordings:/recordings" in each["volumes"]
    for each in (each for each in read(KUBERNETES) if each["kind"] == "Deployment"):
        pod = each["spec"]["template"]["spec"]
        assert pod["securityContext"]["runAsNonRoot"]
        [container] = pod["containers"]
        assert container["securityContext"]["readOnlyRootFilesystem"]
        assert {"name": "recordings", "mountPath": "/recordings"} in container["volumeMounts"]
