"""Results: signals, facts about them, display and files."""
