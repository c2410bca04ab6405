"""Renders episodes as contact sheets and videos, and shows them in the Rerun viewer. Changes no datasets."""
