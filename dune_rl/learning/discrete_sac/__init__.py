"""Soft actor-critic over a grid of commands (Christodoulou 2019), which an imitated policy can begin."""
