"""Connectors carry batches between flows and the world; what they import heavily is imported on first use."""

from connectors.console import Console
from connectors.consumer import Consumer
from connectors.csv_trace import CsvTrace
from connectors.events import Event
from connectors.gripper import Gripper
from connectors.metrics.metrics import Metrics
from connectors.mqtt import Mqtt
from connectors.mqtt_signal import MqttSignal
from connectors.page.page import Page
from connectors.replay import Replay
from connectors.rig.rig import Rig
from connectors.takktile import TakkTile
from connectors.ur_motion import UrMotion

__all__ = [
    "Console",
    "Consumer",
    "CsvTrace",
    "Event",
    "Gripper",
    "Metrics",
    "Mqtt",
    "MqttSignal",
    "Page",
    "Replay",
    "Rig",
    "TakkTile",
    "UrMotion",
]
