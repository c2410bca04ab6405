"""Pictures and films of episodes, and the Rerun viewer."""
