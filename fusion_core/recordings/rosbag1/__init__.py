"""ROS 1 bags, whole, cut or damaged."""
