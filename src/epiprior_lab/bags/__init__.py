"""Structure from motion on bags of photographs with known cameras: how many are registered, and how well, by method."""
