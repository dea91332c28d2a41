"""Looking at a robot, a scene, a run or a record: what to draw, and the windows that draw it."""
