"""Format `vlnce`: episodes in the conventions of VLN-CE and Habitat, scene meshes as glTF, and the exporter."""
