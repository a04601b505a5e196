"""Naive publisher: paho with its defaults, three messages for each sample.

python -m tests.chaos.naive PORT
"""

import json
import sys
import time

from paho.mqtt.client import Client
from paho.mqtt.enums import CallbackAPIVersion

RATE = 100  # Hz
TOPIC = "slip/v1/chaos/rig/0"


def main(port: int) -> None:
    """Publish until killed."""
    client = Client(CallbackAPIVersion.VERSION2)
    client.connect("127.0.0.1", port)
    client.loop_start()
    due = time.monotonic()
    while True:
        due += 1 / RATE
        time.sleep(max(0.0, due - time.monotonic()))
        message = json.dumps({"data": {"sample_time_ns": time.time_ns(), "p": 0.9, "rest": "x" * 400}})
        client.publish(f"{TOPIC}/signal", '{"p": 0.9}')
        client.publish(f"{TOPIC}/state", '{"slip": true, "p": 0.9}', qos=1, retain=True)
        client.publish(f"{TOPIC}/event", message, qos=1)


if __name__ == "__main__":
    main(int(sys.argv[1]))
