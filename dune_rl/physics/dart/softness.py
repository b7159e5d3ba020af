"""Softness of tyres and servos in DART, which makes the loads of wheels and the torques of motors unique.

The loads of four rigid wheels on rigid ground are not unique, and neither are the torques of servos on one
body: a direct solver then puts a rover's weight on two of its wheels, and its yaw rate jumps. Tyres that
yield by less than a millimetre and servos that yield by 0.5 % of a rover's speed make both unique.
"""

from dune_rl.physics.dart.library import dartpy

# Stiffness of a tyre on rigid ground.
TYRE_STIFFNESS_NPM = 1e5

# The constraint force mixing of servos, which applies to every scene in the process.
SERVO_SOFTNESS = 0.07
dartpy.constraint.JointConstraint.setConstraintForceMixing(SERVO_SOFTNESS)
