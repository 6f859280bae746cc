"""Renderer of the embedded data set: photographs of made-up places, with exact depth and cameras."""
