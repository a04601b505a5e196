import json
import re
import subprocess
import sys
from fnmatch import fnmatch
from pathlib import Path

from tests.deploy.shipped import DEPLOY

ROOT = DEPLOY.parent
TEXT = (DEPLOY / "Dockerfile").read_text()
STEPS = [line for line in re.sub(r"\\\n\s*", "", TEXT).splitlines() if line and not line.startswith("#")]
LAST = STEPS[max(n for n, step in enumerate(STEPS) if step.startswith("FROM")) :]


def lint(path: Path) -> subprocess.CompletedProcess[str]:
    program = Path(sys.executable).with_name("hadolint")
    return subprocess.run([program, "-t", "style", path], capture_output=True, text=True, check=False)


def test_hadolint_finds_nothing_in_the_dockerfile() -> None:
    done = lint(DEPLOY / "Dockerfile")
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_hadolint_detects_an_unpinned_image(tmp_path: Path) -> None:
    loose = tmp_path / "Dockerfile"
    loose.write_text(TEXT.replace(":3.11.13-slim-bookworm", ""))
    assert "DL3006" in lint(loose).stdout


def test_images_have_full_versions_and_are_slim() -> None:
    images = [step.split()[1] for step in STEPS if step.startswith("FROM")]
    assert len(images) == 2
    assert all(re.fullmatch(r"python:3\.\d+\.\d+-slim-\w+", image) for image in images)


def test_every_package_is_installed_from_a_hashed_wheel() -> None:
    installs = [part for step in STEPS for part in step.split("&&") if " install " in part and "pip" in part]
    assert len(installs) == 3
    *packages, ours = installs
    assert all("--require-hashes --only-binary :all:" in each for each in packages)
    assert "--no-deps /wheels/slipflow-" in ours
    assert any("pip wheel" in step and "--no-deps --no-build-isolation" in step for step in STEPS)


def test_the_last_stage_installs_nothing_and_runs_unprivileged() -> None:
    assert not [step for step in LAST if re.search(r"\b(pip|apt|apt-get|gcc|curl)\b", step)]
    users = [step for step in LAST if step.startswith("USER")]
    assert users == ["USER 10001:10001"]
    assert LAST.index(users[0]) < next(n for n, step in enumerate(LAST) if step.startswith("ENTRYPOINT"))


def test_a_plain_container_serves_metrics_and_logs_json() -> None:
    [command] = [json.loads(step.removeprefix("CMD")) for step in LAST if step.startswith("CMD")]
    assert command == ["run", "/opt/slipflow/fingertip.py", "--metrics=9464", "--log=json"]


def test_state_is_writable_in_a_read_only_image() -> None:
    [volumes] = [json.loads(step.removeprefix("VOLUME")) for step in LAST if step.startswith("VOLUME")]
    environment = " ".join(step for step in LAST if step.startswith("ENV"))
    kept = re.findall(r"(?:XDG_STATE_HOME|NUMBA_CACHE_DIR)=(/\w+)", environment)
    [start] = [step.split()[1] for step in LAST if step.startswith("WORKDIR")]
    assert len(kept) == 2
    assert {*kept, start} == set(volumes)


def test_the_build_context_has_the_copied_files_and_no_password() -> None:
    sent = (DEPLOY / "Dockerfile.dockerignore").read_text().split("\n")
    allowed = [line[1:] for line in sent if line.startswith("!")]
    assert "*" in sent
    copied = [
        source
        for step in STEPS
        if step.startswith("COPY") and "--from" not in step
        for source in step.split()[1:-1]
    ]
    assert sorted(copied) == sorted(allowed)
    assert [source for source in copied if not (ROOT / source).exists()] == []
    assert not any(fnmatch("deploy/mosquitto/passwords", pattern) for pattern in allowed)
