"""Web server with the files of a recipe, which can cut connections, redirect and fail."""

import threading
from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass, field
from hashlib import sha256
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from flows.lab.recipes.dataset_recipe import DatasetRecipe, SourceFile, SourceRecording


def recipe_of(files: dict[str, bytes], **values: Any) -> DatasetRecipe:  # noqa: ANN401 - any key
    """Return a recipe whose recordings have one of the files each."""
    recordings = tuple(
        SourceRecording(f"r{number}", (SourceFile(path, len(data), sha256(data).hexdigest()),))
        for number, (path, data) in enumerate(files.items())
    )
    given: dict[str, Any] = {
        "name": "taps",
        "title": "Taps",
        "repository": "someone/taps",
        "commit": "b" * 40,
        "licence": "none",
        "terms": "Ask the authors.",
        "citation": "Someone, Taps, 2026",
        "rate": 100.0,
        "columns": {"t": "t", "a": "a", "b": "b"},
        "map": {"time": "t", "counts": "a,b"},
        "recordings": recordings,
        **values,
    }
    return DatasetRecipe(**given)


@dataclass
class SourceServer:
    """Behaviour of the server, by path; `requests` lists the path and range of each request."""

    files: dict[str, bytes]
    cut: dict[str, list[int]] = field(default_factory=dict[str, list[int]])  # bytes until the connection ends
    status: dict[str, list[int]] = field(default_factory=dict[str, list[int]])  # of the next requests
    redirect: dict[str, str] = field(default_factory=dict[str, str])
    stall: threading.Event | None = None  # keeps connections that were cut open until it is set
    ranges: bool = True  # answers Range requests
    lengths: bool = True  # states the length
    requests: list[tuple[str, str]] = field(default_factory=list[tuple[str, str]])
    url: str = ""

    def answer(self, request: BaseHTTPRequestHandler) -> None:
        path = request.path.removeprefix("/")
        asked = request.headers.get("Range", "")
        self.requests.append((path, asked))
        if statuses := self.status.get(path):
            request.send_error(statuses.pop(0))
            return
        if target := self.redirect.get(path):
            request.send_response(302)
            request.send_header("Location", target)
            request.send_header("Content-Length", "0")
            request.end_headers()
            return
        if path not in self.files:
            request.send_error(404)
            return
        self._send(request, path, asked)

    def _send(self, request: BaseHTTPRequestHandler, path: str, asked: str) -> None:
        data, begin = self.files[path], 0
        if asked and self.ranges:
            begin = int(asked.removeprefix("bytes=").removesuffix("-"))
            if begin >= len(data):
                request.send_error(416)
                return
            request.send_response(206)
            request.send_header("Content-Range", f"bytes {begin}-{len(data) - 1}/{len(data)}")
        else:
            request.send_response(200)
        if self.lengths:
            request.send_header("Content-Length", str(len(data) - begin))
        request.end_headers()
        cuts = self.cut.get(path, [])
        end = begin + cuts.pop(0) if cuts else len(data)
        request.wfile.write(data[begin:end])
        if end < len(data) and self.stall:
            request.wfile.flush()
            self.stall.wait()
        request.close_connection = True


@contextmanager
def serve(files: dict[str, bytes]) -> Generator[SourceServer]:
    """Serve files on a free port of this machine."""
    behaviour = SourceServer(dict(files))

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            behaviour.answer(self)

        def log_message(self, format: str, *args: object) -> None:  # noqa: A002
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        behaviour.url = f"http://127.0.0.1:{server.server_address[1]}"
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
        thread.start()
        try:
            yield behaviour
        finally:
            server.shutdown()
            thread.join()
