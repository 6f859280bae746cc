"""Tables, figures and the page that tell what the study found; their bytes depend on its results only."""
