"""ROS 2 recordings: folders, SQLite files, and what packs them."""
