"""Constants of physics."""

# Acceleration of gravity [m/s²], in every engine and sensor.
GRAVITY_MPS2 = 9.81
