"""Decoding of ROS 2 messages through the rosbags library, an extra."""

from functools import lru_cache, partial
from typing import Any, Final

from connectors.files.message_table import Decode
from operators.errors import InputError
from operators.extras import require_extra

_RULE: Final = "=" * 80 + "\n"


def check_rosbags() -> None:
    """Require the library.

    Raises:
        InputError: if it is not installed.
    """
    require_extra("ros", "ROS 2 import")


@lru_cache(maxsize=32)  # read messages of several schemas in turn
def ros_decoder(where: str, name: str, form: str, definition: str) -> Decode:
    """Return a function that decodes the CDR messages of a type.

    Args:
        where: Name of the file in messages.
        name: Name of the type, such as ``sensor_msgs/msg/JointState``.
        form: Format of the definition: ``ros2msg`` or ``ros2idl``; otherwise there is none.
        definition: The definition, with those of the types in it.

    Raises:
        InputError: if rosbags is not installed, or the type is unknown.
    """
    check_rosbags()
    from rosbags import typesys  # noqa: PLC0415 - an extra

    defined = bool(definition) and form in ("ros2msg", "ros2idl")
    store = typesys.get_typestore(typesys.Stores.EMPTY if defined else typesys.Stores.LATEST)
    try:
        if defined and form == "ros2msg":
            store.register(typesys.get_types_from_msg(definition, name))
        elif defined:
            for part in definition.split(_RULE):  # one per type, below a line with its name
                idl = part.partition("\n")[2] if part.startswith("IDL: ") else part
                store.register(typesys.get_types_from_idl(idl) if idl.strip() else {})
        known = name in store.types
    except Exception as error:  # typesys raises several
        reason = f"{type(error).__name__} {error}".partition("\n")[0]
        raise InputError(where, f"has an invalid definition of {name}: {reason:.200}") from error
    if not known:
        raise InputError(where, f"has messages of type {name} without its definition: convert it to MCAP")
    return partial(_decode, store, name)


def _decode(store: Any, name: str, data: bytes) -> object:  # noqa: ANN401 - a type store of rosbags
    message: object = store.deserialize_cdr(data, name)
    return message
