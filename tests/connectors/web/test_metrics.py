import asyncio

import numpy as np
import pytest
from aiohttp import ClientSession
from prometheus_client.parser import text_string_to_metric_families

from connectors import Metrics
from connectors.web.access import TOKEN
from operators.batch import Slips
from operators.errors import ParameterError
from operators.ports import Run, SinkStatus, SourceStatus


async def asked(url: str, **headers: str) -> tuple[int, str, str]:
    """Return status, content type and text of a response."""
    async with ClientSession() as session, session.get(url, headers=headers) as response:
        return response.status, response.headers["Content-Type"], await response.text()


def test_metrics_are_served_to_this_machine_only_and_only_during_the_run(run: Run) -> None:
    run.sources["touch"] = SourceStatus(rows=5)
    heard = list[str]()

    async def main() -> str:
        metrics = Metrics(0, opened=heard.append)
        assert metrics.destination == "http://127.0.0.1:0"
        await metrics.open(run)
        time = np.array([run.clock.now()])
        await metrics.write(Slips(time, np.array([1], np.int8), time, np.array([0.9]), finger=0))
        status, kind, text = await asked(metrics.url)
        assert (status, kind) == (200, "text/plain; version=0.0.4; charset=utf-8")
        assert heard == [metrics.url]
        assert (await asked(metrics.url, Host="evil.example"))[0] == 421
        assert (await asked(metrics.url.removesuffix("/metrics")))[0] == 404
        await metrics.close()
        with pytest.raises(OSError, match="Cannot connect"):
            await asked(metrics.url)
        return text

    families = {family.name: family for family in text_string_to_metric_families(asyncio.run(main()))}
    assert families["slipflow_source_rows"].samples[0].value == 5
    assert families["slipflow_slip_latency_seconds"].type == "histogram"


def test_other_machines_need_the_token_but_not_for_the_probes(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    run.sources["touch"], run.sinks["dataset"] = SourceStatus(), SinkStatus()

    async def main() -> None:
        wide = Metrics(0, "0.0.0.0")  # noqa: S104 - what is tested
        with pytest.raises(ParameterError, match="Metrics: token is None, must be set"):
            await wide.open(run)
        monkeypatch.setenv(TOKEN, "0123456789abcdef")
        await wide.open(run)
        assert (await asked(wide.url))[0] == 403
        own = {"Host": "robot.example", "Authorization": "Bearer 0123456789abcdef"}
        assert (await asked(wide.url, **own))[0] == 200
        base = wide.url.removesuffix("/metrics")
        assert (await asked(f"{base}/healthz"))[::2] == (200, "ok\n")
        assert (await asked(f"{base}/readyz"))[::2] == (503, "no source has delivered rows\n")
        run.sources["touch"].up = True
        assert (await asked(f"{base}/readyz"))[0] == 200
        run.sinks["dataset"].error = "the secret reason"
        assert (await asked(f"{base}/readyz"))[::2] == (503, "failing: dataset\n")
        assert (await asked(f"{base}/healthz"))[0] == 200
        await wide.close()

    asyncio.run(main())


@pytest.mark.parametrize("port", [-1, 65536])
def test_an_invalid_port_is_rejected(port: int) -> None:
    with pytest.raises(ParameterError, match="from 0 to 65535"):
        Metrics(port)
