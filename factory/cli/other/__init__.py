"""Commands `bench` and `completion`."""
