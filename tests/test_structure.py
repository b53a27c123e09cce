"""What no linter checks: that faults of the mutation check exist."""

from tests.mutation_check import FAULTS


def test_every_fault_of_the_mutation_check_fits_the_program() -> None:
    for fault in FAULTS:
        fault.text()
