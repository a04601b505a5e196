import asyncio
import socket
from collections.abc import Sequence
from pathlib import Path

import pytest

from flows.lab.recipes import download
from flows.lab.recipes.download import ATTEMPTS, Download, check_address, is_verified, location
from operators import EndpointError, ParameterError
from operators.back_off import BackOff
from tests.flows.lab.recipes.source_server import SourceServer, recipe_of, serve

FILES = {"data/one.csv": bytes(range(256)) * 1000, "two.csv": b"t,a,b\n" * 500}
RECIPE = recipe_of(FILES)
ONE = FILES["data/one.csv"]


@pytest.fixture(autouse=True)
def _no_pauses(monkeypatch: pytest.MonkeyPatch) -> None:
    def short(**_: float) -> BackOff:
        return BackOff(first=0.001, last=0.002)

    monkeypatch.setattr(download, "BackOff", short)


def load(server: SourceServer, folder: Path) -> Sequence[str]:
    return [file.path for file in asyncio.run(Download(RECIPE, folder, server.url).run())]


def content(folder: Path) -> dict[str, bytes]:
    return {
        path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()
    }


def test_all_files_are_downloaded_and_verified(tmp_path: Path) -> None:
    seen: list[tuple[int, int, str]] = []
    with serve(FILES) as server:
        run = Download(RECIPE, tmp_path, server.url).run(
            lambda done, total, part: seen.append((done, total, part))
        )
        assert [file.path for file in asyncio.run(run)] == [*FILES]
    assert content(tmp_path) == FILES
    assert seen[0] == (0, RECIPE.bytes, "one.csv")
    assert seen[-1] == (RECIPE.bytes, RECIPE.bytes, "")
    assert [done for done, _, _ in seen] == sorted(done for done, _, _ in seen)


def test_verified_files_are_not_downloaded_again(tmp_path: Path) -> None:
    with serve(FILES) as server:
        load(server, tmp_path)
        (tmp_path / "two.csv").write_bytes(b"x" * len(FILES["two.csv"]))  # damaged
        server.requests.clear()
        assert load(server, tmp_path) == ["two.csv"]
        assert server.requests == [("two.csv", "")]
    assert content(tmp_path) == FILES


def test_a_cut_connection_is_continued_where_it_ended(tmp_path: Path) -> None:
    with serve(FILES) as server:
        server.cut["data/one.csv"] = [100_000, 50_000]
        load(server, tmp_path)
        ranges = [asked for path, asked in server.requests if path == "data/one.csv"]
    assert content(tmp_path) == FILES
    assert ranges == ["", "bytes=100000-", "bytes=150000-"]


def test_an_interrupted_download_is_continued_by_the_next_one(tmp_path: Path) -> None:
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "one.csv.partial").write_bytes(ONE[:12345])
    with serve(FILES) as server:
        load(server, tmp_path)
        assert server.requests[0] == ("data/one.csv", "bytes=12345-")
    assert content(tmp_path) == FILES


def test_a_complete_partial_file_needs_no_request(tmp_path: Path) -> None:
    (tmp_path / "two.csv.partial").write_bytes(FILES["two.csv"])
    with serve(FILES) as server:
        load(server, tmp_path)
        assert [path for path, _ in server.requests] == ["data/one.csv"]
    assert content(tmp_path) == FILES


@pytest.mark.parametrize("partial", [b"x" * 12345, b"x" * len(ONE), ONE + b"x"])
def test_a_wrong_partial_file_is_begun_again(partial: bytes, tmp_path: Path) -> None:
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "one.csv.partial").write_bytes(partial)
    with serve(FILES) as server:
        load(server, tmp_path)
    assert content(tmp_path) == FILES


def test_a_server_without_ranges_sends_the_whole_file_again(tmp_path: Path) -> None:
    with serve(FILES) as server:
        server.ranges, server.cut["data/one.csv"] = False, [100_000]
        load(server, tmp_path)
    assert content(tmp_path) == FILES


def test_a_busy_server_is_asked_again(tmp_path: Path) -> None:
    with serve(FILES) as server:
        server.status["two.csv"] = [503, 429]
        load(server, tmp_path)
    assert content(tmp_path) == FILES


def test_a_server_that_stays_busy_ends_the_download_after_some_attempts(tmp_path: Path) -> None:
    with serve(FILES) as server:
        server.status["two.csv"] = [503] * 20
        with pytest.raises(EndpointError, match=r"two\.csv: answers 503 .*; run the command again later"):
            load(server, tmp_path)
        assert server.requests.count(("two.csv", "")) == ATTEMPTS
    assert content(tmp_path) == {"data/one.csv": ONE}


def test_a_connection_that_is_always_cut_at_the_same_byte_ends_the_download(tmp_path: Path) -> None:
    with serve(FILES) as server:
        server.cut["data/one.csv"] = [1000, *[0] * 20]
        with pytest.raises(EndpointError, match=r"one\.csv"):
            load(server, tmp_path)
        assert len(server.requests) == ATTEMPTS
    assert content(tmp_path) == {"data/one.csv.partial": ONE[:1000]}


def test_a_wrong_checksum_is_an_error_and_nothing_is_kept(tmp_path: Path) -> None:
    with serve(FILES) as server:
        server.files["data/one.csv"] = b"x" * len(ONE)
        with pytest.raises(EndpointError, match=r"has the sha256 [0-9a-f]{64}, but the recipe says"):
            load(server, tmp_path)
    assert content(tmp_path) == {}


def test_a_wrong_file_in_pieces_is_downloaded_twice_at_most(tmp_path: Path) -> None:
    with serve(FILES) as server:
        server.files["data/one.csv"] = b"x" * len(ONE)
        server.cut["data/one.csv"] = [1000, len(ONE), 1000]
        with pytest.raises(EndpointError, match="the source was changed"):
            load(server, tmp_path)
        assert len(server.requests) == 4
    assert content(tmp_path) == {}


@pytest.mark.parametrize("size", [len(ONE) + 1, len(ONE) - 1, 10 * len(ONE)])
def test_another_size_is_an_error_before_the_file_is_read(size: int, tmp_path: Path) -> None:
    with serve(FILES) as server:
        server.files["data/one.csv"] = b"x" * size
        with pytest.raises(EndpointError, match=f"has {size} bytes, but the recipe says {len(ONE)}"):
            load(server, tmp_path)
    assert content(tmp_path) == {}


def test_a_file_that_does_not_end_is_cut_off(tmp_path: Path) -> None:
    with serve(FILES) as server:
        server.lengths, server.files["data/one.csv"] = False, ONE * 40
        with pytest.raises(EndpointError, match=f"is larger than the {len(ONE)} bytes of the recipe"):
            load(server, tmp_path)
    assert content(tmp_path) == {}


def test_a_missing_file_is_an_error_that_names_folder_and_source(tmp_path: Path) -> None:
    with serve(FILES) as server:
        del server.files["two.csv"]
        with pytest.raises(EndpointError) as caught:
            load(server, tmp_path)
        assert caught.value.endpoint == f"{server.url}/two.csv"
        assert server.requests.count(("two.csv", "")) == 1  # another attempt would not help
    assert "answers 404 Not Found" in caught.value.reason
    assert f"put them into {tmp_path} under the same paths (data/one.csv ...)" in caught.value.reason
    assert "https://github.com/someone/taps/tree/" in caught.value.reason


def test_without_a_network_the_error_names_address_and_folder(tmp_path: Path) -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        url = f"http://127.0.0.1:{free.getsockname()[1]}"
        with pytest.raises(EndpointError) as caught:
            asyncio.run(Download(RECIPE, tmp_path, url).run())
    assert caught.value.endpoint == f"{url}/data/one.csv"
    assert "cannot be reached" in caught.value.reason
    assert f"put them into {tmp_path}" in caught.value.reason


def test_redirects_on_this_machine_are_followed(tmp_path: Path) -> None:
    with serve(FILES) as server:
        server.redirect["two.csv"] = "/mirror/two"
        server.files["mirror/two"] = FILES["two.csv"]
        load(server, tmp_path)
    assert content(tmp_path) == FILES


@pytest.mark.parametrize(
    "target", ["http://example.com/two.csv", "file:///etc/passwd", "ftp://localhost/two.csv"]
)
def test_a_redirect_to_another_scheme_is_an_error(target: str, tmp_path: Path) -> None:
    with serve(FILES) as server:
        server.redirect["two.csv"] = target
        with pytest.raises(EndpointError, match="which is not https"):
            load(server, tmp_path)


def test_redirects_in_a_circle_are_an_error(tmp_path: Path) -> None:
    with serve(FILES) as server:
        server.redirect["two.csv"] = "/two.csv"
        with pytest.raises(EndpointError, match="more than 5 redirects"):
            load(server, tmp_path)


@pytest.mark.parametrize(
    "url", ["http://example.com/", "ftp://localhost/", "file:///data", "https://", "localhost", ""]
)
def test_other_addresses_than_https_and_this_machine_are_errors(url: str, tmp_path: Path) -> None:
    with pytest.raises(ParameterError, match="begins with https"):
        check_address(url)
    if url:
        with pytest.raises(ParameterError, match="begins with https"):
            Download(RECIPE, tmp_path, url)


@pytest.mark.parametrize(
    "url", ["https://host/a", "http://localhost:80", "http://127.0.0.1", "http://[::1]:1"]
)
def test_https_and_this_machine_are_addresses(url: str) -> None:
    check_address(url)


def test_a_link_that_leads_out_of_the_folder_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "outside").mkdir()
    folder = tmp_path / "files"
    folder.mkdir()
    (folder / "data").symlink_to(tmp_path / "outside")
    with pytest.raises(EndpointError, match="leads out of the folder"):
        location(RECIPE.files[0], folder)
    with serve(FILES) as server, pytest.raises(EndpointError, match="leads out of the folder"):
        load(server, folder)
    assert content(tmp_path / "outside") == {}


def test_a_folder_that_cannot_be_written_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "data").write_text("")
    with (
        serve(FILES) as server,
        pytest.raises(EndpointError, match=r"cannot be written: .*a file exists where"),
    ):
        load(server, tmp_path)


def test_a_file_is_verified_by_size_and_checksum(tmp_path: Path) -> None:
    [file] = recipe_of({"a": b"12"}).files
    path = tmp_path / "a"
    assert not is_verified(file, path)
    for data, good in ((b"1", False), (b"13", False), (b"12", True)):
        path.write_bytes(data)
        assert is_verified(file, path) is good
