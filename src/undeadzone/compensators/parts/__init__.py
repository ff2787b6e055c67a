"""What several compensators share."""
