"""Stateless simulation: world, robot, renderer, expert, rollout; the client side of the protocol."""
