"""The shipped configuration of mosquitto, with a real one: rights, passwords, certificates, persistence."""

import asyncio
import os
import shutil
import signal
import ssl
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from connectors import Consumer, Mqtt
from connectors.mqtt.broker import CA, CERTIFICATE, PASSWORD, USER, Broker
from connectors.mqtt.broker_link import connect
from operators.errors import EndpointError, InputError
from operators.ports import Run
from tests.command import captured
from tests.connectors.mqtt.broker_process import TestBroker, deliver
from tests.connectors.mqtt.made import slips
from tests.deploy.shipped import DEPLOY
from tests.waiting import PATIENCE, until

pytestmark = [pytest.mark.broker, pytest.mark.usefixtures("quiet")]

RIG = "slip/v1/lab/fingertip"
PASSWORDS = {"fingertip": "secret", "reader": "other"}  # by user


def settings(folder: Path) -> list[str]:
    """Return the shipped mosquitto.conf for a folder, without its listener; write the password file."""
    passwords, acl = folder / "passwords", folder / "acl"
    shutil.copy(DEPLOY / "mosquitto" / "acl", acl)
    acl.chmod(0o600)
    passwords.write_text("")
    passwords.chmod(0o600)
    for user, password in PASSWORDS.items():
        subprocess.run(["mosquitto_passwd", "-b", str(passwords), user, password], check=True)
    (folder / "data").mkdir()
    text = (DEPLOY / "mosquitto" / "mosquitto.conf").read_text()
    for shipped, here in (
        ("/mosquitto/config/", f"{folder}/"),
        ("/mosquitto/data/", f"{folder}/data/"),
        ("listener 1883\n", ""),  # TestBroker adds one on loopback
        ("set_tcp_nodelay true\n", ""),  # TestBroker sets it
    ):
        assert shipped in text
        text = text.replace(shipped, here)
    return text.splitlines()


def login(user: str, password: str | None = None) -> None:
    """Set the user and password (default: the correct one) for later connections."""
    os.environ[USER] = user
    os.environ[PASSWORD] = PASSWORDS[user] if password is None else password


@pytest.fixture
def shipped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[TestBroker]:
    """Start the broker as shipped; no user is logged in."""
    for name in (USER, PASSWORD):
        monkeypatch.setenv(name, "")
    with TestBroker(tmp_path, *settings(tmp_path)) as server:
        yield server


async def send(broker: TestBroker, user: str, topic: str, *, retain: bool = False) -> None:
    login(user)
    link = await connect(Broker.parse(broker.url), f"test-{user}")
    try:
        await deliver(link, topic, b"{}", retain=retain)
    finally:
        await link.disconnect()


async def test_a_reader_gets_missed_and_new_events(shipped: TestBroker, run: Run) -> None:
    login("fingertip")
    sink = Mqtt(shipped.url, "lab", "fingertip")
    await sink.open(run)
    await sink.write(slips(1, 0))  # missed: to be asked for
    login("reader")
    async with asyncio.timeout(PATIENCE), Consumer(shipped.url, since="start") as events:
        seen = [(await anext(events)).seq for _ in range(2)]
        await sink.write(slips(1))
        assert [*seen, (await anext(events)).seq] == [1, 2, 3]
    await sink.close()


async def test_other_topics_and_clients_without_a_password_are_refused(shipped: TestBroker) -> None:
    for user, topic in (
        ("fingertip", "slip/v1/lab/other/0/event"),
        ("fingertip", "slip/v1/elsewhere/fingertip/status"),
        ("fingertip", "slip/v1/lab/fingertip2/head"),
        ("reader", f"{RIG}/0/event"),
        ("reader", f"{RIG}/replay/somebody"),
        ("reader", "other"),
    ):
        with pytest.raises(EndpointError, match=f"refuses to publish {topic}"):
            await send(shipped, user, topic)
    for name, password in ("", ""), ("fingertip", "wrong"), ("reader", ""), ("stranger", "secret"):
        login(name, password)
        with pytest.raises(EndpointError, match="cannot connect"):
            await connect(Broker.parse(shipped.url), "stranger")


async def test_a_rig_reads_only_its_own_requests(shipped: TestBroker) -> None:
    login("fingertip")
    link = await connect(Broker.parse(shipped.url), "rig")
    await link.listen("#")
    await deliver(link, f"{RIG}/0/event", b"{}")  # a reader would see it
    await send(shipped, "reader", "slip/v1/lab/other/replay/request")
    await send(shipped, "reader", f"{RIG}/replay/request")
    assert await link.receive() == (f"{RIG}/replay/request", b"{}")
    await link.disconnect()


async def test_retained_messages_survive_a_crash_of_the_broker(shipped: TestBroker, tmp_path: Path) -> None:
    await send(shipped, "fingertip", f"{RIG}/head", retain=True)
    saved = tmp_path / "data" / "mosquitto.db"
    await until(lambda: saved.exists() and f"{RIG}/head".encode() in saved.read_bytes())
    shipped.stop(signal.SIGKILL)
    shipped.start()
    login("reader")
    link = await connect(Broker.parse(shipped.url), "test-reader")
    await link.listen(f"{RIG}/head")
    assert await link.receive() == (f"{RIG}/head", b"{}")
    await link.disconnect()


SCRIPT = DEPLOY / "mosquitto" / "make_certificates"
needs_openssl = pytest.mark.skipif(not shutil.which("openssl"), reason="apt-get install openssl")


def make_certificates(folder: Path, *words: str, days: int = 825) -> tuple[int, list[str]]:
    """Return the exit status and output of the shipped script, whose certificates last for other `days`."""
    text = SCRIPT.read_text()
    assert "-days 825" in text
    script = text.replace("-days 825", f"-days {days}")
    done = captured("sh", "-c", script, SCRIPT, folder, *words)
    return done.returncode, (done.stdout + done.stderr).splitlines()


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@needs_openssl
def test_certificates_are_made_once_and_a_later_call_adds_a_user(tmp_path: Path) -> None:
    host = f"{'a' * 63}.example"  # longer than the subject of a certificate may be
    broker, purpose = "created broker.key broker.crt", f"broker.crt is for {host}"
    made = ["created ca.key ca.crt", broker, purpose, "created one.pem"]
    assert make_certificates(tmp_path, host, "one") == (0, made)
    before = contents(tmp_path)
    kept = ["kept ca.crt", "kept broker.crt", purpose, "kept one.pem", "created two.pem"]
    assert make_certificates(tmp_path, host, "one", "two") == (0, kept)
    after = contents(tmp_path)
    assert after.keys() - before.keys() == {"two.pem"}
    assert {name for name, data in before.items() if after[name] != data} == {"ca.srl"}
    (tmp_path / "broker.crt").unlink()  # to renew it
    assert make_certificates(tmp_path, host) == (0, ["kept ca.crt", broker, purpose])
    words = ["openssl", "verify", "-CAfile", "ca.crt", "-verify_hostname", host, "broker.crt"]
    subprocess.run(words, cwd=tmp_path, check=True, capture_output=True)


@needs_openssl
@pytest.mark.parametrize(
    ("words", "why"),
    [
        (("broker", "ca"), "a USER cannot be ca or broker"),
        (("broker", "../ca"), "'../ca': use letters"),
        (("other",), "broker.crt is not for other"),
        (("10.0.0.1",), "broker.crt is not for 10.0.0.1"),
        (("broker", "x" * 65), "maxsize=64"),
    ],
)
def test_a_wrong_name_or_host_changes_nothing(tmp_path: Path, words: tuple[str, ...], why: str) -> None:
    assert make_certificates(tmp_path, "broker", "one")[0] == 0
    before = contents(tmp_path)
    status, output = make_certificates(tmp_path, *words)
    assert status
    assert [line for line in output if why in line]
    assert contents(tmp_path) == before


@needs_openssl
def test_a_failure_leaves_no_incomplete_file_and_a_repeat_completes_the_rest(tmp_path: Path) -> None:
    status, output = make_certificates(tmp_path, "999.1.1.1", "one")
    assert status
    assert "bad ip address" in "".join(output)
    assert contents(tmp_path).keys() == {"ca.crt", "ca.key"}
    assert make_certificates(tmp_path, "10.0.0.1", "one")[0] == 0
    assert {"broker.crt", "broker.key", "one.pem"} <= contents(tmp_path).keys()


def strict(cafile: str | None) -> ssl.SSLContext:
    """Return the context that Python 3.13 creates: it checks certificates as RFC 5280 demands."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.load_verify_locations(cafile)
    context.verify_flags |= ssl.VERIFY_X509_STRICT | ssl.VERIFY_X509_PARTIAL_CHAIN
    return context


@needs_openssl
async def test_with_tls_the_broker_admits_only_clients_with_a_certificate_of_its_authority(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ssl, "create_default_context", strict)
    for folder in (tmp_path, tmp_path / "other"):
        make_certificates(folder, "127.0.0.1", "fingertip")
    make_certificates(tmp_path, "127.0.0.1", "expired", days=-1)
    monkeypatch.setenv(CA, str(tmp_path / "ca.crt"))
    text = (DEPLOY / "mosquitto" / "tls.conf").read_text().replace("/mosquitto/config", str(tmp_path))
    _, *tls = [line for line in text.splitlines() if not line.startswith("#")]  # without its listener

    async def meet() -> None:
        link = await connect(Broker.parse(url), "test")
        await deliver(link, f"{RIG}/status")
        await link.disconnect()

    with TestBroker(tmp_path, *tls, *settings(tmp_path)) as broker:
        url = broker.url.replace("mqtt:", "mqtts:")
        with pytest.raises(EndpointError, match=rf"; if it asks for client certificates, set {CERTIFICATE}"):
            await meet()
        for name in ("other/fingertip.pem", "expired.pem"):
            monkeypatch.setenv(CERTIFICATE, str(tmp_path / name))
            with pytest.raises(EndpointError, match=f"; check that {tmp_path / name} has not expired"):
                await meet()
        monkeypatch.setenv(CERTIFICATE, str(tmp_path / "fingertip.pem"))
        await meet()
    monkeypatch.setenv(CERTIFICATE, "/missing.pem")
    with pytest.raises(InputError, match=rf"^/missing.pem: cannot read .* \({CERTIFICATE}\): No such file"):
        Broker.parse(url).tls()
    monkeypatch.setenv(CERTIFICATE, str(tmp_path / "broker.crt"))
    with pytest.raises(InputError, match=r"no private key .*: cat client.crt client.key > client.pem"):
        Broker.parse(url).tls()


@needs_openssl
async def test_an_expired_certificate_of_the_broker_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    make_certificates(tmp_path, "127.0.0.1", days=-1)
    monkeypatch.setenv(CA, str(tmp_path / "ca.crt"))
    files = [f"certfile {tmp_path}/broker.crt", f"keyfile {tmp_path}/broker.key"]
    with TestBroker(tmp_path, "allow_anonymous true", *files) as broker:
        why = "certificate has expired; renew the broker's certificate, or set the clock of this machine$"
        with pytest.raises(EndpointError, match=why):
            await connect(Broker.parse(broker.url.replace("mqtt:", "mqtts:")), "test")
