"""Python imports this module when it starts: what holds in the tests holds in every process that they start too."""

import quick_kernels
import reseed

quick_kernels.use()
reseed.use()
