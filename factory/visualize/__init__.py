"""Renders episodes as contact sheets and films, and shows them in the Rerun viewer. Changes no datasets."""
