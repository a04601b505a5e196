"""Discovery of a rig by Home Assistant: one device with three entities per fingertip.

References:
    Device discovery, https://www.home-assistant.io/integrations/mqtt/#mqtt-discovery
"""

import re
from collections.abc import Iterable

from operators.ports import Json
from operators.software import software_version


def discovery_topic(prefix: str, site: str, rig: str) -> str:
    """Return the topic of a rig's discovery document; an empty retained message there removes the device.

    >>> discovery_topic("homeassistant", "lab", "ur 10")
    'homeassistant/device/slipflow-lab-ur_20_10/config'
    """
    return f"{prefix}/device/{_identifier(site, rig)}/config"


def discovery_document(site: str, rig: str, topic: str, fingers: Iterable[str]) -> dict[str, Json]:
    """Return the description of a rig that publishes below `topic`.

    The entities read the retained documents of the rig: slip, probability and quality of the newest event of
    each fingertip, which do not change between events. They are unavailable while the rig is offline.
    """
    components: dict[str, Json] = {}
    for finger in fingers:
        label = "all fingertips" if finger == "every" else f"finger {finger}"
        shared: dict[str, Json] = {"state_topic": f"{topic}/{finger}/state"}
        slip: dict[str, Json] = {
            "platform": "binary_sensor",
            "name": f"Slip, {label}",
            "device_class": "moving",
            "value_template": "{{ 'ON' if value_json.slip else 'OFF' }}",
            "json_attributes_topic": f"{topic}/{finger}/state",
        }
        probability: dict[str, Json] = {
            "platform": "sensor",
            "name": f"Slip probability, {label}",
            "state_class": "measurement",
            "suggested_display_precision": 2,
            "value_template": "{{ value_json.p }}",
        }
        quality: dict[str, Json] = {
            "platform": "sensor",
            "name": f"Quality, {label}",
            "device_class": "enum",
            "options": ["good", "doubtful", "blind"],
            "entity_category": "diagnostic",
            "value_template": "{{ value_json.quality }}",
        }
        for kind, entity in ("slip", slip), ("probability", probability), ("quality", quality):
            unique = f"{_identifier(site, rig)}-{finger}-{kind}"
            components[f"{finger}-{kind}"] = {**entity, **shared, "unique_id": unique}
    return {
        "device": {
            "identifiers": [_identifier(site, rig)],
            "name": f"{site} {rig}",
            "manufacturer": "slipflow",
            "sw_version": software_version(),
        },
        "origin": {"name": "slipflow", "sw_version": software_version()},
        "availability": [{"topic": f"{topic}/status", "value_template": "{{ value_json.state }}"}],
        "qos": 1,
        "components": components,
    }


def _identifier(*parts: str) -> str:
    """Return an identifier of letters, digits, hyphens and underscores, different for different parts."""
    escaped = (re.sub("[^0-9A-Za-z]", lambda match: f"_{ord(match[0]):x}_", part) for part in parts)
    return "-".join(("slipflow", *escaped))
