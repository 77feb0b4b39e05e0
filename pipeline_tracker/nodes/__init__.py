"""ROS 2 shells over the core."""
