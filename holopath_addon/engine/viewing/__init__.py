"""What a viewer sees, of a field or of the scene itself, and how far the one is from the other."""
