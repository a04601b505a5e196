import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from connectors.mqtt.broker import CA, CERTIFICATE, PASSWORD_FILE
from flows.graph.loading import load
from flows.graph.validation import problems
from flows.run.live_runner import CHECK_INTERVAL
from tests.deploy.shipped import DEPLOY

TEXT = (DEPLOY / "systemd" / "slipflow.service").read_text()
PAGE = (DEPLOY.parent / "docs" / "how-to" / "deploy.md").read_text()
PROGRAM = "/opt/slipflow/bin/slipflow"  # where an operator installs it
EXPOSURE = 1.6  # of 10, as systemd 252 counts; it was 1.5


TLS = (DEPLOY / "systemd" / "tls.conf").read_text()


def verify(folder: Path, text: str, tls: str = "") -> str:
    """Return the output of systemd-analyze, which exits with 0 even if a value is wrong."""
    unit = folder / "slipflow.service"
    (folder / "slipflow.service.d").mkdir()
    (folder / "slipflow.service.d" / "tls.conf").write_text(tls)
    unit.write_text(text.replace(PROGRAM, str(Path(sys.executable).with_name("slipflow"))))
    done = subprocess.run(
        ["systemd-analyze", "verify", "--man=no", unit], capture_output=True, text=True, check=False
    )
    return done.stdout + done.stderr


def test_systemd_accepts_the_unit(tmp_path: Path) -> None:
    assert PROGRAM in TEXT
    assert verify(tmp_path, TEXT) == ""


def test_systemd_accepts_the_unit_with_a_client_certificate(tmp_path: Path) -> None:
    assert verify(tmp_path, TEXT, TLS) == ""


def test_systemd_reports_a_mistake_in_the_settings_of_tls(tmp_path: Path) -> None:
    assert "tls.conf:" in verify(
        tmp_path, TEXT, TLS.replace("LoadCredential=ca.crt", "LoadCredentials=ca.crt")
    )


@pytest.mark.parametrize(
    ("right", "wrong"),
    [("Restart=always", "Restart=sometimes"), ("KillMode=mixed", "KilMode=mixed")],
)
def test_systemd_reports_a_mistake_in_the_unit(tmp_path: Path, right: str, wrong: str) -> None:
    assert right in TEXT
    assert re.search(r"slipflow.service:\d+: ", verify(tmp_path, TEXT.replace(right, wrong)))


def test_the_service_is_locked_down(tmp_path: Path) -> None:
    unit = tmp_path / "slipflow.service"
    unit.write_text(TEXT)
    done = subprocess.run(
        ["systemd-analyze", "security", "--offline=true", "--no-pager", unit],
        capture_output=True,
        text=True,
        check=True,
    )
    found = re.search(r"exposure level for slipflow.service: ([\d.]+)", done.stdout)
    assert found
    assert float(found[1]) <= EXPOSURE


def test_it_is_restarted_after_any_exit() -> None:
    assert (
        "\nRestart=always\n" in TEXT
    )  # a hang-up, which stops it before it can commit, is a clean end to systemd
    assert "\nStartLimitIntervalSec=0\n" in TEXT


def test_the_group_of_the_bus_comes_with_the_documented_packages() -> None:
    # Without the group the unit does not start, and Debian has it from this package only.
    assert "\nSupplementaryGroups=i2c\n" in TEXT
    [install] = re.findall(r"^    sudo apt-get install (python3-venv.*)$", PAGE, re.MULTILINE)
    assert "i2c-tools" in install.split()


def test_it_notifies_systemd_and_serves_metrics() -> None:
    assert "\nType=notify\n" in TEXT
    assert re.search(r"^ExecStart=.* --metrics 9464 --log json \$SETTINGS$", TEXT, re.MULTILINE)
    [watchdog] = re.findall(r"^WatchdogSec=(\d+)$", TEXT, re.MULTILINE)
    assert int(watchdog) >= 3 * (CHECK_INTERVAL + 5)  # a busy host delays the messages


def test_the_password_reaches_the_sink_as_a_credential() -> None:
    [source] = re.findall(r"^LoadCredential=(\S+):/etc/slipflow/mqtt-password$", TEXT, re.MULTILINE)
    assert f"\nEnvironment={PASSWORD_FILE}=%d/{source}\n" in TEXT


def test_the_certificates_reach_the_sink_as_credentials() -> None:
    loaded = dict(re.findall(r"^LoadCredential=(\S+):(\S+)$", TLS, re.MULTILINE))
    [environment] = re.findall(r"^Environment=(.*)$", TLS, re.MULTILINE)
    named = dict(word.split("=%d/") for word in environment.split())
    assert named == {CA: "ca.crt", CERTIFICATE: "client.pem"}
    for place in (loaded.pop(name) for name in named.values()):
        assert re.search(rf"^    sudo install -m 600 certificates/\S+ {place}$", PAGE, re.MULTILINE)
    assert not loaded


def test_the_documented_doctor_gets_the_certificates_of_the_service() -> None:
    loaded = dict(re.findall(r"^LoadCredential=(\S+):(\S+)$", TLS, re.MULTILINE))
    assert f"`{CA}={loaded['ca.crt']} {CERTIFICATE}={loaded['client.pem']}`\nafter `sudo env`" in PAGE


def test_old_sessions_are_deleted_before_the_restart_which_needs_space() -> None:
    for prune, restart in (
        ("/opt/slipflow/bin/slipflow prune ", "    systemctl restart slipflow\n"),
        ("        prune /recordings ", "    docker compose -f deploy/compose.yaml restart recorder\n"),
    ):
        assert PAGE.count(prune) == PAGE.count(restart) == 1
        assert PAGE.index(prune) < PAGE.index(restart)


def test_the_shipped_settings_match_the_shipped_flow() -> None:
    lines = (DEPLOY / "systemd" / "settings").read_text().splitlines()
    settings = dict(line.split("=", 1) for line in lines if not line.startswith("#"))
    assert set(settings) == {"SETTINGS", "SLIPFLOW_MQTT_USER"}
    words = shlex.split(settings["SETTINGS"])
    assert words[::2] == ["--set"] * (len(words) // 2)
    values = dict(word.split("=", 1) for word in words[1::2])
    assert problems(load(str(DEPLOY / "fingertip.py")).flow(values)) == []
    assert values["rig"] == settings["SLIPFLOW_MQTT_USER"]  # as the broker's list has it
