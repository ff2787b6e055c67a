"""Random inputs for everything that reads something.

`python -m tools.fuzz NAME --seconds 60 --seed 1` runs those of one kind.

A fuzzer is a module with `case(draw)`: from one stream of random numbers it makes one input. What
an input may lead to, `judge` says; `isolated` runs inputs in a process of their own.
"""

from tests.search_path import add_test_folders

add_test_folders()
