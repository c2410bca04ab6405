"""Pages of the application: one module for each, with its routes."""
