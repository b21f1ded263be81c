"""Python imports this module when it starts: processes that a test starts draw the run's numbers too."""

import reseed  # noqa: F401
