"""Client of a Flink job manager's REST interface."""

import json
from operator import itemgetter
from typing import Any, Final, cast
from urllib.error import HTTPError
from urllib.parse import urlsplit
from urllib.request import Request, urlopen

from operators.errors import EndpointError, ParameterError

_TIMEOUT: Final = 10.0  # s
_LIMIT: Final = 16_000_000  # bytes of a response
LOST: Final = "LOST"
ENDED: Final = frozenset({"FINISHED", "FAILED", "CANCELED"})  # states of a job


class JobManager:
    """Client of the job manager at a URL.

    Args:
        url: URL such as http://localhost:8081.

    Raises:
        ParameterError: if the URL is invalid.
    """

    def __init__(self, url: str) -> None:
        parts = urlsplit(url)
        if parts.scheme not in {"http", "https"} or not parts.hostname:
            raise ParameterError("cluster", "URL", url, "such as http://localhost:8081")
        self.url = url.rstrip("/")

    def slots(self) -> int:
        """Return the number of task slots, which limits the number of workers.

        Raises:
            EndpointError: if the job manager does not respond.
        """
        return int(self._request("/overview")["slots-total"])

    def state(self, job: str) -> str:
        """Return the state of a job; one of `ENDED` if it has ended, LOST if the job manager was restarted.

        Raises:
            EndpointError: if the job manager does not respond.
        """
        jobs: list[dict[str, str]] = self._request("/jobs/overview")["jobs"]
        return next((each["state"] for each in jobs if each["jid"] == job), LOST)

    def restore_point(self, job: str) -> str | None:
        """Return the path of a job's newest checkpoint or savepoint; None: there is none.

        Raises:
            EndpointError: if the job manager does not respond, or there is no such job.
        """
        found = self._latest(job, "completed", "savepoint")
        return max(found, key=itemgetter("trigger_timestamp"))["external_path"] if found else None

    def savepoint(self, job: str) -> str | None:
        """Return the path of a job's newest savepoint; None: Flink has not reported one yet.

        Raises:
            EndpointError: if the job manager does not respond, or there is no such job.
        """
        found = self._latest(job, "savepoint")
        return found[0]["external_path"] if found else None

    def cause(self, job: str) -> str:
        """Return the reason of a job's last failure in one line; empty if it did not fail.

        Raises:
            EndpointError: if the job manager does not respond, or there is no such job.
        """
        entries = self._request(f"/jobs/{job}/exceptions").get("exceptionHistory", {}).get("entries", [])
        if not entries:
            return ""
        lines = [line.strip() for line in str(entries[0]["stacktrace"]).splitlines() if line.strip()]
        ours = [line for line in lines if line.startswith(("operators.errors.", "Caused by:"))]
        return (ours or lines)[-1].removeprefix("Caused by: ").removeprefix("operators.errors.")

    def cancel(self, job: str) -> None:
        """Cancel a job.

        Raises:
            EndpointError: if the job manager does not respond, or there is no such job.
        """
        self._request(f"/jobs/{job}", "PATCH")

    def _latest(self, job: str, *kinds: str) -> list[dict[str, Any]]:
        latest: dict[str, Any] = self._request(f"/jobs/{job}/checkpoints").get("latest", {})
        return [latest[kind] for kind in kinds if latest.get(kind)]

    def _request(self, path: str, method: str = "GET") -> dict[str, Any]:
        request = Request(self.url + path, method=method)  # noqa: S310 - http or https, as checked above
        try:
            with urlopen(request, timeout=_TIMEOUT) as response:  # noqa: S310 - the same
                document: object = json.loads(response.read(_LIMIT) or b"{}")
        except HTTPError as error:
            raise EndpointError(self.url + path, f"responds {error.code} {error.reason}") from error
        except (OSError, ValueError) as error:
            raise EndpointError(
                self.url, f"no Flink job manager responds: {error}; start one with `make cluster`"
            ) from error
        if not isinstance(document, dict):
            raise EndpointError(self.url + path, "does not respond like Flink: check the URL")
        return cast("dict[str, Any]", document)
