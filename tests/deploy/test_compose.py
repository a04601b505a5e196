import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML

from connectors.mqtt.broker import CA, CERTIFICATE
from flows.graph.loading import load
from flows.graph.validation import problems
from tests.deploy.shipped import DEPLOY

FILES = ("compose.yaml", "compose.fingertip.yaml", "compose.tls.yaml")


def read(name: str) -> Any:  # noqa: ANN401 - YAML
    parser: Any = YAML(typ="safe")
    return parser.load(DEPLOY / name)


def judge(path: Path) -> subprocess.CompletedProcess[str]:
    """Hold a file against the schema of the compose specification."""
    words = ["-m", "check_jsonschema", "--builtin-schema", "vendor.compose-spec", str(path)]
    return subprocess.run([sys.executable, *words], capture_output=True, text=True, check=False)


@pytest.mark.parametrize("name", FILES)
def test_a_compose_file_satisfies_the_schema_of_the_specification(name: str) -> None:
    done = judge(DEPLOY / name)
    assert done.returncode == 0, done.stdout


def test_the_schema_rejects_a_misspelt_key(tmp_path: Path) -> None:
    broken = tmp_path / "compose.yaml"
    broken.write_text((DEPLOY / "compose.yaml").read_text().replace("stop_grace_period", "stop_grace_time"))
    done = judge(broken)
    assert done.returncode == 1
    assert "stop_grace_time" in done.stdout


@pytest.mark.parametrize("name", FILES[:2])
def test_the_recorder_sets_existing_parameters_of_its_flow(name: str) -> None:
    run, file, *settings = read(name)["services"]["recorder"]["command"]
    assert (run, file) == ("run", "/opt/slipflow/fingertip.py")
    assert {"--metrics=0.0.0.0:9464", "--log=json"} <= set(settings)
    settings = [each for each in settings if each.startswith("--set=")]
    values = dict(setting.removeprefix("--set=").split("=", 1) for setting in settings)
    values["broker"] = re.sub(
        r"\$\{\w+:-(.*)\}", r"\1", values["broker"]
    )  # as compose does without the variable
    flow = load(str(DEPLOY / "fingertip.py")).flow(values)
    assert problems(flow) == []
    assert {"Mqtt", "Dataset"} <= {type(node.part).__name__ for node in flow.sinks()}


def test_no_port_is_public_and_no_container_is_privileged() -> None:
    services = read("compose.yaml")["services"]
    for name, service in services.items():
        assert all(port.startswith("127.0.0.1:") for port in service.get("ports", ())), name
        assert service["read_only"], name
        assert service["cap_drop"] == ["ALL"], name
        assert service["security_opt"] == ["no-new-privileges:true"], name


def test_mounted_files_are_shipped_or_passwords() -> None:
    compose = read("compose.yaml")
    mounts = [each for service in compose["services"].values() for each in service["volumes"]]
    sources = {mount.split(":")[0] for mount in mounts} - set(compose["volumes"])
    secrets = {secret["file"] for secret in compose["secrets"].values()}
    missing = {source for source in {*sources, *secrets} if not (DEPLOY / source).exists()}
    assert missing <= {"./mosquitto/passwords", "./mosquitto/fingertip.password", "./metrics.token"}
    assert {"./mosquitto/mosquitto.conf", "./mosquitto/acl"} <= sources


def test_the_certificates_reach_broker_and_recorder() -> None:
    compose, page = read("compose.tls.yaml"), (DEPLOY.parent / "docs" / "how-to" / "deploy.md").read_text()
    assert "export BROKER=mqtts://broker\n" in page
    mounted = dict(mount.split(":")[:2] for mount in compose["services"]["broker"]["volumes"])
    tls = (DEPLOY / "mosquitto" / "tls.conf").read_text()
    for place in re.findall(r"^\w+file (\S+)$", tls, re.MULTILINE):
        assert place in mounted.values()
    environment = compose["services"]["recorder"]["environment"]
    assert environment == {CA: "/run/secrets/ca", CERTIFICATE: "/run/secrets/certificate"}
    files = {*mounted, *(secret["file"] for secret in compose["secrets"].values())}
    ignored = (DEPLOY / ".gitignore").read_text().split()
    for file in files:
        assert any(file.startswith(f".{each}") for each in ignored), file


def test_mounts_match_the_brokers_configuration() -> None:
    conf = (DEPLOY / "mosquitto" / "mosquitto.conf").read_text()
    places = {mount.split(":")[1] for mount in read("compose.yaml")["services"]["broker"]["volumes"]}
    for option in ("password_file", "acl_file", "persistence_location"):
        [place] = [line.split()[1] for line in conf.splitlines() if line.startswith(f"{option} ")]
        assert place.rstrip("/") in places


def test_the_health_check_of_the_recorder_asks_its_own_server() -> None:
    recorder = read("compose.yaml")["services"]["recorder"]
    [port] = [word.rpartition(":")[2] for word in recorder["command"] if word.startswith("--metrics=")]
    assert f"http://127.0.0.1:{port}/readyz" in recorder["healthcheck"]["test"][-1]
    assert recorder["environment"]["SLIPFLOW_PAGE_TOKEN_FILE"] == "/run/secrets/metrics"  # noqa: S105 - a path
