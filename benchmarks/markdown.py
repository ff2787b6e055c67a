"""Rows of Markdown tables."""


def row(*cells: str) -> str:
    """One row."""
    return f"| {' | '.join(cells)} |"


def head(*names: str) -> list[str]:
    """The names of the columns, and the line below them."""
    return [row(*names), "|" + "---|" * len(names)]
