"""Workspace that makes the models of epiprior and their evidence."""
