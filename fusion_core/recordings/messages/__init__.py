"""ROS messages: their definitions, limits, and the values of images and clouds."""
