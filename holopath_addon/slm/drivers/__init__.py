"""A driver for each kind of SLM, and what they talk to it by."""
