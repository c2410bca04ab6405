"""Instructions: templates, the objects that an instruction fits, and conditions on the image at the start."""
