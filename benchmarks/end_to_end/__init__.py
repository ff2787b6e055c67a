"""Machines from log to compensation, and the audit of the paper by other means."""
