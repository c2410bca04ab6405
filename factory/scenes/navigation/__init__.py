"""Where the robot can stand and drive in a scene."""
