"""Balances categories: exact numbers of episodes of each category, over scenes and over the layouts of a family."""
