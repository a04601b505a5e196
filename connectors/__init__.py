"""Sources and sinks that connect flows to devices, files and networks; slow imports happen on first use."""

from connectors.console import Console
from connectors.events import Event
from connectors.files.trace import Trace
from connectors.gripper.gripper_sink import Gripper
from connectors.mqtt.consumer import Consumer
from connectors.mqtt.mqtt_sink import Mqtt
from connectors.replay import Replay
from connectors.sim.simulated_rig import SimulatedRig
from connectors.takktile.takktile_source import TakkTile
from connectors.ur.ur_motion import UrMotion
from connectors.web.live_page import Page
from connectors.web.metrics import Metrics

__all__ = [
    "Console",
    "Consumer",
    "Event",
    "Gripper",
    "Metrics",
    "Mqtt",
    "Page",
    "Replay",
    "SimulatedRig",
    "TakkTile",
    "Trace",
    "UrMotion",
]
