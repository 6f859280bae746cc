"""Whether a fundamental matrix can be relied on."""
