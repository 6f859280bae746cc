"""Rows of the classifiers, and the matches of a pair."""
