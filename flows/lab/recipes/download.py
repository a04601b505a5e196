"""Verified download of a recipe's files over HTTPS: bounded, resumed after an interruption."""

import asyncio
import hashlib
from collections.abc import AsyncGenerator, Callable, Sequence
from contextlib import asynccontextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final
from urllib.parse import urljoin, urlsplit

from flows.lab.recipes.dataset_recipe import DatasetRecipe, SourceFile
from operators.back_off import BackOff
from operators.errors import EndpointError, ParameterError, os_error_reason
from storage.files import PARTIAL, make_folder, rename, sync, unlink

if TYPE_CHECKING:
    from aiohttp import ClientResponse, ClientSession

ATTEMPTS: Final = 4  # without a new byte
REDIRECTS: Final = 5
CONNECT: Final = 10.0  # s
SILENCE: Final = 30.0  # s without a byte
CHUNK: Final = 1 << 16  # bytes

_LOOPBACK: Final = {"localhost", "127.0.0.1", "::1"}
_REDIRECTS: Final = {301, 302, 303, 307, 308}
_WHOLE, _PART, _BEYOND = 200, 206, 416  # status: the whole file, the requested part, no such part
_BUSY: Final = {408, 425, 429, 500, 502, 503, 504}  # status that may pass


class _TransferError(Exception):
    """Interrupted transfer, which is worth another attempt."""


def check_address(url: str) -> None:
    """Require https, or http to this machine.

    Raises:
        ParameterError: if it is another address.
    """
    parts = urlsplit(url)
    if not (_is_local(url) or (parts.scheme == "https" and parts.hostname)):
        raise ParameterError("fetch", "address", url, "one that begins with https://, or http://localhost")


def location(file: SourceFile, folder: Path) -> Path:
    """Return the path of a file below a folder.

    Raises:
        EndpointError: if a link below the folder leads out of it.
    """
    path = folder / file.path
    if not path.resolve().is_relative_to(folder.resolve()):
        raise EndpointError(str(path), "leads out of the folder: remove the link")
    return path


def is_verified(file: SourceFile, path: Path) -> bool:
    """Return True if a file exists with the size and the checksum of the recipe.

    Raises:
        EndpointError: if it exists and cannot be read.
    """
    try:
        return path.is_file() and path.stat().st_size == file.bytes and _sha256(path) == file.sha256
    except OSError as error:
        raise EndpointError(str(path), f"cannot be read: {os_error_reason(error)}") from error


class Download:
    """Download of the files of a recipe into a folder; files that are there and verified are kept.

    A file is written as ``NAME.partial``, verified, then renamed. A partial file is continued by an HTTP
    Range request, or begun again if the server does not support it. Every attempt that brings no byte is
    followed by a longer pause; four in a row end the download.

    Args:
        recipe: The recipe.
        folder: Folder of the files, created if missing.
        mirror: Folder of the files on another server; http only on this machine.

    Raises:
        ParameterError: if the mirror is not https, or http on this machine.
    """

    def __init__(self, recipe: DatasetRecipe, folder: Path, mirror: str | None = None) -> None:
        self._recipe, self._folder, self._mirror = recipe, folder, mirror
        check_address(mirror or recipe.base)
        self._received = 0  # bytes of the present file

    async def run(
        self, progress: Callable[[int, int, str], None] = lambda _done, _total, _part: None
    ) -> Sequence[SourceFile]:
        """Download the missing files and return them.

        Args:
            progress: Called with the bytes that are there, all bytes, and the name of the file.

        Raises:
            EndpointError: if a file cannot be downloaded, has another size or another checksum, or cannot be
                written.
        """
        total, done, loaded = self._recipe.bytes, 0, list[SourceFile]()
        async with self._session() as session:
            for file in self._recipe.files:
                path = location(file, self._folder)
                progress(done, total, file.name)
                if not is_verified(file, path):
                    here = partial(_add, progress, done, total, file.name)
                    try:
                        await self._load(session, file, path, here)
                    except OSError as error:
                        raise EndpointError(
                            str(path), f"cannot be written: {os_error_reason(error)}"
                        ) from error
                    loaded.append(file)
                done += file.bytes
        progress(done, total, "")
        return loaded

    @asynccontextmanager
    async def _session(self) -> AsyncGenerator["ClientSession"]:
        from aiohttp import ClientSession, ClientTimeout  # noqa: PLC0415 - slow to import

        timeout = ClientTimeout(total=None, sock_connect=CONNECT, sock_read=SILENCE)
        headers = {"Accept-Encoding": "identity", "User-Agent": "slipflow"}  # bytes as they were published
        proxies = not _is_local(self._mirror or "")
        async with ClientSession(timeout=timeout, headers=headers, trust_env=proxies) as session:
            yield session

    async def _load(
        self, session: "ClientSession", file: SourceFile, path: Path, progress: Callable[[int], None]
    ) -> None:
        """Download one file, with further attempts after interruptions."""
        make_folder(path.parent, parents=True)
        rest, retry = path.with_name(path.name + PARTIAL), BackOff(first=0.5)
        failures, again = 0, False
        while True:
            begin = _size(rest)
            try:
                await self._attempt(session, file, rest, progress)
            except _TransferError as error:
                gained = _size(rest) > begin
                failures = 1 if gained else failures + 1
                if failures >= ATTEMPTS:
                    raise EndpointError(self._url(file), f"{error}; {self._remedy()}") from error
                if gained:
                    retry.reset()
                await asyncio.sleep(retry.delay())
                continue
            if is_verified(file, rest):
                break
            found = _sha256(rest)
            unlink(rest)
            if again or not begin:  # else an old partial file may be the reason
                reason = f"has the sha256 {found}, but the recipe says {file.sha256}: the source was changed"
                raise EndpointError(self._url(file), f"{reason}, or altered on its way; nothing was kept")
            again = True
        sync(rest)
        rename(rest, path)

    async def _attempt(
        self, session: "ClientSession", file: SourceFile, rest: Path, progress: Callable[[int], None]
    ) -> None:
        """Append the rest of a file to its partial file.

        Raises:
            _TransferError: if the transfer ended early; the partial file has the bytes that arrived.
        """
        from aiohttp import ClientError  # noqa: PLC0415 - slow to import

        begin = _size(rest)
        if begin > file.bytes:
            begin = 0
        if begin == file.bytes:
            return
        try:
            async with self._response(session, self._url(file), begin) as response:
                if response.status == _BEYOND:
                    unlink(rest)
                    raise _TransferError("has changed its size")
                if response.status != _PART or not _continues(response, begin):
                    begin = 0  # the server sends the whole file
                self._check_size(file, response, begin)
                with rest.open("r+b" if begin else "wb") as out:
                    out.seek(begin)
                    async for chunk in response.content.iter_chunked(CHUNK):
                        begin += len(chunk)
                        if begin > file.bytes:
                            break
                        out.write(chunk)
                        out.flush()  # a kill loses nothing that arrived
                        progress(begin)
        except (ClientError, TimeoutError) as error:
            raise _TransferError(_reason(error)) from error
        if begin > file.bytes:
            unlink(rest)
            raise EndpointError(self._url(file), f"is larger than the {file.bytes} bytes of the recipe")
        if begin < file.bytes:
            raise _TransferError(f"ended after {begin} of {file.bytes} bytes")

    @asynccontextmanager
    async def _response(
        self, session: "ClientSession", url: str, begin: int
    ) -> AsyncGenerator["ClientResponse"]:
        """Request a file from byte `begin` on and follow redirects, to https only."""
        headers = {"Range": f"bytes={begin}-"} if begin else {}
        for _ in range(REDIRECTS + 1):
            async with session.get(url, headers=headers, allow_redirects=False) as response:
                if response.status not in _REDIRECTS:
                    self._check_status(response)
                    yield response
                    return
                target = urljoin(url, response.headers.get("Location", ""))
            if urlsplit(target).scheme != "https" and not (_is_local(url) and _is_local(target)):
                raise EndpointError(url, f"redirects to {target}, which is not https")
            url = target
        raise EndpointError(url, f"was reached by more than {REDIRECTS} redirects")

    def _check_status(self, response: "ClientResponse") -> None:
        if response.status in _BUSY:
            raise _TransferError(f"answers {response.status} {response.reason}")
        if response.status not in (_WHOLE, _PART, _BEYOND):
            reason = f"answers {response.status} {response.reason}"
            raise EndpointError(str(response.url), f"{reason}; {self._remedy()}")

    def _check_size(self, file: SourceFile, response: "ClientResponse", begin: int) -> None:
        length = response.content_length
        if length is not None and begin + length != file.bytes and "Content-Encoding" not in response.headers:
            reason = f"has {begin + length} bytes, but the recipe says {file.bytes}: the source was changed"
            raise EndpointError(self._url(file), reason)

    def _url(self, file: SourceFile) -> str:
        return self._recipe.link(file, self._mirror)

    def _remedy(self) -> str:
        """Return how to continue without this server."""
        return (
            f"run the command again later; or get the files elsewhere ({self._recipe.page}) and put them into"
            f" {self._folder} under the same paths ({self._recipe.files[0].path} ...), or give a copy of the"
            " source with --files"
        )


def _add(progress: Callable[[int, int, str], None], done: int, total: int, name: str, size: int) -> None:
    progress(done + size, total, name)


def _is_local(url: str) -> bool:
    parts = urlsplit(url)
    return parts.scheme == "http" and parts.hostname in _LOOPBACK


def _continues(response: "ClientResponse", begin: int) -> bool:
    return response.headers.get("Content-Range", "").replace("bytes ", "").startswith(f"{begin}-")


def _size(path: Path) -> int:
    return path.stat().st_size if path.is_file() else 0


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _reason(error: Exception) -> str:
    if isinstance(error, TimeoutError):
        return "does not answer in time"
    return f"cannot be reached: {error}"
