"""The list of a scene's targets and edits of it."""
