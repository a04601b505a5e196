from typing import Any

from pyflink.common import TypeInformation

class MapStateDescriptor:
    def __init__(
        self, name: str, key_type_info: TypeInformation, value_type_info: TypeInformation
    ) -> None: ...

class MapState:
    def get(self, key: object) -> Any: ...
    def put(self, key: object, value: object) -> None: ...
