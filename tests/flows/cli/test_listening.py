import pytest
import typer

from flows.cli.listening import listening


@pytest.mark.parametrize("given", ["", "host", "host:", ":80", "host:99999", "99999", "::1:80", "a b:80"])
def test_a_place_that_is_none_is_wrong_usage(given: str) -> None:
    with pytest.raises(typer.BadParameter, match=f"^--listen {given}: write it as PORT or HOST:PORT"):
        listening("--listen", given)
