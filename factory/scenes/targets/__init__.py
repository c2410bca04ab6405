"""Target candidates of a stage, and the target lists and edits of the user. Compiles no scene."""
