"""Learning: soft actor-critic, collectors, checkpoints and evaluation."""

import logging

from torchrl import logger

# TorchRL announces every buffer that it makes, on the console.
logger.setLevel(logging.WARNING)
