"""Looks at a machine and its settings, and says what keeps the service from working there and how to mend it."""
