"""Trains the baseline policies. Networks need the extra `train` (PyTorch).

Vocabulary, labels, cache and learning rate schedule use numpy only; torch is imported only to build or load a network.
Import from the modules by name.
"""
