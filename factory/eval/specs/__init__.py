"""Chooses evaluation episodes and instruction variants."""
