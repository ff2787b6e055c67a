"""What can be proved and known, of matrices and schedules alone."""
