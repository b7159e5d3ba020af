"""Learning: soft actor-critic, collectors, checkpoints and evaluation."""

import logging

# TorchRL announces every buffer that it makes on standard error.
logging.getLogger("torchrl").setLevel(logging.WARNING)
