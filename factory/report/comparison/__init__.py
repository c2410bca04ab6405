"""Compares the statistics of a dataset with the numbers of the paper, with reasons for the differences.

Pure functions.
"""
