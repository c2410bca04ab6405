"""Instructions: templates, taxonomy of categories, objects that an instruction fits, conditions on the start image."""
