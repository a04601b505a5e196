"""Compose files, Dockerfile, systemd unit and pins: tools accept them, and they fit the product."""

import json
import os
import re
import shlex
import subprocess
import sys
import time
import tomllib
from pathlib import Path
from typing import Any

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from ruamel.yaml import YAML

from connectors.mqtt.broker import CA, CERTIFICATE, PASSWORD_FILE
from flows.graph.loading import load
from flows.graph.validation import problems
from flows.run.live_runner import CHECK_INTERVAL
from tests.command import captured
from tests.deploy.shipped import DEPLOY, LEFT_OUT, PAGE

COMPOSE = ("compose.yaml", "compose.fingertip.yaml", "compose.tls.yaml", "dask/compose.yaml")
KUBERNETES = "dask/kubernetes.yaml"
STEPS = [
    step
    for step in re.sub(r"\\\n\s*", "", (DEPLOY / "Dockerfile").read_text()).splitlines()
    if step and not step.startswith("#")
]
UNIT = (DEPLOY / "systemd" / "slipflow.service").read_text()
TLS = (DEPLOY / "systemd" / "tls.conf").read_text()
EXPOSURE = 1.6  # of 10, as systemd 252 counts; it was 1.5


def without_tags(name: str) -> str:
    """Return a file without the tag of Compose, which other parsers of YAML reject."""
    return (DEPLOY / name).read_text().replace(" !override", "")


def read_all(name: str) -> list[Any]:
    parser: Any = YAML(typ="safe")
    return list(parser.load_all(without_tags(name)))


def read(name: str) -> Any:
    return read_all(name)[0]


def run(*words: str | Path) -> tuple[int, str]:
    done = captured(*words)
    return done.returncode, done.stdout + done.stderr


def run_module(*words: str | Path) -> tuple[int, str]:
    return run(sys.executable, "-m", *words)


def accepts(settings: dict[str, str]) -> bool:
    """Return True if the shipped flow has these parameters and is valid."""
    return not problems(load(str(DEPLOY / "fingertip.py")).flow(settings))


@pytest.mark.parametrize("name", COMPOSE)
def test_a_compose_file_satisfies_the_schema_of_the_specification(name: str, tmp_path: Path) -> None:
    file = tmp_path / "compose.yaml"
    file.write_text(without_tags(name))
    code, output = run_module("check_jsonschema", "--builtin-schema", "vendor.compose-spec", file)
    assert code == 0, output


def test_the_kubernetes_file_satisfies_its_schemas() -> None:
    words = "kubernetes_validate", "--strict", "--kubernetes-version", "1.30", DEPLOY / KUBERNETES
    code, output = run_module(*words)
    assert (code, output.count("passed for resource")) == (0, len(read_all(KUBERNETES))), output


def test_compose_and_kubernetes_start_the_same_processes_of_dask_with_existing_options() -> None:
    services = read("dask/compose.yaml")["services"]
    pods = [each["spec"]["template"]["spec"] for each in read_all(KUBERNETES) if each["kind"] == "Deployment"]
    commands = [services[name]["entrypoint"] for name in ("scheduler", "worker")]
    assert commands == [container["command"] for pod in pods for container in pod["containers"]]
    for program, command, *options in commands:
        helped = run_module(program, command, "--help")[1]
        assert [word for word in options if word.startswith("--") and word not in helped] == []


def test_only_this_machine_can_reach_the_cluster_and_only_to_see_its_dashboard() -> None:
    services = read("dask/compose.yaml")["services"]
    published = {name: each.get("ports", []) for name, each in services.items()}
    assert published == {"scheduler": ["127.0.0.1:8787:8787"], "worker": [], "slipflow": []}
    [policy] = [each["spec"] for each in read_all(KUBERNETES) if each["kind"] == "NetworkPolicy"]
    assert policy["ingress"] == [{"from": [{"podSelector": policy["podSelector"]}]}]


def test_all_containers_are_unprivileged_and_those_of_the_cluster_share_the_recordings() -> None:
    compose, cluster = (read(name)["services"].values() for name in ("compose.yaml", "dask/compose.yaml"))
    for each in (*compose, *cluster):
        assert (each["read_only"], each["cap_drop"]) == (True, ["ALL"])
    for each in compose:
        assert all(port.startswith("127.0.0.1:") for port in each["ports"])
        assert each["security_opt"] == ["no-new-privileges:true"]
    assert all("recordings:/recordings" in each["volumes"] for each in cluster)
    for each in (each for each in read_all(KUBERNETES) if each["kind"] == "Deployment"):
        pod = each["spec"]["template"]["spec"]
        assert pod["securityContext"]["runAsNonRoot"]
        [container] = pod["containers"]
        assert container["securityContext"]["readOnlyRootFilesystem"]
        assert {"name": "recordings", "mountPath": "/recordings"} in container["volumeMounts"]


@pytest.mark.parametrize("name", COMPOSE[:2])
def test_the_recorder_sets_existing_parameters_of_its_flow(name: str) -> None:
    command, file, *settings = read(name)["services"]["recorder"]["command"]
    assert (command, file) == ("run", "/opt/slipflow/fingertip.py")
    values = dict(each.removeprefix("--set=").split("=", 1) for each in settings if each.startswith("--set="))
    values["broker"] = re.sub(r"\$\{\w+:-(.*)\}", r"\1", values["broker"])  # without the variable
    assert accepts(values)
    assert accepts({})
    assert {"--metrics=0.0.0.0:9464"} <= {*settings}


def test_containers_mount_only_shipped_files_and_secrets() -> None:
    compose, tls = read("compose.yaml"), read("compose.tls.yaml")
    used = {compose["services"]["recorder"]["env_file"]}
    for file in (compose, tls):
        used |= {each["file"] for each in file["secrets"].values()}
        for service in file["services"].values():
            used |= {mount.split(":")[0] for mount in service.get("volumes", ())}
    ignored = (DEPLOY / ".gitignore").read_text().split()
    for name in used - set(compose["volumes"]):
        secret = any(Path(name).match(each.lstrip("/")) or name.startswith(f".{each}") for each in ignored)
        assert (DEPLOY / name).exists() != secret, name
    assert tls["services"]["recorder"]["environment"] == {
        CA: "/run/secrets/ca",
        CERTIFICATE: "/run/secrets/certificate",
    }


def test_with_tls_the_port_without_it_is_not_published() -> None:
    ports = re.findall(r"ports: !override .*\n +- (.*?) #", (DEPLOY / "compose.tls.yaml").read_text())
    assert ports == ['"8883:8883"']


def test_the_broker_of_the_page_is_for_this_machine_until_it_has_tls(tmp_path: Path) -> None:
    first, second = re.findall(r"sed (?:-i )?('s.*?'|-e '/\^listener.*'d}')", PAGE)[:2]
    shipped = (DEPLOY / "mosquitto" / "mosquitto.conf").read_text()
    listeners = list[list[str]]()
    for expression in (first, second):
        words = ["sed", *shlex.split(expression)]
        shipped = captured(*words, input=shipped, cwd=DEPLOY.parent).stdout
        listeners.append([line for line in shipped.splitlines() if line.startswith("listener")])
    assert listeners == [["listener 1883 127.0.0.1"], ["listener 8883"]]


def test_git_ignores_each_secret_that_the_page_writes() -> None:
    written = {
        *re.findall(r"(?<![\w/])(?!/)[\w/]*(?:certificates/[\w.*]+|\w+\.(?:password|env))(?=\s)", PAGE)
    }
    assert {"deploy/certificates/broker.*", "reader.password", "deploy/metrics.env"} <= written
    done = captured("git", "check-ignore", *written, cwd=DEPLOY.parent)
    assert written - {*done.stdout.split()} == set()


def test_images_of_others_are_pinned_by_digest() -> None:
    shipped = (DEPLOY / "Dockerfile").read_text() + (DEPLOY / "compose.yaml").read_text()
    images = re.findall(r"^(?:FROM| +image:) (\S+)", shipped, re.MULTILINE)
    others = [each for each in images if each != "slipflow:0.2.0"]
    assert all(re.search(r":\d[\w.-]+@sha256:[0-9a-f]{64}$", each) for each in others)


def test_hadolint_finds_nothing_in_the_dockerfile() -> None:
    assert run(Path(sys.executable).with_name("hadolint"), "-t", "style", DEPLOY / "Dockerfile") == (0, "")


def test_the_image_has_hashed_wheels_and_runs_unprivileged() -> None:
    installs = [part for step in STEPS for part in step.split("&&") if " install " in part and "pip" in part]
    *packages, ours = installs
    assert all("--require-hashes --only-binary :all:" in each for each in packages)
    assert "--no-deps /wheels/slipflow-" in ours
    last = STEPS[max(n for n, step in enumerate(STEPS) if step.startswith("FROM")) :]
    assert not [step for step in last if re.search(r"\b(pip|apt|apt-get|gcc|curl)\b", step)]
    assert "USER 10001:10001" in last
    assert 'CMD ["run", "/opt/slipflow/fingertip.py", "--metrics=9464"]' in last
    [volumes] = [json.loads(step.removeprefix("VOLUME")) for step in last if step.startswith("VOLUME")]
    kept = re.findall(r"(?:XDG_STATE_HOME|NUMBA_CACHE_DIR)=(/\w+)", " ".join(last))
    assert {*kept} <= {*volumes}


def test_the_build_context_has_the_copied_files_only() -> None:
    sent = (DEPLOY / "Dockerfile.dockerignore").read_text().splitlines()
    copies = [step.split()[1:-1] for step in STEPS if step.startswith("COPY") and "--from" not in step]
    copied = [source for sources in copies for source in sources]
    assert sorted(line[1:] for line in sent if line.startswith("!")) == sorted(copied)
    assert all((DEPLOY.parent / source).exists() for source in copied)


@pytest.mark.parametrize("mistake", ["", "Restart=sometimes"])
def test_systemd_accepts_the_unit_with_certificates_and_no_mistake(tmp_path: Path, mistake: str) -> None:
    program = "/opt/slipflow/bin/slipflow"  # where a user installs it
    assert program in UNIT
    (tmp_path / "slipflow.service.d").mkdir()
    (tmp_path / "slipflow.service.d" / "tls.conf").write_text(TLS)
    text = UNIT.replace(program, str(Path(sys.executable).with_name("slipflow")))
    (tmp_path / "slipflow.service").write_text(text.replace("Restart=always", mistake or "Restart=always"))
    _, output = run("systemd-analyze", "verify", "--man=no", tmp_path / "slipflow.service")
    assert ("slipflow.service:" in output) == bool(mistake)
    assert bool(output) == bool(mistake)


def test_the_service_is_locked_down_restarted_and_watched(tmp_path: Path) -> None:
    (tmp_path / "slipflow.service").write_text(UNIT)
    words = ("security", "--offline=true", "--no-pager")
    _, output = run("systemd-analyze", *words, tmp_path / "slipflow.service")
    [exposure] = re.findall(r"exposure level for slipflow.service: ([\d.]+)", output)
    assert float(exposure) <= EXPOSURE
    assert {"Type=notify", "Restart=always", "StartLimitIntervalSec=0"} <= {*UNIT.splitlines()}
    assert re.search(r"^ExecStart=.* --metrics 9464 \$SETTINGS$", UNIT, re.MULTILINE)
    [watchdog] = re.findall(r"^WatchdogSec=(\d+)$", UNIT, re.MULTILINE)
    assert int(watchdog) >= 3 * (CHECK_INTERVAL + 5)  # a busy host delays the messages
    assert "\nSupplementaryGroups=i2c\n" in UNIT  # from this package only
    assert "python3-venv i2c-tools" in PAGE


def test_password_and_certificates_reach_the_sink_as_credentials() -> None:
    loaded = dict(re.findall(r"^LoadCredential=(\S+):(\S+)$", UNIT + TLS, re.MULTILINE))
    variables = dict(re.findall(r"(SLIPFLOW_MQTT_\w+)=%d/(\S+)", UNIT + TLS))
    assert {name: loaded[credential] for name, credential in variables.items()} == {
        PASSWORD_FILE: "/etc/slipflow/mqtt-password",
        CA: "/etc/slipflow/ca.crt",
        CERTIFICATE: "/etc/slipflow/client.pem",
    }
    assert all(f" {place}" in PAGE for place in loaded.values())


def test_old_sessions_are_deleted_as_a_whole(tmp_path: Path) -> None:
    service, container = re.findall(r"/recordings/sessions (-mindepth .*)", PAGE)
    assert service == container
    month = time.time() - 40 * 86400
    for name in ("old", "new", "recorded"):  # the last one for more than a month
        (tmp_path / name / "touch").mkdir(parents=True)
        for path in (tmp_path / name / "MANIFEST.json", tmp_path / name / "touch/part-000000.parquet"):
            path.touch()
        for path in () if name == "new" else (*(tmp_path / name).rglob("*"), tmp_path / name):
            os.utime(path, (month, month))
    (tmp_path / "recorded/MANIFEST.json").replace(tmp_path / "recorded/MANIFEST.json.new")
    subprocess.run(["find", tmp_path, *shlex.split(service)], check=True)
    assert {path.name: len(list(path.rglob("*"))) for path in tmp_path.iterdir()} == {"new": 3, "recorded": 3}


def test_the_shipped_settings_match_the_shipped_flow() -> None:
    lines = (DEPLOY / "systemd" / "settings").read_text().splitlines()
    settings = dict(line.split("=", 1) for line in lines if not line.startswith("#"))
    words = shlex.split(settings["SETTINGS"])
    values = dict(word.split("=", 1) for word in words[1::2])
    assert words[::2] == ["--set"] * len(values)
    assert accepts(values)
    assert values["rig"] == settings["SLIPFLOW_MQTT_USER"]  # as the broker's list has it


def pins(name: str) -> dict[str, str]:
    """Version of each package, which has hashes."""
    text = re.sub(r"^#.*\n", "", (DEPLOY / name).read_text(), flags=re.MULTILINE)
    found = re.findall(r"^(\S+)==(\S+)(?: \\\n {4}--hash=sha256:[0-9a-f]{64})+$", text, re.MULTILINE)
    assert len(found) == text.count("==")
    return dict(found)


def test_the_pinned_versions_satisfy_the_project() -> None:
    project = tomllib.loads((DEPLOY.parent / "pyproject.toml").read_text())
    everything, edge, build = pins("requirements.txt"), pins("edge.txt"), pins("build.txt")
    asked = {canonicalize_name(one.name): one for one in map(Requirement, project["project"]["dependencies"])}
    assert asked.keys() <= everything.keys()
    assert asked.keys() - edge.keys() == LEFT_OUT
    assert edge.items() <= everything.items()
    assert all(each.specifier.contains(everything[name]) for name, each in asked.items())
    [tool] = map(Requirement, project["build-system"]["requires"])
    assert tool.specifier.contains(build[tool.name])
