"""What a Flink job manager says of itself and its jobs, over its REST interface."""

import json
from typing import Any, Final, cast
from urllib.error import HTTPError
from urllib.parse import urlsplit
from urllib.request import Request, urlopen

from operators.errors import EndpointError, ParameterError

_TIMEOUT: Final = 10.0  # s
_LIMIT: Final = 16_000_000  # bytes of an answer
ENDED: Final = frozenset({"FINISHED", "FAILED", "CANCELED"})  # states of a job


class JobManager:
    """The job manager at a URL.

    Args:
        url: Such as http://localhost:8081.

    Raises:
        ParameterError: if it is no such URL.
    """

    def __init__(self, url: str) -> None:
        parts = urlsplit(url)
        if parts.scheme not in {"http", "https"} or not parts.hostname:
            raise ParameterError("cluster", "URL", url, "such as http://localhost:8081")
        self.url = url.rstrip("/")

    def slots(self) -> int:
        """How many workers there can be.

        Raises:
            EndpointError: if it does not answer.
        """
        return int(self._ask("/overview")["slots-total"])

    def state(self, job: str) -> str:
        """How a job stands; one of `ENDED` if it has ended.

        Raises:
            EndpointError: if it does not answer, or knows no such job.
        """
        return str(self._ask(f"/jobs/{job}")["state"])

    def cause(self, job: str) -> str:
        """Why a job failed last, in a line; empty: it did not.

        Raises:
            EndpointError: if it does not answer, or knows no such job.
        """
        entries = self._ask(f"/jobs/{job}/exceptions").get("exceptionHistory", {}).get("entries", [])
        if not entries:
            return ""
        lines = [line.strip() for line in str(entries[0]["stacktrace"]).splitlines() if line.strip()]
        ours = [line for line in lines if line.startswith(("operators.errors.", "Caused by:"))]
        return (ours or lines)[-1].removeprefix("Caused by: ").removeprefix("operators.errors.")

    def cancel(self, job: str) -> None:
        """Have a job end.

        Raises:
            EndpointError: if it does not answer, or knows no such job.
        """
        self._ask(f"/jobs/{job}", "PATCH")

    def _ask(self, path: str, method: str = "GET") -> dict[str, Any]:
        request = Request(self.url + path, method=method)  # noqa: S310 - http or https, as checked above
        try:
            with urlopen(request, timeout=_TIMEOUT) as answer:  # noqa: S310 - the same
                told: object = json.loads(answer.read(_LIMIT) or b"{}")
        except HTTPError as error:
            raise EndpointError(self.url + path, f"answers {error.code} {error.reason}") from error
        except (OSError, ValueError) as error:
            raise EndpointError(
                self.url, f"no Flink job manager answers: {error}; `make cluster`?"
            ) from error
        if not isinstance(told, dict):
            raise EndpointError(self.url + path, "answers with something else than Flink would")
        return cast("dict[str, Any]", told)
