"""Sentences of a language: the grammar that writes them, the reader, added mistakes, and checks of new patterns."""
