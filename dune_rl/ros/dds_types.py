"""Messages of ROS 2 as types of DDS, made at run time from the definitions by which bags are written."""

from collections.abc import Mapping
from functools import cache
from typing import Any

from dune_rl.core.errors import ConfigError
from dune_rl.ros.library import message_types

# The ROS types `byte` and `char` are octets, which Cyclone DDS has by another name.
_NAMES: Mapping[str, str] = {"byte": "uint8", "char": "uint8"}
_PREFIX = "rt"


def require_live_topics() -> None:
    """Raise ConfigError where a package for live topics is not installed."""
    try:
        import cyclonedds.idl  # noqa: F401
        import rosbags.typesys  # noqa: F401
    except ImportError:
        raise ConfigError(
            "live topics need Cyclone DDS and rosbags: pip install 'dune_rl[ros]' (Linux on ARM: build "
            "cyclonedds as well, which has no wheel there)"
        ) from None


def dds_topic(topic: str) -> str:
    """The name on the wire of a topic of ROS 2: `rt/scan` of `/scan`."""
    return f"{_PREFIX}/{topic.lstrip('/')}"


def ros_topic(name: str) -> str | None:
    """The topic of ROS 2 of a name on the wire; None for other data, such as services."""
    prefix, _, rest = name.partition("/")
    return f"/{rest}" if prefix == _PREFIX and rest else None


def dds_type(name: str) -> str:
    """The name on the wire of a type: `std_msgs::msg::dds_::Bool_` of `std_msgs/msg/Bool`."""
    package, _, message = name.partition("/msg/")
    return f"{package}::msg::dds_::{message}_"


def ros_type(name: str) -> str:
    """The type of a name on the wire; names of others are left as they are."""
    return name.replace("::msg::dds_::", "/msg/").removesuffix("_")


@cache
def message_struct(name: str) -> Any:
    """The class of samples of the type `name`, such as `std_msgs/msg/Bool`, for topics of Cyclone DDS.

    A sample has a `message` of the definitions of `message_types`, and is encoded by them. Cyclone DDS knows
    the fields, by which it checks what it receives.
    """
    from cyclonedds.idl import make_idl_struct
    from rosbags.serde import SerdeError

    types = message_types()
    fields = {field: _field_type(kind) for field, kind in types.store.get_msgdef(name).fields}
    made: Any = make_idl_struct(name.rpartition("/")[2], dds_type(name), fields, dataclassify=False)

    def take_message(self: Any, message: Any) -> None:
        self.message = message

    def serialize(self: Any, *args: Any, **kwargs: Any) -> bytes:
        return bytes(types.serialize(self.message))

    def deserialize(data: bytes, *args: Any, **kwargs: Any) -> Any:
        try:
            return made(types.store.deserialize_cdr(data, name))
        except SerdeError:
            # Such as a text that is not UTF-8. An exception would lose all messages that are taken with it.
            return made(None)

    def deserialize_key(*args: Any, **kwargs: Any) -> None:
        """Of a publisher that leaves; topics of ROS 2 have no keys."""

    # Not by a base class, which would be part of the type that others compare with theirs.
    made.__init__, made.serialize = take_message, serialize
    made.deserialize, made.deserialize_key = staticmethod(deserialize), staticmethod(deserialize_key)
    return made


def _field_type(description: Any) -> Any:
    """The type in Cyclone DDS of a field, which `rosbags` describes by its kind and what is in it."""
    from cyclonedds.idl import types as idl_types
    from rosbags.interfaces import Nodetype

    types: Any = idl_types
    kind, inner = description
    match kind:
        case Nodetype.NAME:
            return message_struct(inner)
        case Nodetype.BASE:
            name, bound = inner
            if name == "bool":
                return bool
            if name == "string":
                return types.bounded_str[bound] if bound else str
            return getattr(types, _NAMES.get(name, name))
        case Nodetype.ARRAY:
            return types.array[_field_type(inner[0]), inner[1]]
    element, bound = inner
    return types.sequence[_field_type(element), bound] if bound else types.sequence[_field_type(element)]
