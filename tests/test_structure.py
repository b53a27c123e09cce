"""That the faults of the mutation check, and the tests that notice them, exist."""

from tests.mutation_check import faults, missing_tests


def test_every_fault_of_the_mutation_check_fits_the_program() -> None:
    for fault in faults():
        fault.text()
    assert not missing_tests()
