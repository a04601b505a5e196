"""The text is read back by prometheus_client's own parser."""

from typing import Any

import numpy as np
import pytest
from aiohttp import ClientSession
from prometheus_client.parser import text_string_to_metric_families

from connectors import Metrics
from connectors.web.access import TOKEN
from operators.batch import Slips, ms, s
from operators.errors import ParameterError
from operators.health import FaultKind
from operators.ports import ClockStep, Gap, Run, SinkStatus, SourceStatus
from tests.connectors.web.reading import fault, scored, served

NOW = 100 * s


def key(name: str, **labels: str) -> str:
    return f"slipflow_{name}{sorted(labels.items())}"


def read(text: str) -> dict[str, float]:
    """Return each sample by its name and labels."""
    families = text_string_to_metric_families(text)
    return {
        f"{each.name}{sorted(each.labels.items())}": each.value
        for found in families
        for each in found.samples
    }


def slips(*times: int, state: int = 1, finger: int = 0) -> Slips:
    return Slips.rows(times, state, times, 0.9, finger=finger)


async def asked(url: str, **headers: str) -> tuple[int, str, str]:
    """Return status, content type and text of a response."""
    async with ClientSession() as session, session.get(url, headers=headers) as response:
        return response.status, response.headers["Content-Type"], await response.text()


async def test_metrics_are_served_to_this_machine_only_and_only_during_the_run(run: Run) -> None:
    run.sources["touch"] = SourceStatus(rows=5)
    metrics = Metrics(0)
    await metrics.open(run)
    await metrics.write(slips(NOW))
    status, kind, text = await asked(metrics.url)
    assert (status, kind) == (200, "text/plain; version=0.0.4; charset=utf-8")
    assert read(text)[key("source_rows_total", source="touch")] == 5
    assert (await asked(metrics.url, Authorization="Bearer"))[0] == 200  # of Prometheus with an empty token
    assert (await asked(metrics.url, Host="evil.example"))[0] == 421
    assert (await asked(metrics.url.removesuffix("/metrics")))[0] == 404
    await metrics.close()
    with pytest.raises(OSError, match="Cannot connect"):
        await asked(metrics.url)


async def test_other_machines_need_a_token_but_for_probes(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    run.sources["touch"], run.sinks["dataset"] = SourceStatus(), SinkStatus()
    host = "0.0.0.0"  # noqa: S104 - what is tested
    with pytest.raises(ParameterError, match=r"Metrics: host is .* or set SLIPFLOW_PAGE_TOKEN"):
        Metrics(0, host)
    monkeypatch.setenv(TOKEN, "0123456789abcdef")
    wide = Metrics(0, host)
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


async def test_sources_and_sinks_are_those_of_the_runner(run: Run) -> None:
    strange = 'a "b"\n\\c'
    run.sources["touch"] = SourceStatus(rows=500, late=3, newest=NOW - 30 * ms, up=True)
    run.sources[strange] = SourceStatus(failures=4, error="unplugged", gaps=[Gap(s, 3 * s, "unplugged")])
    mqtt = SinkStatus(rows=7, queued=2, waiting=4, unstored=1, dropped=5, connected=True, error="refused")
    run.sinks["mqtt"], run.sinks["dataset"] = mqtt, SinkStatus(rows=9, unstored=6)
    run.clock_steps.append(ClockStep(NOW, -2 * s))
    touch: dict[str, Any] = {"rows_total": 500, "late_rows_total": 3, "lag_seconds": 0.03, "up": 1}
    other = {"up": 0, "failures_total": 4, "gaps_total": 1}
    sink = {"up": 0, "rows_total": 7, "queued_batches": 2, "dropped_rows_total": 5, "waiting_rows": 4}
    expected = {
        key("run_info", session="run1", flow="live"): 1,
        **{key(f"source_{name}", source="touch"): value for name, value in touch.items()},
        **{key(f"source_{name}", source=strange): value for name, value in other.items()},
        **{key(f"sink_{name}", sink="mqtt"): value for name, value in sink.items()},
        key("sink_connected", sink="mqtt"): 1,
        key("sink_unstored_rows", sink="dataset"): 6,
        key("host_clock_offset_seconds"): -2,
        key("host_clock_steps_total"): 1,
    }
    text = await served(run)
    found = read(text)
    assert {name: found[name] for name in expected} == pytest.approx(expected)
    assert key("sink_waiting_rows", sink="dataset") not in found  # it acknowledges nothing
    assert key("source_lag_seconds", source=strange) not in found
    assert "refused" not in text


@pytest.mark.parametrize("recording", [None, "stroke-9"])
async def test_slips_are_counted_and_have_a_latency_in_live_runs(run: Run, recording: str | None) -> None:
    run.recording = recording
    onsets = slips(NOW - 3 * ms, NOW - 15 * ms, NOW - 9 * s)
    found = read(await served(run, onsets, slips(NOW - 4 * ms, state=0), slips(NOW, finger=2)))
    events = [found[key("slip_events_total", finger="0", state=each)] for each in ("onset", "end")]
    assert events == [3, 1]
    bounds = "0.002", "0.005", "0.02", "5.0", "+Inf"
    counts = [found.get(key("slip_latency_seconds_bucket", finger="0", le=le)) for le in bounds]
    assert counts == ([0, 2, 3, 3, 4] if recording is None else [None] * 5)


async def test_faults_last_and_scores_are_counted_by_quality(run: Run) -> None:
    batches = list[Any]()
    for active, probability in (False, 0.1), (False, np.nan), (True, 0.1), (False, 0.1):
        batches.append(fault(s, 3, FaultKind.STUCK, begins=active, finger=1))
        batches.append(scored(0, probability, finger=1))
        found = read(await served(run, *batches))
        assert found[key("barometer_fault", finger="1", barometer="3", kind="stuck")] == active
    qualities = "good", "doubtful", "blind"
    assert [found[key("scores_total", finger="1", quality=each)] for each in qualities] == [2, 1, 1]
