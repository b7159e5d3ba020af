"""CrossQ (Bhatt et al. 2024): soft actor-critic without target networks, with batch renormalisation."""
