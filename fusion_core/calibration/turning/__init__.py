"""Song 2022 §2.1: how a LiDAR is mounted on the axis that turns it."""
