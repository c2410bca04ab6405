"""The PyBullet world: robot, colliders, stepping."""
