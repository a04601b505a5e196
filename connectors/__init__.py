"""Connectors carry batches between flows and the world; what they import heavily is imported on first use."""

from connectors.console import Console
from connectors.csv.trace import CsvTrace
from connectors.events import Event
from connectors.gripper.gripper import Gripper
from connectors.metrics.metrics import Metrics
from connectors.mqtt.consumer import Consumer
from connectors.mqtt.mqtt import Mqtt
from connectors.mqtt.signal import MqttSignal
from connectors.page.page import Page
from connectors.replay import Replay
from connectors.rig.rig import Rig
from connectors.takktile.takktile import TakkTile
from connectors.ur.motion import UrMotion

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
