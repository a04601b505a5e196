from pathlib import Path

import pytest

from connectors import Mqtt
from connectors.mqtt import rig_names
from connectors.mqtt.broker import CA, PASSWORD, PASSWORD_FILE, USER, Broker
from connectors.mqtt.rig_names import host_rig, outbox_path, rig_topic
from flows.run.clocks import LoopClock
from flows.run.diagnosis import diagnose
from operators.errors import InputError, ParameterError
from operators.ports import Finding
from tests.connectors.mqtt.broker_process import TestBroker

MALFORMED = (
    *("", "localhost:1883", "http://localhost", "mqtt://", "mqtt://a:0", "mqtt://a:65536", "mqtt://a/b"),
    "mqtt://a?x",
)


def test_a_url_names_scheme_host_and_port() -> None:
    assert str(Broker.parse("mqtt://localhost")) == "mqtt://localhost:1883"
    assert str(Broker.parse("mqtt://[::1]:1884")) == "mqtt://[::1]:1884"
    for url in MALFORMED:
        with pytest.raises(ParameterError, match=r"^Mqtt: url is .*, must be like mqtt://host"):
            Broker.parse(url)


@pytest.mark.parametrize(
    "url", ["mqtt://me:secret@localhost", "mqtt://me:secret@host:port", "me:secret@host"]
)
def test_a_url_with_credentials_is_rejected_without_showing_them(url: str) -> None:
    with pytest.raises(ParameterError, match=f"set {USER} and {PASSWORD}") as caught:
        Broker.parse(url)
    assert "secret" not in str(caught.value)


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
    (tmp_path / "password").write_text("x" * 2**16)
    for user, path, named in (("rig", "password", "password"), ("\udcff", "", USER)):
        monkeypatch.setenv(USER, user)
        monkeypatch.setenv(PASSWORD_FILE, str(tmp_path / path) if path else "")
        with pytest.raises(
            InputError, match=f"{named}: must be a user or password of at most 65535 bytes in UTF-8"
        ):
            broker.login()


def test_unreadable_ca_certificates_are_an_error_that_names_the_variable(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv(CA, str(tmp_path / "ca.pem"))
    with pytest.raises(InputError, match=r"ca\.pem: cannot read .* \(SLIPFLOW_MQTT_CA\): No such"):
        Broker.parse("mqtts://localhost").tls()
    (tmp_path / "ca.pem").write_text("no certificate")
    with pytest.raises(InputError, match=r"contains no CA certificate in PEM format \(SLIPFLOW_MQTT_CA\)"):
        Broker.parse("mqtts://localhost").tls()


@pytest.mark.parametrize(
    ("host", "name"), [("ur10.lab.example", "ur10"), ("a b/c+", "a-b-c-"), ("", "rig"), ("x" * 99, "x" * 64)]
)
def test_by_default_a_rig_is_named_as_its_host(monkeypatch: pytest.MonkeyPatch, host: str, name: str) -> None:
    monkeypatch.setattr(rig_names, "gethostname", lambda: host)
    assert host_rig() == name == Mqtt("mqtt://localhost").rig
    assert rig_topic("Mqtt", "lab", name)


def test_each_rig_has_an_outbox_in_the_state_folder(state: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rigs = [("a", "b"), ("a-b", "c"), ("a", "b-c"), ("..", ".."), ("x" * 64, "y" * 64), ("ü", "~")]
    paths = [outbox_path(*rig) for rig in rigs]
    assert len(set(paths)) == len(rigs)
    assert all(path.parent == state / "slipflow" and len(path.name.encode()) < 250 for path in paths)
    monkeypatch.setenv("XDG_STATE_HOME", "relative")
    assert outbox_path("a", "b") == Path.home() / ".local" / "state" / "slipflow" / "a-b.outbox"


async def found(url: str, site: str = "lab", rig: str = "rig") -> list[Finding]:
    """Return the findings without those about the disk."""
    findings = await diagnose({"mqtt": Mqtt(url, site, rig)}, LoopClock())
    return [each for each in findings["mqtt"] if "outbox" not in each.subject]


@pytest.mark.broker
@pytest.mark.usefixtures("quiet")
async def test_a_broker_gets_one_message_that_is_not_retained(broker: TestBroker) -> None:
    listener = broker.listen("slip/#")
    login, answer = await found(broker.url)
    assert login == Finding(broker.url, "admits any client")
    assert answer.text.startswith("accepts slip/v1/lab/rig/doctor within ")
    assert answer.state == "good"
    [message] = listener.rest()
    assert (message.topic, message.payload, message.retained) == ("slip/v1/lab/rig/doctor", "{}", False)


@pytest.mark.broker
@pytest.mark.usefixtures("quiet")
async def test_a_missing_broker_a_wrong_password_and_missing_rights_are_bad(
    guarded: TestBroker, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    login, refusal = await found(guarded.url)
    assert login == Finding(guarded.url, "admits user rig with a password")
    assert refusal.state == "bad"
    assert refusal.text.startswith("refuses to publish slip/v1/lab/rig/doctor: Not authorized; allow it in")
    monkeypatch.setenv(PASSWORD, "wrong")
    [wrong] = await found(guarded.url)
    assert (wrong.state, "check SLIPFLOW_MQTT_USER and SLIPFLOW_MQTT_PASSWORD" in wrong.text) == ("bad", True)
    (tmp_path / "wrong").write_text("wrong")
    monkeypatch.setenv(PASSWORD_FILE, str(tmp_path / "wrong"))
    monkeypatch.delenv(USER)
    [wrong] = await found(guarded.url)
    remedy = f"; check SLIPFLOW_MQTT_USER, which is not set, and the password in {tmp_path / 'wrong'}"
    assert wrong.text.endswith(remedy)
    missing = tmp_path / "missing"
    monkeypatch.setenv(PASSWORD_FILE, str(missing))
    [unreadable] = await found(guarded.url)
    assert (unreadable.subject, unreadable.state) == (str(missing), "bad")
    monkeypatch.delenv(PASSWORD_FILE)
    guarded.stop()
    [gone] = await found(guarded.url)
    assert (gone.state, "check that the broker runs" in gone.text) == ("bad", True)


@pytest.mark.broker
@pytest.mark.usefixtures("quiet")
async def test_the_certificate_of_a_broker_is_checked(
    secure: TestBroker, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    url = secure.url.replace("mqtt:", "mqtts:")
    [untrusted] = await found(url)
    assert (untrusted.state, f"set {CA} to the file of the CA" in untrusted.text) == ("bad", True)
    monkeypatch.setenv(CA, str(tmp_path / "certificate.pem"))
    login, certificate, answer = await found(url)
    assert (login.state, certificate.state, answer.state) == ("good", "good", "good")
