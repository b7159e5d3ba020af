"""Bags of ROS 2 (rosbag2, MCAP): episodes as standard messages, and readings out of such messages."""
