"""Which precisions a processor has built in."""

import torch


def has_bfloat16(device: torch.device | str) -> bool:
    """Whether `device` multiplies bfloat16 matrices itself, which halves the time of an update."""
    if torch.device(device).type == "cuda":
        return torch.cuda.is_bf16_supported(including_emulation=False)
    return bool(torch.cpu.get_capabilities().get("avx512_bf16", False))
