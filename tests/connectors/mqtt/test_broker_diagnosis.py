from pathlib import Path

import pytest

from connectors import Mqtt
from connectors.mqtt.broker import CA, PASSWORD, PASSWORD_FILE
from flows.run.clocks import LoopClock
from flows.run.diagnosis import diagnose
from operators.ports import Finding
from tests.connectors.mqtt.broker_process import TestBroker

pytestmark = [pytest.mark.broker, pytest.mark.usefixtures("quiet")]


async def found(url: str, site: str = "lab", rig: str = "rig") -> list[Finding]:
    """Return the findings without those about the disk."""
    findings = await diagnose({"mqtt": Mqtt(url, site, rig)}, LoopClock())
    return [each for each in findings["mqtt"] if "outbox" not in each.subject]


async def test_a_broker_gets_one_message_that_is_not_retained(broker: TestBroker) -> None:
    listener = broker.listen("slip/#")
    login, answer = await found(broker.url)
    assert login == Finding(broker.url, "admits any client")
    assert answer.text.startswith("accepts slip/v1/lab/rig/doctor within ")
    assert answer.state == "good"
    [message] = listener.rest()
    assert (message.topic, message.payload, message.retained) == ("slip/v1/lab/rig/doctor", "{}", False)


async def test_a_missing_broker_a_wrong_password_and_missing_rights_are_bad(
    guarded: TestBroker, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    login, refusal = await found(guarded.url)
    assert login == Finding(guarded.url, "admits user rig with a password")
    assert refusal.state == "bad"
    assert refusal.text == (
        "refuses to publish slip/v1/lab/rig/doctor: Not authorized; allow it in the broker's access list"
    )
    monkeypatch.setenv(PASSWORD, "wrong")
    [wrong] = await found(guarded.url)
    assert (wrong.state, "check SLIPFLOW_MQTT_USER and SLIPFLOW_MQTT_PASSWORD" in wrong.text) == ("bad", True)
    missing = tmp_path / "missing"
    monkeypatch.setenv(PASSWORD_FILE, str(missing))
    [unreadable] = await found(guarded.url)
    assert (unreadable.subject, unreadable.state) == (str(missing), "bad")
    monkeypatch.delenv(PASSWORD_FILE)
    guarded.stop()
    [gone] = await found(guarded.url)
    assert (gone.state, "check that the broker runs" in gone.text) == ("bad", True)


async def test_the_certificate_of_a_broker_is_checked(
    secure: TestBroker, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    url = secure.url.replace("mqtt:", "mqtts:")
    [untrusted] = await found(url)
    assert (untrusted.state, f"set {CA} to the file of the CA" in untrusted.text) == ("bad", True)
    monkeypatch.setenv(CA, str(tmp_path / "certificate.pem"))
    login, certificate, answer = await found(url)
    assert (login.state, answer.state) == ("good", "good")
    assert certificate.state == "note"
    assert certificate.text.startswith("TLS with a trusted certificate, valid for 2 days: renew it")
