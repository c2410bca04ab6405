"""Creates specs, their instruction variants and the orders of a campaign. Runs no policies."""
