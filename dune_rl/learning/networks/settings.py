"""Settings of the networks that algorithms have in common. Importing them loads no PyTorch."""

from typing import Annotated

from pydantic import BeforeValidator, Field, SerializeAsAny

from dune_rl.learning.networks.registry import EncoderConf, parse_encoder
from dune_rl.learning.settings import LearningConf, Width

EncoderSettings = Annotated[SerializeAsAny[EncoderConf], BeforeValidator(parse_encoder)]


class NetworkConf(LearningConf):
    """Base of the settings of algorithms with the networks of `Architecture`."""

    hidden: tuple[Width, ...] = Field((256, 256), min_length=1)
    scan_channels: int = Field(8, ge=0, le=1024, description="of the convolutions round the scans; 0: none")
    image_channels: tuple[Width, ...] = Field(
        (16, 32, 32), min_length=1, description="of the convolutions over each image, if there are any"
    )
    image_features: int = Field(64, ge=1, le=4096, description="values that each image is reduced to")
    networks: dict[str, EncoderSettings] = Field(
        default_factory=dict, description="encoder of a part of the observation, by sensor, in place of these"
    )
    observation_clip: float = Field(10.0, gt=0, description="bound on normalised observations")
