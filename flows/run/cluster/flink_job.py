"""Submission of a job to a Flink cluster; runs as a command in an environment that has pyflink.

    python -m flows.run.cluster.flink_job http://localhost:8081 FOLDER 2 [--follow] [--restore PATH]

prints the job's id.

The files of work units are the source. One keyed process function runs the flow's operators, a second one
writes the sessions. See `docs/decisions/0013-work-units-on-flink.md`.
"""

import sys
from argparse import ArgumentParser
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

from flows.run.cluster.flink_functions import ProcessUnits, WriteSessions, worker_key

_SETTINGS: Final = {
    "python.fn-execution.bundle.size": "10",  # units per bundle; a checkpoint waits for a bundle
    "python.fn-execution.bundle.time": "100",
    "python.fn-execution.arrow.batch.size": "1000",
    "python.execution-mode": "process",
    "execution.checkpointing.interval": "5 s",
    "execution.checkpointing.mode": "EXACTLY_ONCE",
    "execution.checkpointing.num-retained": "3",  # one is in use until the command has seen a newer one
    "execution.checkpointing.timeout": "1 d",  # a checkpoint waits while a session is written
    "execution.checkpointing.unaligned.enabled": "true",  # thousands of small units wait before a barrier
    "restart-strategy.type": "failure-rate",
    "restart-strategy.failure-rate.max-failures-per-interval": "20",
    "restart-strategy.failure-rate.failure-rate-interval": "5 min",
    "restart-strategy.failure-rate.delay": "1 s",
}


def submit(url: str, folder: Path, parallelism: int, *, follow: bool, restore: str | None) -> str:
    """Submit the job of a folder.

    Args:
        url: URL of the job manager.
        folder: Folder of the job, on storage that all machines of the cluster share.
        parallelism: Number of workers.
        follow: Wait for further units; else the job ends with the existing ones.
        restore: Checkpoint or savepoint of an earlier job of the same folder to continue from.

    Returns:
        Flink's id of the job.
    """
    settings = Configuration()
    for name, value in {**_SETTINGS, "python.executable": sys.executable}.items():
        settings.set_string(name, value)
    if restore:
        settings.set_string("execution.state-recovery.path", restore)
    source = FileSource.for_record_stream_format(StreamFormat.text_line_format(), f"file://{folder}/units")
    if follow:
        source = source.monitor_continuously(Duration.of_millis(500))
    environment = _environment(url, settings)
    environment.set_runtime_mode(RuntimeExecutionMode.STREAMING)
    environment.set_parallelism(parallelism)
    units = environment.from_source(source.build(), WatermarkStrategy.no_watermarks(), "units")
    key = partial(worker_key, _keys(parallelism))
    keyed = units.uid("units").set_parallelism(1).key_by(key, Types.STRING())
    results = (
        keyed.process(ProcessUnits(str(folder)), Types.STRING()).name("process units").uid("process-units")
    )
    written = results.key_by(key, Types.STRING()).process(WriteSessions(str(folder)), Types.STRING())
    written.name("write sessions").uid("write-sessions").print()
    return str(environment.execute_async(folder.name).get_job_id())


def _keys(parallelism: int) -> list[str]:
    """Return a key for each worker, found by trial: Flink assigns keys to workers by hash."""
    flink, found = get_gateway().jvm.org.apache.flink, dict[int, str]()
    assignment, row = flink.runtime.state.KeyGroupRangeAssignment, flink.types.Row(1)
    keyed = flink.streaming.api.functions.python.KeyByKeySelector()  # as used by `key_by`
    groups = assignment.computeDefaultMaxParallelism(parallelism)
    for number in count():
        row.setField(0, str(number))
        worker = assignment.assignKeyToParallelOperator(keyed.getKey(row), groups, parallelism)
        found.setdefault(worker, str(number))
        if len(found) == parallelism:
            break
    return list(found.values())


def _environment(url: str, settings: Configuration) -> StreamExecutionEnvironment:
    """Return the environment of the cluster at a URL; PyFlink itself supports only its configured cluster."""
    address = urlsplit(url)
    java = get_gateway()
    [jar] = Path(str(files("pyflink")), "opt").glob("flink-python-*.jar")
    jars = java.new_array(java.jvm.java.lang.String, 1)
    jars[0] = str(jar)
    remote = java.jvm.org.apache.flink.streaming.api.environment.StreamExecutionEnvironment
    return StreamExecutionEnvironment(
        remote.createRemoteEnvironment(
            address.hostname,
            address.port or 8081,
            settings._j_configuration,  # noqa: SLF001 - pyflink has no public name for it
            jars,
        )
    )


if __name__ == "__main__":
    parser = ArgumentParser()
    parser.add_argument("url")
    parser.add_argument("folder", type=Path)
    parser.add_argument("parallelism", type=int)
    parser.add_argument("--follow", action="store_true")
    parser.add_argument("--restore")
    sys.stdout.write(submit(**vars(parser.parse_args())) + "\n")
