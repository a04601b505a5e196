from pathlib import Path

import pytest

from connectors.mqtt.broker import CA, PASSWORD, PASSWORD_FILE, USER, Broker
from operators.errors import InputError, ParameterError


@pytest.mark.parametrize(
    ("url", "shown"),
    [
        ("mqtt://localhost", "mqtt://localhost:1883"),
        ("mqtt://10.0.0.2:1884", "mqtt://10.0.0.2:1884"),
        ("mqtts://broker.example", "mqtts://broker.example:8883"),
        ("mqtt://[::1]:1883", "mqtt://[::1]:1883"),
    ],
)
def test_a_url_names_scheme_host_and_port(url: str, shown: str) -> None:
    assert str(Broker.parse(url)) == shown


@pytest.mark.parametrize(
    "url",
    [
        "",
        "localhost",
        "localhost:1883",
        "http://localhost",
        "mqtt://",
        "mqtt://:1883",
        "mqtt://localhost:0",
        "mqtt://localhost:65536",
        "mqtt://localhost:port",
        "mqtt://localhost/topic",
        "mqtt://localhost?x",
        "mqtt://local host",
        "mqtt://[::1",
    ],
)
def test_malformed_urls_are_rejected(url: str) -> None:
    with pytest.raises(ParameterError, match=r"^Mqtt: url is .*, must be like mqtt://host"):
        Broker.parse(url)


@pytest.mark.parametrize(
    "url", ["mqtt://me:secret@localhost", "mqtt://me:secret@localhost:port", "me:secret@host"]
)
def test_a_url_with_credentials_is_rejected_without_showing_them(url: str) -> None:
    with pytest.raises(ParameterError) as caught:
        Broker.parse(url)
    assert "secret" not in str(caught.value)


def test_the_error_for_credentials_names_the_environment_variables() -> None:
    with pytest.raises(ParameterError, match=f"set {USER} and {PASSWORD}"):
        Broker.parse("mqtt://user@localhost")


def test_the_password_comes_from_the_environment_or_a_file(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    for name in (USER, PASSWORD, PASSWORD_FILE):
        monkeypatch.delenv(name, raising=False)
    broker = Broker.parse("mqtt://localhost")
    assert broker.login() == (None, None)
    monkeypatch.setenv(USER, "rig")
    monkeypatch.setenv(PASSWORD, "from environment")
    assert broker.login() == ("rig", "from environment")
    (tmp_path / "password").write_text("from file\n")
    monkeypatch.setenv(PASSWORD_FILE, str(tmp_path / "password"))
    assert broker.login() == ("rig", "from file")
    monkeypatch.setenv(PASSWORD_FILE, str(tmp_path / "absent"))
    with pytest.raises(InputError, match=r"absent: .*SLIPFLOW_MQTT_PASSWORD_FILE"):
        broker.login()


@pytest.mark.parametrize(
    ("content", "complaint"),
    [
        (None, r"cannot read the CA certificates \(SLIPFLOW_MQTT_CA\): No such file"),
        ("no certificate", r"contains no CA certificate in PEM format \(SLIPFLOW_MQTT_CA\)"),
    ],
)
def test_unreadable_ca_certificates_are_an_error_that_names_the_variable(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, content: str | None, complaint: str
) -> None:
    if content:
        (tmp_path / "ca.pem").write_text(content)
    monkeypatch.setenv(CA, str(tmp_path / "ca.pem"))
    with pytest.raises(InputError, match=rf"ca\.pem: {complaint}"):
        Broker.parse("mqtts://localhost").tls()
