"""The report on photographs."""
