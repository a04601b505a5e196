"""Client of the dashboard server of a UR controller, which stops an arm independently of its program."""

import asyncio
from typing import Final

from connectors.ur.rtde_client import NO_ANSWER
from operators.errors import EndpointError, os_error_reason

PORT: Final = 29999


async def request(host: str, command: str, *, port: int = PORT, timeout: float = 1.0) -> str:  # noqa: ASYNC109 - reported in the error
    """Send a command such as ``stop`` and return the answer; `timeout` (s) covers the whole exchange.

    Source: Universal Robots, "Dashboard Server".

    Raises:
        EndpointError: if the dashboard does not answer.
    """
    endpoint = f"dashboard://{host}:{port}"
    try:
        async with asyncio.timeout(timeout):
            reader, writer = await asyncio.open_connection(host, port)
            try:
                await reader.readline()  # its greeting
                writer.write(f"{command}\n".encode())
                answer = await reader.readline()
            except ValueError:  # beyond the reader's limit
                raise EndpointError(endpoint, "sends a line without an end: is it a dashboard?") from None
            finally:
                writer.close()
    except TimeoutError as error:
        raise EndpointError(endpoint, NO_ANSWER.format(timeout)) from error
    except OSError as error:
        raise EndpointError(endpoint, os_error_reason(error)) from error
    if not answer:
        raise EndpointError(endpoint, f"closed the connection without an answer to {command!r}")
    return answer.decode("utf-8", "replace").strip()
