import pytest
import typer

from flows.cli.options import parse_address


@pytest.mark.parametrize("text", ["", "host", "host:", ":80", "host:99999", "99999", "::1:80", "a b:80"])
def test_an_invalid_address_is_a_usage_error(text: str) -> None:
    with pytest.raises(typer.BadParameter, match=f"^--listen {text}: write it as PORT or HOST:PORT"):
        parse_address("--listen", text)
