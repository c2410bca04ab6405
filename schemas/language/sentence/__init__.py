"""Sentences of a language: the grammar that writes them, the reader, added mistakes, and patterns from outside."""
