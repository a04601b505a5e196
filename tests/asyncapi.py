"""The AsyncAPI document of a rig, docs/reference/asyncapi.json, as a judge of messages."""

import json
import re
from typing import Any, Final

from jsonschema import Draft202012Validator

from tests.pages import ROOT

DOCUMENT: Final[Any] = json.loads((ROOT / "docs/reference/asyncapi.json").read_text(encoding="utf-8"))
_MESSAGES: Final[Any] = DOCUMENT["components"]["messages"]
EVENT_SCHEMA: Final[Any] = _MESSAGES["event"]["payload"]["schema"]


def problems(topic: str, payload: str) -> list[str]:
    """Return the violations of the message of this topic that fits best; fail for an unknown topic."""
    channel, *_ = [  # replay/request also has the form of replay/<name>
        each
        for each in DOCUMENT["channels"].values()
        if re.fullmatch(re.sub(r"\{\w+\}", "[^/]+", each["address"]), topic)
    ]
    found = list[list[str]]()
    for name in channel["messages"]:
        validator: Any = Draft202012Validator(_MESSAGES[name]["payload"]["schema"])
        found.append([error.message for error in validator.iter_errors(json.loads(payload))])
    return min(found, key=len)
