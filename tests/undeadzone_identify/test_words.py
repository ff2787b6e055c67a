"""Answers in words."""

from __future__ import annotations

from undeadzone_identify.models.estimates import Interval
from undeadzone_identify.results.formats import describe_interval


def test_an_interval_has_as_many_digits_as_it_knows() -> None:
    assert (
        describe_interval(Interval(1.23456789, 1.22, 1.25), " rad") == "1.2346 [1.2200, 1.2500] rad"
    )
    assert describe_interval(Interval(5.0, 5.0, 5.0), " V") == "5 V"
    assert describe_interval(Interval(120.4, 80.0, 160.0), "") == "120.4 [80.0, 160.0]"
