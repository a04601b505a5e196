"""A flow over recordings on a Flink cluster, with the result that one process gives, byte for byte."""
