from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread

import pytest

from flows.lab.recipes.dataset_recipe import DatasetRecipe
from tests.command import error, slipflow


def test_without_a_name_the_recipes_are_listed_with_size_licence_and_citation() -> None:
    done = slipflow("fetch")
    assert "grasps: Slip in a grasp while the arm moves" in done.stdout
    assert "  47 recordings, 122 MB; licence: none\n  cite: nomadik" in done.stdout


ADDRESSES = (
    "http://[::1",
    "http://host:port/x",
    "http:///x",
    "://",
    "http://exa mple/",
    "ftp://x/y",
    "http://\u2100/",
    "%",
)


@pytest.mark.parametrize("address", ADDRESSES)
def test_a_redirect_to_a_malformed_address_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, address: str
) -> None:
    class Redirect(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(302)
            self.send_header("Location", address.encode().decode("latin-1"))
            self.end_headers()

        def log_message(self, *_: object) -> None:
            return

    monkeypatch.setattr("flows.lab.recipes.dataset_recipe._ATTEMPTS", 0)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    with ThreadingHTTPServer(("127.0.0.1", 0), Redirect) as server:
        Thread(target=server.serve_forever, daemon=True).start()
        monkeypatch.setattr(DatasetRecipe, "base_url", f"http://127.0.0.1:{server.server_port}/")
        text = error("fetch", "strokes", tmp_path / "out")
        server.shutdown()
    assert "was not fetched: " in text
    assert not (tmp_path / "out").exists()
