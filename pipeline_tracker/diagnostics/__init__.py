"""How the live nodes are: what came in, what became of it, how long it took; no ROS in it."""
