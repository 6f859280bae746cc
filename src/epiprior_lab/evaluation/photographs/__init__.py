"""The evaluation on photographs."""
