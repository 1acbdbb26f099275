"""kill -9 of driver and workers of a real study; the script in `verification/validation/` kills more often."""

import pytest
from verification.validation import kill_and_resume


@pytest.mark.long
def test_nothing_is_repeated_or_lost_and_the_posterior_is_the_same_to_the_bit():
    kill_and_resume.main(driver_kills=2, worker_kills=1, runs=60)
