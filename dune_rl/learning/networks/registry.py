"""Registry of encoders, the networks that make features of one part of an observation.

Importing it loads no PyTorch.
"""

from collections.abc import Mapping
from typing import Any, Protocol

from dune_rl.core.registry import Registry
from dune_rl.core.settings import Settings
from dune_rl.core.suggestions import one_of


class EncoderConf(Settings):
    """Base of the settings of every encoder; `encoder` is its name in the registry."""

    encoder: str


class Encoder(Protocol):
    """A PyTorch module from readings (..., *shape) of a `PartSpec` to features (..., `size`)."""

    size: int

    def __call__(self, readings: Any) -> Any: ...


ENCODERS: Registry[Any] = Registry(
    "encoder",
    "dune_rl.learning.networks.registry:ENCODERS",
    own={
        "vector": "dune_rl.learning.networks.encoders:VectorEncoder",
        "scan": "dune_rl.learning.networks.encoders:ScanEncoder",
        "image": "dune_rl.learning.networks.encoders:ImageEncoder",
    },
    base=EncoderConf,
    product=Encoder,
    form="a class derived from torch.nn.Module, of a `part`",
    function_leading=("part",),
    class_leading=("part",),
    tag="encoder",
)


def parse_encoder(value: Any) -> Any:
    """The settings of an encoder, of which a name alone stands for its defaults; for a `BeforeValidator`."""
    if isinstance(value, Mapping) and ENCODERS.tag not in value:
        raise ValueError(
            f"an encoder is {one_of(ENCODERS.names())}, or {{encoder: NAME, ...}} with settings; "
            "learning.networks.lidar=scan sets the encoder of the sensor lidar"
        )
    return ENCODERS.parse_settings({"encoder": value} if isinstance(value, str) else value)
