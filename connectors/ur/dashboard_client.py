"""The dashboard of a UR controller, for one request: another way to stop an arm than its program's."""

import asyncio
from typing import Final

from connectors.ur.rtde_link import SILENT
from operators.errors import EndpointError, os_error_reason

PORT: Final = 29999


async def ask(host: str, line: str, *, port: int = PORT, patience: float = 1.0) -> str:
    """What the dashboard answers to a line, such as ``stop``; all within `patience` (s).

    Raises:
        EndpointError: if it does not answer.
    """
    place = f"dashboard://{host}:{port}"
    try:
        async with asyncio.timeout(patience):
            reader, writer = await asyncio.open_connection(host, port)
            try:
                await reader.readline()  # its greeting
                writer.write(f"{line}\n".encode())
                answer = await reader.readline()
            finally:
                writer.close()
    except TimeoutError as error:
        raise EndpointError(place, SILENT.format(patience)) from error
    except OSError as error:
        raise EndpointError(place, os_error_reason(error)) from error
    if not answer:
        raise EndpointError(place, f"closed the connection without an answer to {line!r}")
    return answer.decode("utf-8", "replace").strip()
