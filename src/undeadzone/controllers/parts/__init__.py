"""Parts shared by several controllers."""
