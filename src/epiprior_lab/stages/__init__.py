"""One thin file per stage of the pipeline: read parameters, call, write."""
