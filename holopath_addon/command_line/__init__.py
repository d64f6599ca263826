"""What the commands of `cli` share: where scenes come from, progress in a terminal, and those for an SLM."""
