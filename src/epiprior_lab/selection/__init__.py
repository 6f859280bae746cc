"""Choices made on validation scenes."""
