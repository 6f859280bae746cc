"""Trained classifiers as model folders of the library."""
