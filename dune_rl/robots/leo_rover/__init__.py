"""Leo Rover: four wheels on two rockers."""
