"""The second pipeline: exported models, untouched, on photographs with ground truth (``benchmarks/real``)."""
