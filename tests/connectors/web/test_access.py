import socket

import pytest

from connectors.web.access import TOKEN, Access
from operators.errors import ParameterError

SECRET = "0123456789abcdef"  # noqa: S105 - of tests


def test_loopback_needs_no_token() -> None:
    assert Access.of("Page", "127.0.0.1").admits(None)
    assert Access.of("Page", "localhost").admits(None)


@pytest.mark.parametrize("host", ["::", "192.168.1.5", "rig.lab"])
def test_other_addresses_need_a_token_of_the_environment(host: str, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ParameterError, match=f"token is None, must be set in {TOKEN}"):
        Access.of("Metrics", host)
    monkeypatch.setenv(TOKEN, SECRET)
    assert Access.of("Page", host).accepts_token(SECRET)


@pytest.mark.parametrize("token", ["short", "x" * 300, "0123456789 abcdef", "0123456789abcdef\n", "é" * 20])
def test_a_malformed_token_is_rejected_and_not_shown(token: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(TOKEN, token)
    with pytest.raises(ParameterError) as caught:
        Access.of("Page", "127.0.0.1")
    assert token not in str(caught.value)


def test_only_the_cookie_of_the_token_is_accepted() -> None:
    access = Access(SECRET)
    assert access.admits(access.cookie)
    assert Access(SECRET).cookie == access.cookie  # a page comes back after a restart
    assert not access.admits(None)
    assert not access.admits("")
    assert not access.admits(SECRET)
    assert not access.admits(Access(SECRET + "0").cookie)
    for not_ascii in ("ü", "\udcff"):  # aiohttp decodes a byte that is not UTF-8 as a surrogate
        assert not access.admits(not_ascii)
        assert not access.admits(None, f"Bearer {not_ascii}")
    assert not access.accepts_token("ü")
    assert SECRET not in access.cookie


def test_without_a_token_none_is_accepted() -> None:
    assert not Access().accepts_token("")


@pytest.mark.parametrize(
    "host", ["evil.example", "evil.example:8765", "", "localhost.evil.example", "a b", "[::1"]
)
def test_foreign_host_names_are_rejected(host: str) -> None:
    assert not Access().is_own_host(host)


def test_addresses_and_names_of_this_machine_are_accepted() -> None:
    for host in (
        "127.0.0.1:8765",
        "10.0.0.7",
        "[fe80::1]:80",
        "localhost",
        "LOCALHOST.",
        socket.gethostname(),
    ):
        assert Access().is_own_host(host), host


def test_with_a_token_any_host_name_is_accepted() -> None:
    assert Access(SECRET).is_own_host("robot.example")


def test_the_token_is_accepted_as_a_bearer() -> None:
    access = Access(SECRET)
    assert access.admits(None, f"Bearer {SECRET}")
    assert access.admits(None, f"bearer  {SECRET}")
    for wrong in ("", SECRET, f"Basic {SECRET}", f"Bearer {SECRET}x", "Bearer", "Bearer ü"):
        assert not access.admits(None, wrong), wrong
