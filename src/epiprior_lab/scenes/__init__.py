"""Renderer of the embedded data set: photographs of made-up places, with exact depth and cameras."""

from epiprior_lab.scenes.pairs import RenderedPair, SceneError, render_doppelgangers, render_pair
from epiprior_lab.scenes.settings import FAMILIES, FamilySettings

__all__ = ["FAMILIES", "FamilySettings", "RenderedPair", "SceneError", "render_doppelgangers", "render_pair"]
