"""Blocks of runs: kept on disk, resumed, spread over processes."""
