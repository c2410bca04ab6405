"""New verified instructions for an existing dataset, without driving (docs/language.md)."""
