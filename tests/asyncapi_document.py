"""The AsyncAPI document of a rig, made from the topics of docs/reference/mqtt.md and the JSON Schemas."""

import json
from importlib.resources import files
from typing import Any, Final

from connectors.events import CONTENT_TYPE
from operators.software import software_version
from tests.pages import ROOT, table

_DRAFT: Final = "application/schema+json;version=draft-2020-12"
_DOCUMENTS: Final = {
    "replay/request": ("request",),
    "replay/<name>": ("event", "answer"),
}  # else the topic's end
_BINDING: Final = "0.2.0"


def schema(name: str) -> Any:  # noqa: ANN401 - JSON
    """Return a JSON Schema that ships with the package."""
    return json.loads(files("connectors").joinpath(name).read_text(encoding="utf-8"))


def asyncapi() -> str:
    """Return the document as JSON."""
    documents = schema("rig-documents.schema.json")["$defs"]
    definitions = {name: documents[name] for name in ("name", "number", "time")}
    names, channels, operations = set[str](), dict[str, Any](), dict[str, Any]()
    for row in table(ROOT / "docs/reference/mqtt.md", "## Topics"):
        topic = row["topic"].strip("`")
        channel = topic.replace("<", "").replace(">", "").replace("/", "-")
        address = f"slip/v1/<site>/<rig>/{topic}".replace("<", "{").replace(">", "}")
        own = _DOCUMENTS.get(topic, (topic.rpartition("/")[2],))
        names |= {*own}
        levels = [level[1:-1] for level in address.split("/") if level.startswith("{")]
        channels[channel] = {
            "address": address,
            "description": row["content"],
            "parameters": {level: {"$ref": f"#/components/parameters/{level}"} for level in levels},
            "messages": {name: {"$ref": f"#/components/messages/{name}"} for name in own},
        }
        operations[channel] = {
            "action": "receive" if topic == "replay/request" else "send",
            "channel": {"$ref": f"#/channels/{channel}"},
            "bindings": {
                "mqtt": {
                    "qos": int(row["QoS"]),
                    "retain": row["retained"] == "yes",
                    "bindingVersion": _BINDING,
                }
            },
        }
    schemas = {
        name: schema("slip-event.schema.json")
        if name == "event"
        else {"$id": f"urn:slipflow:rig-documents:1:{name}", **documents[name], "$defs": definitions}
        for name in sorted(names)
    }
    document = {
        "asyncapi": "3.0.0",
        "info": {
            "title": "slipflow rig",
            "version": software_version(),
            "description": "MQTT 5 interface of a rig, from the rig's view: it sends events and documents.",
            "license": {"name": "MIT"},
        },
        "defaultContentType": "application/json",
        "channels": channels,
        "operations": operations,
        "components": {
            "parameters": {
                "site": {"description": "Site."},
                "rig": {
                    "description": "Rig, unique within the site; a name that ends in -replay is a replay."
                },
                "finger": {"description": "Number of the fingertip, or every."},
                "name": {"description": "Name chosen by the client."},
            },
            "messages": {
                name: {
                    "contentType": CONTENT_TYPE if name == "event" else "application/json",
                    "payload": {"schemaFormat": _DRAFT, "schema": each},
                }
                for name, each in schemas.items()
            },
        },
    }
    return json.dumps(document, indent=2) + "\n"
