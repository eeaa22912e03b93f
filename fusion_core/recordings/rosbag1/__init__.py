"""ROS 1 bags: complete, truncated or damaged."""
