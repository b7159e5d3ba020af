"""A robot as a model of Gazebo: bodies, sensors, the systems that drive it, and its files."""
