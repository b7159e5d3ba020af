"""Soft actor-critic (Haarnoja et al. 2018) with a replay buffer and multi-step returns."""
