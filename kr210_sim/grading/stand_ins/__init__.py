"""Small stand-ins for what a ROS node of the course imports; they behave as the originals did."""
