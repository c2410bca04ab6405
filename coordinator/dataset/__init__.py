"""What stands beside the episodes: tables, description and card."""
