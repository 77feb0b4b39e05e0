"""What a message must be to be used: every check of a message stands here.

The checks work on rclpy's messages and on rosbags', whose fields are the same. They refuse with the
field, its value and what was expected: ``inputs`` what vehicles and cameras send, ``ours`` what our
nodes send each other and publish. What only geometry can judge is judged where it is computed:
whether two calibrations are those of a rectified pair (``geometry.camera``, ``camera_info``), and
whether packed pictures can be unpacked (``images``).
"""
