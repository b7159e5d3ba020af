"""How scripted actors keep clear of each other, of robots and of obstacles: ORCA."""
