"""Replays on an Apache Flink cluster, byte for byte equal to a replay in one process."""
