"""Cases asked here or by several processes, none of which loses the answers of the others."""

from __future__ import annotations

import fnmatch
import multiprocessing
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress

from .compare import Case
from .families import FAMILIES, ask_case

Name = tuple[str, str]  # family and case
DIED = "its process died"


def choose_cases(pattern: str) -> tuple[list[Name], dict[str, str]]:
    """Return the cases that match, and the families of them that cannot be asked here, with why.

    Args:
        pattern: of a family, a case or family/case; * stands for anything.
    """
    chosen: list[Name] = []
    skipped = {}
    for family, one in FAMILIES.items():
        obstacle = one.find_obstacle()
        names = (
            [] if obstacle else [name for name in one.list_cases() if _fits(pattern, family, name)]
        )
        chosen += [(family, name) for name in names]
        if obstacle and (_fits(pattern, family, "") or "/" in pattern):
            skipped[family] = obstacle
    return chosen, skipped


def _fits(pattern: str, family: str, name: str) -> bool:
    """Return whether a pattern matches a case."""
    return any(fnmatch.fnmatchcase(one, pattern) for one in (family, name, f"{family}/{name}"))


def ask_cases(
    chosen: Iterable[Name], jobs: int = 1, note: Callable[[Name, Case], None] | None = None
) -> dict[Name, Case]:
    """Return the answers to cases.

    Args:
        chosen: cases.
        jobs: number of processes; 1: this one.
        note: called with each answer as it comes.
    """
    chosen = list(chosen)
    answers: dict[Name, Case] = {}
    for name, case in _answers(chosen, jobs):
        answers[name] = case
        if note is not None:
            note(name, case)
    return answers


def _answers(chosen: list[Name], jobs: int) -> Iterator[tuple[Name, Case]]:
    """Yield answers as they come. What a dying process left is asked again, each case alone."""
    if jobs == 1:
        for one in chosen:
            yield one, ask_case(*one)
        return
    left = dict.fromkeys(chosen)
    with suppress(BrokenProcessPool):
        for one, case in _answers_of_pool(chosen, jobs):
            del left[one]
            yield one, case
    for one in left:
        try:
            yield from _answers_of_pool([one], 1)
        except BrokenProcessPool:
            yield one, Case({"error": DIED}, {})


def _answers_of_pool(chosen: list[Name], jobs: int) -> Iterator[tuple[Name, Case]]:
    """Yield the answers of processes. Raise BrokenProcessPool where one dies."""
    fresh = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(jobs, mp_context=fresh) as pool:
        pending: dict[Future[Case], Name] = {pool.submit(ask_case, *one): one for one in chosen}
        for future in as_completed(pending):
            yield pending[future], future.result()
