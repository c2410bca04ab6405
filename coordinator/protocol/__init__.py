"""The messages between coordinator, workers and gateways over zenoh: transport, access control and answers."""
