"""Bodies of kinematic agents: their shapes, their motion models and how they look."""
