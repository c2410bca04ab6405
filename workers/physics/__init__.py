"""Physics simulation with PyBullet: robot, colliders, stepping."""
