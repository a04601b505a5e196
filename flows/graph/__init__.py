"""Declaration, validation and compilation of flows."""

from flows.graph.flow import Flow, Stream
from flows.graph.quantity import Duration, Force, Length, Speed

__all__ = ["Duration", "Flow", "Force", "Length", "Speed", "Stream"]
