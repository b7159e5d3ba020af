"""HyperDog, a quadruped of twelve servos."""
