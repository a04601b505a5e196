"""Submits a job to a Flink cluster; runs in an environment that has pyflink, as a command of its own.

    python -m flows.run.cluster.flink_job http://localhost:8081 FOLDER 2        prints the job's id

Translation is little: the claims' files are the source, the flow's operators are one keyed process function,
a second one writes the sessions. See `docs/decisions/0013-work-units-on-flink.md`.
"""

import sys
from functools import partial
from importlib.resources import files
from itertools import count
from pathlib import Path
from typing import Final
from urllib.parse import urlsplit

from pyflink.common import Configuration, Duration, Types, WatermarkStrategy
from pyflink.datastream import RuntimeExecutionMode, StreamExecutionEnvironment
from pyflink.datastream.connectors.file_system import FileSource, StreamFormat
from pyflink.java_gateway import get_gateway

from flows.run.cluster.flink_functions import Assemble, WorkOff, dealt

_SETTINGS: Final = {
    "python.fn-execution.bundle.size": "10",  # claims that a checkpoint waits for
    "python.fn-execution.bundle.time": "100",
    "python.fn-execution.arrow.batch.size": "1000",
    "python.execution-mode": "process",
    "execution.checkpointing.interval": "5 s",
    "execution.checkpointing.mode": "EXACTLY_ONCE",
    "execution.checkpointing.unaligned.enabled": "true",  # claims are small: thousands wait before a barrier
    "restart-strategy.type": "failure-rate",
    "restart-strategy.failure-rate.max-failures-per-interval": "20",
    "restart-strategy.failure-rate.failure-rate-interval": "5 min",
    "restart-strategy.failure-rate.delay": "1 s",
}


def submit(url: str, folder: Path, parallelism: int, *, follow: bool) -> str:
    """Submit the job of a folder.

    Args:
        url: Of the cluster's job manager.
        folder: The job's, on storage that all machines of the cluster share.
        parallelism: How many workers there are.
        follow: Whether claims may still come; else it ends with those that are there.

    Returns:
        The job's id.
    """
    settings = Configuration()
    for name, value in {**_SETTINGS, "python.executable": sys.executable}.items():
        settings.set_string(name, value)
    source = FileSource.for_record_stream_format(StreamFormat.text_line_format(), f"file://{folder}/claims")
    if follow:
        source = source.monitor_continuously(Duration.of_millis(500))
    environment = _environment(url, settings)
    environment.set_runtime_mode(RuntimeExecutionMode.STREAMING)
    environment.set_parallelism(parallelism)
    claims = environment.from_source(source.build(), WatermarkStrategy.no_watermarks(), "claims")
    worker = partial(dealt, _keys(parallelism))
    worked = claims.set_parallelism(1).key_by(worker, Types.STRING())
    done = worked.process(WorkOff(str(folder)), Types.STRING()).name("work off").uid("work-off")
    written = done.key_by(worker, Types.STRING()).process(Assemble(str(folder)), Types.STRING())
    written.name("assemble").uid("assemble").print()
    return str(environment.execute_async(folder.name).get_job_id())


def _keys(parallelism: int) -> list[str]:
    """A key for each worker, found by trying: what key is whose is in Flink's hands."""
    flink, found = get_gateway().jvm.org.apache.flink, dict[int, str]()
    assignment, row = flink.runtime.state.KeyGroupRangeAssignment, flink.types.Row(1)
    keyed = flink.streaming.api.functions.python.KeyByKeySelector()  # as `key_by` has it
    groups = assignment.computeDefaultMaxParallelism(parallelism)
    for number in count():
        row.setField(0, str(number))
        place = assignment.assignKeyToParallelOperator(keyed.getKey(row), groups, parallelism)
        found.setdefault(place, str(number))
        if len(found) == parallelism:
            break
    return list(found.values())


def _environment(url: str, settings: Configuration) -> StreamExecutionEnvironment:
    """The cluster at a URL; PyFlink itself knows only the one of its own settings."""
    place = urlsplit(url)
    java = get_gateway()
    [jar] = Path(str(files("pyflink")), "opt").glob("flink-python-*.jar")
    jars = java.new_array(java.jvm.java.lang.String, 1)
    jars[0] = str(jar)
    remote = java.jvm.org.apache.flink.streaming.api.environment.StreamExecutionEnvironment
    return StreamExecutionEnvironment(
        remote.createRemoteEnvironment(
            place.hostname,
            place.port or 8081,
            settings._j_configuration,  # noqa: SLF001 - pyflink has no other way
            jars,
        )
    )


if __name__ == "__main__":
    _, _url, _folder, _parallelism, *_rest = sys.argv
    sys.stdout.write(submit(_url, Path(_folder), int(_parallelism), follow="--follow" in _rest) + "\n")
