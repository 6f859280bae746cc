"""From an image to local features and their descriptors (paper, section 4.1)."""
