"""Model folders from the results of training."""
