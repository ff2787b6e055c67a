"""Parts shared by several compensators."""
